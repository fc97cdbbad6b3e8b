"""Two vehicles in namespaces of their own: they share no topic that could mix them up, and neither misses a node."""

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TwistWithCovarianceStamped

from nav_pose_estimator.nodes.anfis_node import AnfisNode
from nav_pose_estimator.nodes.attitude_node import AttitudeNode
from nav_pose_estimator.nodes.pose_estimator import PoseEstimatorNode
from nav_pose_estimator.nodes.sins_node import SinsNode
from nav_pose_estimator.ros import inputs
from nav_pose_estimator.ros.spin import make_executor

OF_ALL = {"/diagnostics", "/rosout", "/parameter_events", "/clock"}


@pytest.mark.parametrize("make", [PoseEstimatorNode, SinsNode, AttitudeNode, AnfisNode], ids=lambda node: node.__name__)
def test_a_vehicle_keeps_to_its_namespace(started, make) -> None:
    """GIVEN a namespace WHEN a node starts THEN all that it publishes, hears and offers lies in it, its name, too."""
    node = started(make, "-r", "__ns:=/drone1")
    ends = [*(p.topic_name for p in node.publishers), *(s.topic_name for s in node.subscriptions)]
    names = {*ends, *(node.resolve_service_name(s.srv_name) for s in node.services)} - OF_ALL
    assert len(names) > 8
    assert [name for name in names if not name.startswith("/drone1/")] == []
    assert node.get_fully_qualified_name().startswith("/drone1/")


def test_frames_with_a_prefix_are_those_of_the_messages(started) -> None:
    names = ("map", "odom", "base_link")
    node = started(SinsNode, *(a for name in names for a in ("-p", f"ros.frames.{name}:=drone1/{name}")))
    frames = node.parameters.ros.frames
    assert (frames.map, frames.odom, frames.base_link) == ("drone1/map", "drone1/odom", "drone1/base_link")


def test_a_navigator_tells_that_its_learner_has_died(started, observer) -> None:
    """GIVEN predictions of anfis_node WHEN their publisher ends THEN log and diagnostics of the navigator say so."""
    node = started(SinsNode, "-p", "ros.output.diagnostics_period:=0.1")
    executor = make_executor()
    executor.add_node(node)
    arrays = observer.listen(DiagnosticArray, "/diagnostics")
    learner = observer.node.create_publisher(TwistWithCovarianceStamped, inputs.PREDICTION.topic, 1)

    def spun(condition) -> bool:
        executor.spin_once(timeout_sec=0.02)
        return bool(condition())

    def complaints() -> list[str]:
        return [status.message for status in arrays[-1].status if status.name == "sins_node: inputs"] if arrays else []

    def watched() -> list:
        return node.get_publishers_info_by_topic(f"/{inputs.PREDICTION.topic}")

    reports: list[int] = []
    observer.until(lambda: spun(lambda: watched() and (reports.append(len(arrays)) or len(arrays) > reports[0] + 3)))
    assert not any("is gone" in text for text in complaints())
    observer.node.destroy_publisher(learner)
    observer.until(lambda: spun(lambda: any("outage/velocity_error: its publisher is gone" in t for t in complaints())))
    assert node.logbook.counters["input.gone"] == 1
    executor.remove_node(node)
    executor.shutdown()
