"""The package as ROS tools see it: manifest, executables, shared files, generated documents."""

import ast
import re
import shutil
import subprocess
import sys
import zipfile
from importlib import import_module

import pytest
import yaml

import nav_pose_estimator
import parameter_docs
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.offline.command_line import COMMANDS
from nav_pose_estimator.offline.flights.config_file import load_parameters

ROS_PACKAGES = re.compile(r"^\w+_msgs$|^(rclpy|rcl_interfaces|builtin_interfaces|std_srvs)$")
OPTIONAL = {"tf2_msgs", "gps_msgs", "mavros_msgs", "ublox_msgs", "px4_msgs"}


@pytest.fixture(scope="module")
def manifest(repository):
    parse = pytest.importorskip("catkin_pkg.package", reason="needs catkin_pkg")
    warnings: list[str] = []
    package = parse.parse_package(str(repository / "package.xml"), warnings=warnings)
    package.validate(warnings=warnings)
    assert warnings == []
    return package


def test_versions_agree(repository, manifest):
    setup = (repository / "setup.py").read_text(encoding="utf-8")
    assert re.search(r'version="([^"]+)"', setup).group(1) == manifest.version == nav_pose_estimator.__version__


def test_the_manifest_is_one_of_ament_python(manifest):
    assert manifest.name == "nav_pose_estimator"
    assert manifest.package_format == 3
    assert manifest.get_build_type() == "ament_python"
    assert manifest.licenses == ["Apache-2.0"]


def test_every_ros_package_that_is_imported_is_a_dependency(repository, manifest):
    imported = set()
    for path in (repository / "nav_pose_estimator").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.module:
                imported.add(node.module.split(".")[0])
            elif isinstance(node, ast.Import):
                imported.update(alias.name.split(".")[0] for alias in node.names)
    needed = {name for name in imported if ROS_PACKAGES.match(name)} - OPTIONAL
    assert needed <= {dependency.name for dependency in manifest.exec_depends}


def test_pip_puts_one_program_on_the_path(repository, tmp_path):
    """GIVEN commands with names like ``replay`` WHEN pip installs the package THEN its one program is
    nav_pose_estimator; ``test_colcon_build`` looks for those of ``ros2 run``."""
    source = tmp_path / "source"
    ignored = shutil.ignore_patterns(".*", "bags", "docs", "test", "build", "out", "*.nbi", "*.nbc", "__pycache__")
    shutil.copytree(repository, source, ignore=ignored)
    options = ("--no-deps", "--no-build-isolation", "--no-index", "-w", "wheels")
    call = [sys.executable, "-m", "pip", "wheel", *options, "."]
    done = subprocess.run(call, cwd=source, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    (wheel,) = (source / "wheels").glob("*.whl")
    (programs,) = zipfile.Path(wheel).glob("*.dist-info/entry_points.txt")
    entry = "nav_pose_estimator = nav_pose_estimator.offline.command_line:main"
    assert programs.read_text().split("\n", 1) == ["[console_scripts]", f"{entry}\n"]
    assert not any("/scripts/" in name for name in zipfile.ZipFile(wheel).namelist())


@pytest.mark.parametrize("name", [name for name, command in COMMANDS.items() if not command.is_node])
def test_every_offline_command_has_its_module(name):
    module = import_module(f"nav_pose_estimator.{COMMANDS[name].module}")
    assert callable(module.add_arguments)
    assert callable(module.run)


@pytest.mark.parametrize("name", [name for name, command in COMMANDS.items() if command.is_node])
def test_every_node_has_its_module(name):
    pytest.importorskip("rclpy", reason="needs ROS 2 (make setup)")
    assert callable(import_module(f"nav_pose_estimator.{COMMANDS[name].module}").main)


def test_the_parameter_file_is_up_to_date(repository):
    written = (repository / parameter_docs.YAML_FILE).read_text(encoding="utf-8")
    assert written == parameter_docs.yaml_text(), "run make docs"


def test_the_parameter_page_is_up_to_date(repository):
    assert (repository / parameter_docs.PAGE).read_text(encoding="utf-8") == parameter_docs.page_text(), "run make docs"


def test_the_parameter_file_equals_the_defaults_of_the_code(repository):
    assert load_parameters(repository / parameter_docs.YAML_FILE) == Parameters()


def test_the_parameter_file_gives_ros_the_types_of_the_defaults(repository):
    """ROS takes the type from the YAML: 5 would be an integer and refused for a double."""
    content = yaml.safe_load((repository / parameter_docs.YAML_FILE).read_text(encoding="utf-8"))

    def compare(tree, group):
        for name, value in tree.items():
            default = getattr(group, name)
            if isinstance(value, dict):
                compare(value, default)
            else:
                assert type(value) is (list if isinstance(default, tuple) else type(default)), name

    compare(content["/**"]["ros__parameters"], Parameters())


def test_every_other_parameter_file_is_valid(repository):
    for path in sorted((repository / "config").glob("*.yaml")):
        load_parameters(path)
