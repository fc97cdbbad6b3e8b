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


def splits(tree: Any) -> Iterator[dict[str, Any]]:
    """Every inner node of a layout."""
    if isinstance(tree, dict):
        yield tree
        yield from (inner for side in ("first", "second") for inner in splits(tree[side]))


def test_foxglove_gets_the_form_that_it_reads() -> None:
    """The format is that of the layouts that the program exports: a binary tree of panels, each named KIND!ID."""
    layout = json.loads((CONFIG / "foxglove.json").read_text())
    assert layout.keys() >= {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"}
    kinds = {name.partition("!")[0] for name in layout["configById"]}
    assert kinds <= {"3D", "map", "Indicator", "RawMessages", "DiagnosticSummary", "Plot"}
    for split in splits(layout["layout"]):
        assert split["direction"] in ("row", "column")
        assert 0 < split.get("splitPercentage", 50) < 100


def test_plotjuggler_gets_the_form_that_it_reads() -> None:
    """Each splitter has as many children and sizes as it says, and each dock one plot with its range."""
    root = ElementTree.parse(CONFIG / "plotjuggler.xml").getroot()
    assert root.tag == "root"
    splitters = list(root.iter("DockSplitter"))
    assert splitters
    for splitter in splitters:
        sizes = [float(size) for size in splitter.attrib["sizes"].split(";")]
        assert len(splitter) == int(splitter.attrib["count"]) == len(sizes)
        assert sum(sizes) == pytest.approx(1.0, abs=1e-3)
        assert splitter.attrib["orientation"] in "-|"
    for dock in root.iter("DockArea"):
        assert dock.find("plot/range").attrib.keys() == {"left", "right", "bottom", "top"}


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
