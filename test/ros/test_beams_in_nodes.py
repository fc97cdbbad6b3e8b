"""Beams in running nodes: every type of message through a node's callbacks, and a radar over topics."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.serialization import serialize_message
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import SetBool

from beamed import beam_directions, with_beams
from driver_types import A50, DVL, make, sent
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import BeamVelocitySample, GnssFix, ImuSample, Sample
from nav_pose_estimator.engine.solutions import NavSolution, Output
from nav_pose_estimator.nodes.sins_node import SinsNode
from nav_pose_estimator.ros.inputs import message_class
from nav_pose_estimator.ros.messages import beams, convert
from nav_pose_estimator.ros.messages.sample_messages import TOPICS, to_message
from nav_pose_estimator.sim.scenarios import generate
from pieces import one_by_one
from small_bags import header

pytestmark = pytest.mark.compiled
GIVEN = [round(number, 6) for number in beam_directions().ravel().tolist()]


def vector3(values: Any) -> Any:
    x, y, z = map(float, values)
    return make("geometry_msgs/msg/Vector3", x=x, y=y, z=z)


def as_dvl(sample: BeamVelocitySample) -> Any:
    values = {
        "header": header(sample.stamp_ns, "dvl"),
        "velocity_mode": 1,
        "beam_ranges_valid": True,
        "beam_unit_vec": [vector3(one) for one in sample.directions],
        "range": np.full(4, 20.0),
        "beam_velocity": sample.velocities.astype(np.float32),
    }
    return sent(make(DVL, **values))


def as_a50(sample: BeamVelocitySample) -> Any:
    found = [
        make("dvl_msgs/msg/DVLBeam", id=number, velocity=velocity, distance=20.0, valid=True)
        for number, velocity in enumerate(sample.velocities.tolist())
    ]
    return sent(make(A50, header=header(sample.stamp_ns), beams=found, velocity=vector3(np.zeros(3))))


SOURCES: dict[str, tuple[Callable, Callable]] = {
    "dvl": (as_dvl, beams.dvl),
    "a50": (as_a50, beams.a50),
    "pointcloud2": (to_message, beams.point_cloud),
}


def as_the_engine_hears(samples: list[Sample], adapter: Callable, messages: Iterator[Any]) -> Iterator[Sample]:
    """Samples after their way through messages: angles through degrees, beams through what their message holds."""
    for sample in samples:
        if isinstance(sample, BeamVelocitySample):
            yield from adapter(next(messages))
        else:
            yield convert.nav_sat_fix(to_message(sample))[0] if isinstance(sample, GnssFix) else sample


@pytest.mark.parametrize("kind", SOURCES)
def test_a_node_uses_the_beams_of_every_message_as_the_engine_does(started, monkeypatch, kind):
    """GIVEN a flight with beams as messages of one driver WHEN a node hears it THEN its poses are the engine's.

    The class of a package that is not installed is stood in for; what the callback receives is the driver's message.
    """
    as_message, adapter = SOURCES[kind]
    monkeypatch.setattr(
        "nav_pose_estimator.ros.load.intake.message_class",
        lambda source: PointCloud2 if source.topic == "beam_velocity" else message_class(source),
    )
    settings = ["-p", f"aids.beam_velocity_source:={kind}", "-p", "ros.output.odometry_rate:=0.0"]
    if kind == "a50":
        settings += ["-p", f"aids.beams.directions:={GIVEN}"]
    node = started(SinsNode, *settings)
    heard: list[Output] = []
    node.publish = heard.append
    callbacks = {subscription.topic_name: subscription.callback for subscription in node.subscriptions}
    flight = generate("multirotor_outage", 40.0, seed=5, imu_rate=50.0)
    samples = list(one_by_one(with_beams(flight)))
    messages = [as_message(sample) for sample in samples if isinstance(sample, BeamVelocitySample)]
    waiting = iter(messages)
    for sample in samples:
        is_beams = isinstance(sample, BeamVelocitySample)
        topic = f"/{TOPICS[type(sample)][0]}"
        message = next(waiting) if is_beams else to_message(sample)
        if topic in callbacks:
            callbacks[topic](serialize_message(message) if isinstance(sample, ImuSample) else message)

    given = {"aids.beams.directions": tuple(GIVEN)} if kind == "a50" else {}
    engine = PoseEstimator(update(Parameters(), {"aids.beam_velocity_source": kind} | given), attitude=False)
    alone = [o for s in as_the_engine_hears(samples, adapter, iter(messages)) for o in engine.feed(s)]
    expected = [output for output in alone if isinstance(output, NavSolution)]
    solutions = [output for output in heard if isinstance(output, NavSolution)]
    assert node.engine.status().counters["beam_velocity.used"] > 30
    assert len(solutions) == len(expected) > 500
    np.testing.assert_array_equal([one.values for one in solutions], [one.values for one in expected])


def test_a_radar_over_topics_holds_an_outage(launch, observer):
    """GIVEN sensors and navigator in two processes, a radar with the sensors WHEN GNSS is taken away THEN the node has
    found how the radar means its velocities, shows each beam in its status, and says that the drift is bounded."""
    reports = observer.listen(DiagnosticArray, "/diagnostics")
    settings = ("aids.beam_velocity_source:=pointcloud2", "aids.beams.sd:=0.08", "ros.input.relieve:=false")
    navigator = launch("sins_node", *(a for s in settings for a in ("-p", s)))
    navigator.wait_for("ready")
    story = ("scenario:=drone_over_water", "duration:=150.0", "sim_time:=true", "speed:=3.0", "imu_rate:=100.0")
    sensors = launch("synthetic_sensors", *(a for s in story for a in ("-p", s)))
    navigator.wait_for("4 beams, directions as published, positive for motion against the beam")

    def values() -> dict[str, str]:
        return {pair.key: pair.value for report in reports[-1:] for s in report.status for pair in s.values}

    observer.until(lambda: int(values().get("beam_velocity.used", 0)) > 40, "beams that are used")
    assert observer.call(SetBool, "/sins_node/use_gnss", SetBool.Request(data=False)).success
    observer.until(lambda: "AIDED -> COASTING" in navigator.text(), "a drift that is bounded")
    assert {f"beams.{number}.flag_rate" for number in range(1, 5)} <= set(values())
    assert sensors.stop() == 0
    assert navigator.stop() == 0, navigator.text()
    assert "Traceback" not in navigator.text()
