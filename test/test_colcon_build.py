"""``colcon build`` of the repository; the built package used as ROS uses it: lib/, share/ and the ament index."""

import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from nav_pose_estimator.offline.command_line import COMMANDS

NAME = "nav_pose_estimator"
pytestmark = pytest.mark.skipif(shutil.which("colcon") is None, reason="needs colcon (requirements-dev.txt)")


@pytest.fixture(scope="module")
def install(tmp_path_factory, repository) -> Path:
    """GIVEN the repository built by colcon; its install folder."""
    base = tmp_path_factory.mktemp("colcon")
    command = [
        *("colcon", "--log-base", str(base / "log"), "build", "--paths", str(repository), "--packages-select", NAME),
        *("--build-base", str(base / "build"), "--install-base", str(base / "install")),
    ]
    done = subprocess.run(command, cwd=base, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return base / "install"


@pytest.fixture
def built(install, tmp_path):
    """Runs a shell command after sourcing the built workspace, away from the repository."""

    def run(command: str, timeout: float = 60.0) -> subprocess.CompletedProcess:
        environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
        script = f". {shlex.quote(str(install / 'local_setup.bash'))} && {command}"
        return subprocess.run(
            ["bash", "-c", script],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            timeout=timeout,
            check=False,
        )

    return run


def test_executables_lie_where_ros2_run_looks(install):
    folder = install / NAME / "lib" / NAME
    assert {path.name for path in folder.iterdir()} == set(COMMANDS)
    assert all(os.access(path, os.X_OK) for path in folder.iterdir())


def test_share_holds_manifest_parameters_and_bags(install, repository):
    share = install / NAME / "share" / NAME
    assert (share / "package.xml").is_file()
    for folder in ("config", "bags"):
        shipped = {path.relative_to(repository) for path in (repository / folder).rglob("*") if path.is_file()}
        installed = {path.relative_to(share) for path in (share / folder).rglob("*") if path.is_file()}
        assert installed == shipped


def test_the_ament_index_knows_the_package(built, install):
    pytest.importorskip("ament_index_python", reason="needs ROS 2 (make setup)")
    code = f"from ament_index_python import get_package_share_directory as share; print(share('{NAME}'))"
    done = built(f"{shlex.quote(sys.executable)} -c {shlex.quote(code)}")
    assert done.stdout.strip() == str(install / NAME / "share" / NAME), done.stderr


def test_the_built_modules_are_those_of_the_workspace(built, install):
    done = built(f"{shlex.quote(sys.executable)} -c 'import {NAME}; print({NAME}.__file__)'")
    assert done.stdout.startswith(str(install)), done.stdout + done.stderr


@pytest.mark.parametrize("name", COMMANDS)
def test_every_executable_starts(built, install, name):
    done = built(f"{shlex.quote(str(install / NAME / 'lib' / NAME / name))} --help")
    assert done.returncode == 0, done.stderr
    assert name in done.stdout


def test_an_executable_gives_the_exit_code_of_wrong_use(built, install):
    done = built(f"{shlex.quote(str(install / NAME / 'lib' / NAME / 'replay'))} no_such_bag")
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1
