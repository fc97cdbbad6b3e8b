"""The ament_python package: modules, executables and what goes into share."""

import sys
from pathlib import Path

from setuptools import find_packages, setup

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


def executables() -> list[str]:
    """What is installed as a program.

    colcon (``setup.py install`` or ``develop``) puts programs into lib/nav_pose_estimator, where ``ros2 run`` looks:
    one for each command. pip puts them on the PATH, where names like ``replay`` belong to nobody: one command for all.
    """
    if {"install", "develop"} & set(sys.argv):
        return [f"{command} = {COMMAND_LINE}:{command}" for command in COMMANDS]
    return [f"{NAME} = {COMMAND_LINE}:main"]


def shared_files(folder: str) -> list[tuple[str, list[str]]]:
    """Every file below ``folder``, as setuptools wants it: one entry per directory of share."""
    found: dict[str, list[str]] = {}
    for path in sorted(Path(folder).rglob("*")):
        if path.is_file() and "__pycache__" not in path.parts:
            found.setdefault(f"{SHARE}/{path.parent.as_posix()}", []).append(path.as_posix())
    return list(found.items())


setup(
    name=NAME,
    version="0.1.0",
    description="Pose estimation for drones that lose GNSS",
    long_description=Path("README.md").read_text(encoding="utf-8"),
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
)
