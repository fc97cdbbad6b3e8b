"""What the scripts in ``tools`` make of a host: with ROS 2 Jazzy from apt, without it, and when it comes later.

They run on a copy of what they read, with a real interpreter and real virtual environments. Only pip is replaced, by
a module that writes down its arguments: what would be installed is told without a package index.
"""

import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

# An interpreter whose virtual environments hold the pip below.
PYTHON = """#!/bin/bash
[ "$1 $2" = "-m venv" ] || exec {python} "$@"
{python} "$@" --without-pip && cp {pip} "${{!#}}"/lib/python3.*/site-packages/
"""
PIP = """import os, sys
with open(os.environ["PIP_CALLS"], "a") as calls:
    print(os.path.basename(sys.prefix), *sys.argv[1:], file=calls)
sys.exit("no package index" if os.environ.get("PIP_FAILS") else 0)
"""
# ROS's own scripts read variables that nobody has set.
SETUP_BASH = """[ -n "$COLCON_TRACE" ] && set -x
export ROS_DISTRO=jazzy AMENT_PREFIX_PATH={prefix}
"""
OPTIONS = "install --disable-pip-version-check"
PACKAGE = f"{OPTIONS} --no-deps --no-build-isolation --editable ."


class Host:
    """A computer with a copy of the repository; ``ros`` puts ROS 2 Jazzy on it."""

    def __init__(self, folder: Path, repository: Path) -> None:
        self.copy, self.prefix, self._calls = folder / "copy", folder / "ros", folder / "calls"
        shutil.copytree(repository / "tools", self.copy / "tools")
        for file in [*repository.glob("requirements*.txt"), repository / "setup.py"]:
            shutil.copy(file, self.copy)
        pip, self._python = folder / "pip.py", folder / "python"
        pip.write_text(PIP)
        self._python.write_text(PYTHON.format(python=shlex.quote(sys.executable), pip=shlex.quote(str(pip))))
        self._python.chmod(0o755)

    def ros(self) -> None:
        self.prefix.mkdir()
        (self.prefix / "setup.bash").write_text(SETUP_BASH.format(prefix=shlex.quote(str(self.prefix))))

    def run(self, tool: str, *arguments: str, **environment: str) -> subprocess.CompletedProcess:
        kept = {name: value for name, value in os.environ.items() if name in ("HOME", "LANG", "PATH")}
        own = {"PYTHON": str(self._python), "ROS_PREFIX": str(self.prefix), "PIP_CALLS": str(self._calls)}
        command = [str(self.copy / "tools" / tool), *arguments]
        return subprocess.run(
            command, env=kept | own | environment, capture_output=True, text=True, check=False, timeout=300
        )

    def set_up(self, *groups: str) -> str:
        """What the set-up says."""
        done = self.run("setup_environment.sh", *groups)
        assert done.returncode == 0, done.stderr
        return done.stderr

    def installed(self) -> list[str]:
        """Calls of pip since the last time: environment and arguments."""
        calls = self._calls.read_text().splitlines() if self._calls.exists() else []
        self._calls.unlink(missing_ok=True)
        return calls

    def sees_system_packages(self, venv: str = ".venv") -> bool:
        return "include-system-site-packages = true" in (self.copy / venv / "pyvenv.cfg").read_text()


@pytest.fixture
def host(tmp_path, repository) -> Host:
    return Host(tmp_path, repository)


def test_with_ros_from_apt_its_numpy_is_chosen_and_its_packages_are_seen(host):
    host.ros()
    said = host.set_up("run", "ros", "dev")
    assert host.sees_system_packages()
    assert host.installed() == [
        f".venv {OPTIONS} -r requirements-jazzy.txt",
        f".venv {PACKAGE}",
        f".venv {OPTIONS} -c requirements-jazzy.txt -r requirements-dev.txt",
    ]
    assert f"using ROS 2 from {host.prefix}" in said


def test_with_ros_from_apt_a_second_environment_would_be_the_same(host):
    host.ros()
    assert "no .venv-jazzy" in host.set_up("jazzy")
    assert not (host.copy / ".venv-jazzy").exists()
    assert host.installed() == []


def test_without_ros_the_newest_versions_are_chosen_and_nothing_of_the_host_is_seen(host):
    host.set_up("run", "dev")
    assert not host.sees_system_packages()
    assert host.installed() == [
        f".venv {OPTIONS} -r requirements.txt",
        f".venv {PACKAGE}",
        f".venv {OPTIONS} -c requirements.txt -r requirements-dev.txt",
    ]


@pytest.mark.skipif(sys.version_info >= (3, 13), reason="there is no NumPy 1.26 for this Python")
def test_without_ros_the_versions_of_jazzy_get_an_environment_of_their_own(host):
    host.set_up("jazzy")
    assert not host.sees_system_packages(".venv-jazzy")
    assert host.installed() == [
        f".venv-jazzy {OPTIONS} -r requirements-jazzy.txt",
        f".venv-jazzy {PACKAGE}",
        f".venv-jazzy {OPTIONS} -c requirements-jazzy.txt -r requirements-test.txt",
    ]


@pytest.mark.parametrize("has_ros", [False, True])
def test_what_trains_networks_gets_an_environment_of_its_own(host, has_ros):
    """GIVEN a host with or without ROS WHEN training is set up THEN it has the newest NumPy and nothing of the host."""
    if has_ros:
        host.ros()
    host.set_up("train")
    assert not host.sees_system_packages(".venv-train")
    assert host.installed() == [
        f".venv-train {OPTIONS} -r requirements.txt",
        f".venv-train {PACKAGE}",
        f".venv-train {OPTIONS} -c requirements.txt -r requirements-train.txt",
        f".venv-train {OPTIONS} -c requirements.txt -r requirements-test.txt",
    ]


@pytest.mark.parametrize("has_ros", [False, True])
def test_nothing_is_installed_twice_until_a_requirement_changes(host, has_ros):
    if has_ros:
        host.ros()
    host.set_up("run", "dev", "jazzy")
    first = host.installed()
    host.set_up("run", "dev", "jazzy")
    assert host.installed() == []
    with (host.copy / "requirements-base.txt").open("a") as file:
        file.write("one-more==1.0\n")
    host.set_up("run", "dev", "jazzy")
    assert host.installed() == first


def test_ros_that_comes_later_is_found(host):
    """GIVEN an environment from before ROS WHEN ROS is there THEN the environment is made again, with its versions."""
    host.set_up("run")
    host.installed()
    host.ros()
    host.set_up("run")
    assert host.sees_system_packages()
    assert host.installed() == [f".venv {OPTIONS} -r requirements-jazzy.txt", f".venv {PACKAGE}"]


def test_what_failed_is_said_and_tried_again(host):
    failed = host.run("setup_environment.sh", "run", PIP_FAILS="1")
    assert failed.returncode == 1
    assert "no package index" in failed.stderr
    assert "error: requirements.txt could not be installed" in failed.stderr
    host.installed()
    host.set_up("run")
    assert host.installed() == [f".venv {OPTIONS} -r requirements.txt", f".venv {PACKAGE}"]


SHOW = """echo "${ROS_DISTRO:-none} $AMENT_PREFIX_PATH $ROS_AUTOMATIC_DISCOVERY_RANGE ${NUMBA_CACHE_DIR:-beside}"
which python"""


def test_a_command_runs_with_ros_from_apt(host):
    host.ros()
    host.set_up("run")
    shown = host.run("in_environment.sh", "bash", "-c", SHOW)
    assert shown.stdout.splitlines() == [f"jazzy {host.prefix} LOCALHOST beside", f"{host.copy}/.venv/bin/python"]


def test_a_command_runs_with_ros_from_wheels(host):
    host.set_up("run")
    shown = host.run("in_environment.sh", "bash", "-c", SHOW)
    venv = host.copy / ".venv"
    assert shown.stdout.splitlines() == [f"none {venv} LOCALHOST beside", f"{venv}/bin/python"]


@pytest.mark.skipif(sys.version_info >= (3, 13), reason="there is no NumPy 1.26 for this Python")
def test_a_command_runs_in_the_second_environment_with_machine_code_of_its_own(host):
    host.set_up("jazzy")
    shown = host.run("in_environment.sh", "bash", "-c", SHOW, NAV_POSE_VENV=".venv-jazzy")
    venv = host.copy / ".venv-jazzy"
    assert shown.stdout.splitlines() == [f"none {venv} LOCALHOST {venv}/numba_cache", f"{venv}/bin/python"]
