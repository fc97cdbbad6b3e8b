"""What the tests of the ROS boundary share: nodes in this process, nodes in processes of their own, an observer."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from ros_processes import Child, Observer, children

try:
    import rclpy
except ImportError:  # no ROS 2 here: what needs none is tested all the same
    collect_ignore = [path.name for path in Path(__file__).parent.glob("test_*.py") if "rclpy" in path.read_text()]


@pytest.fixture
def started(ros_domain: int) -> Iterator[Callable[..., Any]]:
    """``started(make_node, *ros arguments)``: a node in this process, destroyed at the end."""
    nodes = []

    def start(make_node: Callable[[], Any], *arguments: str) -> Any:
        rclpy.init(args=["--ros-args", *arguments] if arguments else [])
        nodes.append(make_node())
        return nodes[-1]

    yield start
    for node in nodes:
        node.destroy_node()
    rclpy.try_shutdown()


@pytest.fixture
def launch(child_environment: dict[str, str], tmp_path: Path) -> Iterator[Callable[..., Child]]:
    """Start nodes as processes in a domain of their own."""
    with children(child_environment, tmp_path) as start:
        yield start


@pytest.fixture
def observer(ros_domain: int) -> Iterator[Observer]:
    """A node that watches the others."""
    watching = Observer(ros_domain)
    yield watching
    watching.close()
