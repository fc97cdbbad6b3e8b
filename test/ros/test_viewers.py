"""Layouts of Foxglove, PlotJuggler and RViz: the topics they name are published, with the fields that they show."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
import yaml
from rclpy.node import Node

from nav_pose_estimator.nodes.pose_estimator import PoseEstimatorNode
from nav_pose_estimator.ros.inputs import message_class
from nav_pose_estimator.ros.messages.message_table import Source

CONFIG = Path(__file__).resolve().parents[2] / "config"


@pytest.fixture
def topics(started) -> dict[str, Any]:
    """Topic -> message class of all that the composed node publishes, and of what it hears."""
    node: Node = started(PoseEstimatorNode)
    ends = [(p.topic_name, p.msg_type) for p in node.publishers]
    return dict(ends + [(s.topic_name, s.msg_type) for s in node.subscriptions])


def has_field(kind: Any, fields: list[str]) -> bool:
    """Whether a message has ``fields``, one in the other; a number is an index into an array."""
    value = kind()
    for name in fields:
        if name.isdigit():
            if int(name) >= len(value):
                return False
            value = value[int(name)]
        elif not hasattr(value, name):
            return False
        else:
            value = getattr(value, name)
    return True


def texts(tree: Any) -> Iterator[str]:
    """Every key and every text in a tree."""
    if isinstance(tree, dict):
        for key, value in tree.items():
            yield key
            yield from texts(value)
    elif isinstance(tree, list):
        for value in tree:
            yield from texts(value)
    elif isinstance(tree, str):
        yield tree


def test_foxglove_shows_what_is_published(topics) -> None:
    """GIVEN the layout WHEN its message paths are read THEN topics and fields exist, and each panel has its place."""
    layout = json.loads((CONFIG / "foxglove.json").read_text())
    paths = [text for text in texts(layout["configById"]) if text.startswith("/")]
    assert len(paths) > 15
    for path in paths:
        topic, *fields = path.removesuffix(".@sqrt").replace("[", ".").replace("]", "").split(".")
        assert topic in topics, path
        assert has_field(topics[topic], fields), path
    assert {name for name in texts(layout["layout"]) if "!" in name} == set(layout["configById"])


def test_plotjuggler_shows_what_is_published(topics) -> None:
    curves = [curve.get("name", "") for curve in ElementTree.parse(CONFIG / "plotjuggler.xml").iter("curve")]
    assert len(curves) > 20
    for curve in curves:
        topic = max((topic for topic in topics if curve.startswith(f"{topic}/")), key=len, default="")
        assert topic, curve
        assert has_field(topics[topic], curve.removeprefix(f"{topic}/").split("/")), curve


def test_rviz_shows_what_is_published(topics) -> None:
    layout = yaml.safe_load((CONFIG / "pose_estimator.rviz").read_text())
    displays = {item["Class"]: item for item in layout["Visualization Manager"]["Displays"] if "Topic" in item}
    expected = {
        "rviz_default_plugins/Odometry": "nav_msgs/msg/Odometry",
        "rviz_default_plugins/PoseWithCovariance": "geometry_msgs/msg/PoseWithCovarianceStamped",
    }
    assert displays.keys() == expected.keys()
    for name, kind in expected.items():
        assert topics[displays[name]["Topic"]["Value"]] is message_class(Source("", kind, tuple))


def test_the_docs_list_every_layout(repository) -> None:
    text = (repository / "docs" / "viewers.md").read_text()
    for path in (*CONFIG.glob("*.json"), *CONFIG.glob("plotjuggler*.xml"), *CONFIG.glob("*.rviz")):
        assert re.search(rf"config/{re.escape(path.name)}|\$C/{re.escape(path.name)}", text), path.name
