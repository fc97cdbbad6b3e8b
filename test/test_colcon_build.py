"""``colcon build`` of the repository; the built package used as ROS uses it: lib/, share/ and the ament index."""

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from nav_pose_estimator.offline.command_line import COMMANDS
from ros_processes import Observer

NAME = "nav_pose_estimator"
COLCON = shutil.which("colcon", path=os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]))
pytestmark = pytest.mark.skipif(COLCON is None, reason="needs colcon (requirements-dev.txt)")


@pytest.fixture(scope="module")
def install(tmp_path_factory, repository) -> Path:
    """GIVEN the repository built by colcon; its install folder."""
    base = tmp_path_factory.mktemp("colcon")
    command = [
        *(COLCON, "--log-base", str(base / "log"), "build", "--paths", str(repository), "--packages-select", NAME),
        *("--build-base", str(base / "build"), "--install-base", str(base / "install")),
    ]
    # no compiler, which would take a minute: what it is called for and what it finds is looked at
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run(command, cwd=base, env=environment, capture_output=True, text=True, timeout=300, check=False)
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


def test_a_build_compiles_the_kernels(install, repository):
    """WHEN it is built THEN ``warm_up`` has run in the installed package, with what lay compiled beside the sources."""
    (log,) = (install.parent / "log" / "latest_build").resolve().glob(f"{NAME}/stdout.log")
    said = log.read_text(encoding="utf-8")
    assert "compiling the numeric kernels" in said
    assert "kernels run as plain Python" in said

    (modules,) = (install / NAME).glob(f"lib/python*/site-packages/{NAME}")
    compiled = {path.relative_to(repository / NAME) for path in (repository / NAME).rglob("*.nb[ic]")}
    installed = {path.relative_to(modules) for path in modules.rglob("*.nb[ic]")}
    assert installed <= compiled
    assert bool(installed) == bool(compiled)


def test_share_holds_manifest_parameters_launch_files_and_bags(install, repository):
    share = install / NAME / "share" / NAME
    assert (share / "package.xml").is_file()
    for folder in ("config", "launch", "bags"):
        shipped = {path.relative_to(repository) for path in (repository / folder).rglob("*") if path.is_file()}
        installed = {path.relative_to(share) for path in (share / folder).rglob("*") if path.is_file()}
        assert installed == shipped


def test_the_parameter_files_of_the_commands_in_the_docs_exist(install, repository):
    """GIVEN the installed package WHEN a command of README, docs or a driver's file is typed THEN its files are there.

    ``ros2 pkg prefix`` prints the folder that the ament index gives, here ``install/PACKAGE``.
    """
    prefix, named = str(install / NAME), []
    for path in [
        repository / "README.md",
        *(repository / "docs").glob("*.md"),
        *(repository / "config").glob("*.yaml"),
    ]:
        text = path.read_text(encoding="utf-8")
        folder = re.search(r"C=(\$\(ros2 pkg prefix \w+\)\S+)", text)
        files = re.findall(r"--params-file\s+(\$C/\S+)", text)
        assert folder or not files, f"{path.name} uses $C and does not set it"
        assert not re.search(r"ros2 run[^`]*--params-file config/", text), path.name
        named += [file.replace("$C", folder[1]).replace(f"$(ros2 pkg prefix {NAME})", prefix) for file in files]
    assert len(named) > 8
    assert [file for file in named if not Path(file).is_file()] == []


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


# --- nodes from the built package ----------------------------------------------------------------------------------
ESTIMATORS = ("attitude_node", "sins_node", "pose_estimator")


@pytest.fixture
def observer(ros_domain):
    """A node that looks at the graph."""
    pytest.importorskip("rclpy", reason="needs ROS 2 (make setup)")
    watching = Observer(ros_domain)
    yield watching
    watching.close()


@pytest.fixture
def start(install, tmp_path, child_environment):
    """Starts executables of the built package; whatever still runs at the end of the test is stopped."""
    running: list[subprocess.Popen] = []

    def executable(name: str, *arguments: str) -> subprocess.Popen:
        script = f". {shlex.quote(str(install / 'local_setup.bash'))} && exec {NAME}/lib/{NAME}/{name} " + shlex.join(
            arguments
        )
        environment = {key: value for key, value in child_environment.items() if key != "PYTHONPATH"}
        environment["NUMBA_DISABLE_JIT"] = "1"  # a fresh install has no compiled kernels yet, and none are needed here
        with (tmp_path / f"{name}.log").open("w", encoding="utf-8") as log:
            running.append(
                subprocess.Popen(
                    ["bash", "-c", script], cwd=install, env=environment, stdout=log, stderr=subprocess.STDOUT
                )
            )
        return running[-1]

    yield executable
    for process in running:
        if process.poll() is None:
            process.kill()
            process.wait(timeout=60.0)


@pytest.mark.parametrize("name", ESTIMATORS)
def test_a_node_takes_what_ros_gives(observer, start, tmp_path, name):
    """GIVEN namespace, remap, parameter file, -p and use_sim_time WHEN it runs THEN the graph shows each."""
    from rcl_interfaces.srv import GetParameters

    (tmp_path / "drone.yaml").write_text("/**: {ros__parameters: {gnss: {delay: 0.125}}}", encoding="utf-8")
    process = start(
        *(name, "--ros-args", "-r", "__ns:=/drone", "-r", "imu/data_raw:=/raw/imu", "-p", "use_sim_time:=true"),
        *("-p", "imu.max_gap:=0.75", "--params-file", str(tmp_path / "drone.yaml")),
    )
    log = tmp_path / f"{name}.log"
    observer.until(lambda: "ready" in log.read_text() or process.poll() is not None, f"start of {name}")
    assert process.poll() is None, log.read_text()
    request = GetParameters.Request(names=["use_sim_time", "gnss.delay", "imu.max_gap"])
    answer = observer.call(GetParameters, f"/drone/{name}/get_parameters", request)
    sim_time, delay, max_gap = answer.values
    assert (sim_time.bool_value, delay.double_value, max_gap.double_value) == (True, 0.125, 0.75)
    imu = observer.node.get_subscriptions_info_by_topic
    observer.until(lambda: any(i.node_name == name for i in imu("/raw/imu")), "subscription to /raw/imu")

    process.send_signal(signal.SIGINT)
    assert process.wait(timeout=15.0) == 0, log.read_text()


@pytest.mark.parametrize(
    ("given", "says"),
    [
        (("-p", "gnss.dely:=0.1"), "gnss.dely"),
        (("-p", "gnss.delay:=fast"), "gnss.delay"),
        (("-p", "gnss.delay:=99.0"), "gnss.delay"),
        (("--params-file", "nowhere.yaml"), "nowhere.yaml"),
        (("-p", "nonsense"), "nonsense"),
    ],
)
def test_a_node_refuses_what_does_not_fit(start, tmp_path, given, says):
    """WHEN a parameter or a ROS argument does not fit THEN the node ends with code 2 and one sentence, no traceback."""
    pytest.importorskip("rclpy", reason="needs ROS 2 (make setup)")
    process = start("sins_node", "--ros-args", *given)
    code = process.wait(timeout=30.0)
    text = (tmp_path / "sins_node.log").read_text()
    assert code == 2, text
    assert says in text
    assert "Traceback" not in text
