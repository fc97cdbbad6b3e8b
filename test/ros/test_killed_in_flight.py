"""A process that is killed in flight and started again: what the vehicle's other programs hear of it, over DDS."""

import itertools
import math
import re
import signal
from pathlib import Path

import pytest
from conftest import Observer
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import TwistWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import NavSatFix
from std_srvs.srv import SetBool

from nav_pose_estimator.core.earth.ellipsoid import lla_to_enu
from nav_pose_estimator.ros.messages import convert
from nav_pose_estimator.sim.scenarios import HOME

pytestmark = pytest.mark.compiled
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
DEEP = QoSProfile(depth=1000)
STORY = ("imu_rate:=50.0", "seed:=4", "duration:=1200.0", "sim_time:=true", "speed:=2.0")
DIAGNOSTICS = ("-p", "ros.output.diagnostics_period:=0.2")


def fly(launch, scenario: str) -> None:
    launch("synthetic_sensors", *(a for setting in (*STORY, f"scenario:={scenario}") for a in ("-p", setting)))


class Told:
    """The modes that a node has told on its latched status, in order and without repetition."""

    def __init__(self, observer: Observer, node: str) -> None:
        self._statuses = observer.listen(DiagnosticStatus, f"/{node}/status", LATCHED)

    @property
    def modes(self) -> list[str]:
        return [mode for mode, _ in itertools.groupby(s.message.split(":")[0].split()[0] for s in self._statuses)]

    @property
    def mode(self) -> str:
        return self.modes[-1] if self._statuses else ""

    def forget(self) -> None:
        self._statuses.clear()


def numbers(message: Odometry) -> list[float]:
    pose, twist = message.pose.pose, message.twist.twist
    q = pose.orientation
    vectors = [convert.vector(v) for v in (pose.position, twist.linear, twist.angular)]
    covariances = [*message.pose.covariance, *message.twist.covariance]
    return [*itertools.chain(*vectors), q.w, q.x, q.y, q.z, *covariances]


def off(message: Odometry, origin: NavSatFix, truth: list[Odometry]) -> float:
    """Horizontal distance [m] between the odometry on its origin and the truth at the same stamp."""
    (true,) = (m.pose.pose.position for m in truth if convert.stamp_ns(m) == convert.stamp_ns(message))
    place = math.radians(origin.latitude), math.radians(origin.longitude), origin.altitude
    east, north, _ = lla_to_enu(*place, *HOME)
    position = message.pose.pose.position
    return math.hypot(position.x + east - true.x, position.y + north - true.y)


def test_an_estimator_killed_in_flight_aligns_in_motion(launch, observer) -> None:
    """GIVEN a vehicle that never rests WHEN its estimator is killed and started again
    THEN it tells that it aligns and where its new axes lie before the first pose, and is where the vehicle is."""
    told = Told(observer, "pose_estimator")
    odometry = observer.listen(Odometry, "/odometry/filtered", DEEP)
    origins = observer.listen(NavSatFix, "/pose_estimator/origin", LATCHED)
    truth = observer.listen(Odometry, "/ground_truth/odom", DEEP)
    arrays = observer.listen(DiagnosticArray, "/diagnostics")
    node = launch("pose_estimator", *DIAGNOSTICS)
    node.wait_for("ready")
    fly(launch, "closed_curve")
    observer.until(lambda: told.mode == "AIDED" and len(odometry) > 500, "flight")
    assert node.stop(signal.SIGKILL) == -signal.SIGKILL
    observer.until(lambda: truth[-1].header.stamp.sec > odometry[-1].header.stamp.sec + 2, "the flight goes on")
    before = [list(heard) for heard in (odometry, origins)]
    for heard in (odometry, origins, arrays):
        heard.clear()
    told.forget()
    modes_at_first_pose: list[str] = []
    again = launch("pose_estimator", *DIAGNOSTICS)

    def flies() -> bool:
        if odometry and not modes_at_first_pose:
            modes_at_first_pose.extend(told.modes)
        return told.mode == "AIDED" and len(odometry) > 500

    observer.until(flies, "AIDED again")
    assert "ALIGNING" in modes_at_first_pose, "no silent jump"
    assert "aligned (in motion, heading from GNSS)" in again.text()
    counted = {pair.key: pair.value for s in arrays[-1].status if s.name.endswith("counters") for pair in s.values}
    assert (counted["aligned"], counted["mode.aided"]) == ("1", "1"), "counters begin anew with the process"
    assert len(origins) == 1
    stamps = [convert.stamp_ns(m) for m in (*before[0], *odometry)]
    assert stamps == sorted(set(stamps))
    assert all(math.isfinite(value) for m in odometry for value in numbers(m))
    assert off(before[0][-1], before[1][-1], truth) < 10.0
    last = next(m for m in reversed(odometry) if convert.stamp_ns(m) <= convert.stamp_ns(truth[-1]))
    assert off(last, origins[-1], truth) < 10.0
    assert again.stop(signal.SIGTERM) == 0, again.text()
    assert "Traceback" not in again.text()


def test_an_estimator_killed_in_flight_goes_on_from_its_state(launch, observer, tmp_path: Path) -> None:
    """GIVEN an estimator that keeps its state in a file WHEN it is killed in flight and started again
    THEN it is silent for less than three seconds of its data, in the same axes, and right within sigma at once."""
    told, file = Told(observer, "pose_estimator"), tmp_path / "drone.state"
    settings = (*DIAGNOSTICS, "-p", f"ros.state.file:={file}")
    odometry = observer.listen(Odometry, "/odometry/filtered", DEEP)
    origins = observer.listen(NavSatFix, "/pose_estimator/origin", LATCHED)
    truth = observer.listen(Odometry, "/ground_truth/odom", DEEP)
    node = launch("pose_estimator", *settings)
    node.wait_for("ready")
    fly(launch, "multirotor_light")

    def has_seen_the_heading() -> bool:
        lasted = convert.stamp_ns(odometry[-1]) - convert.stamp_ns(odometry[0]) if odometry else 0
        return told.mode == "AIDED" and lasted > 45 * 10**9

    observer.until(has_seen_the_heading, "flight")
    assert node.stop(signal.SIGKILL) == -signal.SIGKILL
    before = origins[-1]
    for heard in (odometry, origins):
        heard.clear()
    told.forget()
    again = launch("pose_estimator", *settings)
    observer.until(lambda: told.mode == "AIDED" and len(odometry) > 100, "AIDED again")
    text = again.text()
    gap, silent_until = (
        float(re.search(words, text)[1]) for words in (r"a state from (\S+) s ago", r"continues after (\S+) s")
    )
    assert silent_until - gap < 3.0, text
    assert (before.latitude, before.longitude, before.altitude) == pytest.approx(
        (origins[-1].latitude, origins[-1].longitude, origins[-1].altitude), abs=1e-9
    )
    first = next(m for m in odometry if convert.stamp_ns(m) <= convert.stamp_ns(truth[-1]))
    sigma = math.sqrt(first.pose.covariance[0] + first.pose.covariance[7])
    assert off(first, origins[-1], truth) < 3.0 * sigma
    assert again.stop(signal.SIGTERM) == 0, again.text()
    assert "Traceback" not in again.text()


def test_a_learner_killed_in_flight_begins_with_its_saved_model(launch, observer, tmp_path: Path) -> None:
    """GIVEN anfis_node that saves its model after each training WHEN it is killed in flight and started again
    THEN it knows at once what it had learned, and predicts when GNSS is lost; the navigator has flown on."""
    file = tmp_path / "drone.model"
    settings = ("-p", f"ros.model.file:={file}", "-p", "ros.model.save_after_training:=true")
    navigator, learner = Told(observer, "sins_node"), Told(observer, "anfis_node")
    predictions = observer.listen(TwistWithCovarianceStamped, "/outage/velocity_error", DEEP)
    pilot, student = launch("sins_node", *DIAGNOSTICS), launch("anfis_node", *DIAGNOSTICS, *settings)
    pilot.wait_for("ready")
    student.wait_for("ready")
    fly(launch, "multirotor_light")
    observer.until(file.exists, "a model on disk")
    assert student.stop(signal.SIGKILL) == -signal.SIGKILL
    learner.forget()
    again = launch("anfis_node", *DIAGNOSTICS, *settings)
    observer.until(lambda: learner.mode == "AIDED", "the model in use again")
    assert f"the model was loaded from {file}" in again.text()
    assert navigator.mode == "AIDED"
    observer.call(SetBool, "/sins_node/use_gnss", SetBool.Request(data=False))
    observer.until(lambda: len(predictions) > 10, "predictions")
    twists = [message.twist for message in predictions]
    assert all(math.isfinite(x) for t in twists for x in (*convert.vector(t.twist.linear), *t.covariance))
    for node in (again, pilot):
        assert node.stop(signal.SIGTERM) == 0, node.text()
        assert "Traceback" not in node.text()
