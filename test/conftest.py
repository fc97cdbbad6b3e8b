"""What the tests share: real flights, ROS domains of their own, environments for child processes, the two kernel modes.

Environment: ``NAV_POSE_SHARED`` names the folder with real data (default: ``shared`` beside the repository),
``NAV_POSE_TEST_LIMIT`` how long a test may take (600 s).
"""

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

from hang_guard import pytest_runtest_protocol as pytest_runtest_protocol  # a hook
from nav_pose_estimator.core.numerics.jit import COMPILED
from nav_pose_estimator.ros.middleware.shared_memory import remove_unfinished

REPOSITORY = Path(__file__).resolve().parents[1]
SHARED = Path(os.environ.get("NAV_POSE_SHARED", REPOSITORY.parent / "shared"))

# Property tests: the same examples each time, and no clock (the first call of a kernel may compile it).
settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile("repeatable")

# Before any test imports rclpy: stay on this host, let rclpy check the types of message fields, find ROS from wheels.
os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
os.environ.setdefault("ROS_PYTHON_CHECK_FIELDS", "1")
os.environ.setdefault("AMENT_PREFIX_PATH", sys.prefix)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Tests marked ``compiled`` are too slow for kernels in plain Python."""
    if COMPILED:
        return
    for item in items:
        if item.get_closest_marker("compiled"):
            item.add_marker(pytest.mark.skip(reason="needs compiled kernels (too slow in plain Python)"))


@pytest.fixture(scope="session")
def repository() -> Path:
    """The top of the repository."""
    return REPOSITORY


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder with real flights and attitude trials; the test is skipped where it is absent."""
    folder = SHARED / "data"
    if not folder.is_dir():
        pytest.skip("real data is not here (set NAV_POSE_SHARED to the folder that holds data/)")
    return folder


@pytest.fixture
def ros_domain(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """A ROS domain that no other test on this machine uses, set in the environment of this test and its children."""
    domain_coordinator = pytest.importorskip("domain_coordinator", reason="needs ROS 2 (make setup)")
    remove_unfinished()  # what a killed child of another test may have left, for which every later node would wait
    with domain_coordinator.domain_id() as domain:
        monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
        yield domain


@pytest.fixture
def child_environment(ros_domain: int) -> dict[str, str]:
    """Environment for a child process that runs a node of this package."""
    environment = dict(os.environ, ROS_DOMAIN_ID=str(ros_domain), PYTHONUNBUFFERED="1")
    environment["PYTHONPATH"] = os.pathsep.join([str(REPOSITORY), *filter(None, [environment.get("PYTHONPATH")])])
    return environment
