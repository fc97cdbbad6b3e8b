"""The ament_python package: modules, executables, what goes into share, and kernels that are compiled in time."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

from setuptools import find_packages, setup
from setuptools.command.develop import develop
from setuptools.command.install import install

NAME = "nav_pose_estimator"
SHARE = f"share/{NAME}"
COMMANDS = (
    "attitude_node",
    "sins_node",
    "anfis_node",
    "pose_estimator",
    "synthetic_sensors",
    "simulate",
    "replay",
    "convert",
    "calibrate",
    "train",
    "benchmark",
    "warm_up",
)
COMMAND_LINE = f"{NAME}.offline.command_line"


def is_colcon() -> bool:
    """Whether this is ``setup.py install`` or ``develop``."""
    return bool({"install", "develop"} & set(sys.argv))


def executables() -> list[str]:
    """What is installed as a program.

    colcon puts programs into lib/nav_pose_estimator, where ``ros2 run`` looks: one for each command. pip puts them on
    the PATH, where names like ``replay`` belong to nobody: one command for all.
    """
    if is_colcon():
        return [f"{command} = {COMMAND_LINE}:{command}" for command in COMMANDS]
    return [f"{NAME} = {COMMAND_LINE}:main"]


def shared_files(folder: str) -> list[tuple[str, list[str]]]:
    """Every file below ``folder``, as setuptools wants it: one entry per directory of share."""
    found: dict[str, list[str]] = {}
    for path in sorted(Path(folder).rglob("*")):
        if path.is_file() and "__pycache__" not in path.parts:
            found.setdefault(f"{SHARE}/{path.parent.as_posix()}", []).append(path.as_posix())
    return list(found.items())


def compile_kernels(modules: str) -> None:
    """Compile the numeric kernels of the package in the folder ``modules``, so that no first start has to.

    What lies compiled beside these sources is valid there, too. A build does not fail of this: what is missing is
    compiled when it is called first.
    """
    for path in Path(NAME).rglob("__pycache__/*.nb[ic]"):
        copy = Path(modules, path)
        if copy.parent.parent.is_dir() and not copy.exists():
            copy.parent.mkdir(exist_ok=True)
            shutil.copyfile(path, copy)
    print("compiling the numeric kernels, which takes a minute or two the first time", flush=True)
    path_of_modules = os.pathsep.join(filter(None, [modules, os.environ.get("PYTHONPATH")]))
    command = [sys.executable, "-m", NAME, "warm_up"]
    done = subprocess.run(command, cwd=modules, env=os.environ | {"PYTHONPATH": path_of_modules}, check=False)
    if done.returncode:
        print("warning: not every kernel was compiled; the first start will do it", flush=True)


class InstallWithKernels(install):
    """``setup.py install``, as ``colcon build`` calls it. Files of a distribution package (--root) stay as they are."""

    def run(self):
        """Install, then compile."""
        super().run()
        if self.single_version_externally_managed and not self.root:
            compile_kernels(os.path.abspath(self.install_lib))


class DevelopWithKernels(develop):
    """``setup.py develop``, as ``colcon build --symlink-install`` calls it."""

    def run(self):
        """Install, then compile beside the sources."""
        super().run()
        compile_kernels(os.getcwd())


def build_commands() -> dict[str, type]:
    """pip takes its own way, and has compiled nothing when it is done."""
    return {"install": InstallWithKernels, "develop": DevelopWithKernels} if is_colcon() else {}


setup(
    name=NAME,
    version="0.1.0",
    description="Pose estimation for drones that lose GNSS",
    long_description=Path(__file__).resolve().with_name("README.md").read_text(encoding="utf-8"),
    long_description_content_type="text/markdown",
    license="Apache-2.0",
    maintainer="The nav_pose_estimator maintainers",
    maintainer_email="maintainers@nav-pose-estimator.example",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["py.typed", "offline/page/live.js", "engine/outage/methods/usual_motion.toml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (SHARE, ["package.xml"]),
        *shared_files("config"),
        *shared_files("launch"),
        *shared_files("bags"),
    ],
    zip_safe=False,
    python_requires=">=3.11",
    install_requires=["setuptools", "numpy>=1.26", "scipy>=1.11", "PyYAML>=6.0"],
    extras_require={
        "offline": ["rosbags>=0.11", "tqdm>=4.66"],
        "compiled": ["numba>=0.61"],
        "logs": ["pyulog>=1.1"],
        "train": ["jax>=0.4.30", "optax>=0.2"],
        "magnetic": ["pygeomag>=1.1"],
        "reports": ["plotly>=6.0"],
        "stores": ["fsspec>=2024.2"],
    },
    entry_points={"console_scripts": executables()},
    cmdclass=build_commands(),
)
