"""Nodes with their real engines, fed through their callbacks: equal to the engines alone, and hard to kill."""

import math
from collections.abc import Iterable
from dataclasses import fields, replace

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from sensor_msgs.msg import NavSatFix
from std_srvs.srv import SetBool, Trigger

from nav_pose_estimator.core.attitude import layout as attitude_layout
from nav_pose_estimator.engine.attitude.engine import AttitudeEngine
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import BodyVelocity, GnssFix, GnssVelocity, ImuSample, MagSample, Sample
from nav_pose_estimator.engine.solutions import AttitudeSolution, Event, Mode, NavSolution
from nav_pose_estimator.nodes.attitude_node import AttitudeNode
from nav_pose_estimator.nodes.pose_estimator import PoseEstimatorNode
from nav_pose_estimator.nodes.sins_node import SinsNode
from nav_pose_estimator.ros.messages import convert
from nav_pose_estimator.ros.messages.outgoing import fill_origin
from nav_pose_estimator.ros.messages.sample_messages import TOPICS, to_message
from nav_pose_estimator.sim.recording import Recording
from nav_pose_estimator.sim.scenarios import generate


@pytest.fixture(scope="module")
def flight() -> Recording:
    return generate("multirotor_outage", duration=30.0, seed=2, imu_rate=100.0)


class Played:
    """Feeds messages to a node through the callbacks of its subscriptions and keeps what it would publish."""

    def __init__(self, node) -> None:
        self.node = node
        self.solutions: list = []
        self.callbacks = {s.topic_name: s.callback for s in node.subscriptions}
        self.services = {s.srv_name.rpartition("/")[2]: s.callback for s in node.services}
        publish = node.publish
        node.publish = lambda solution: (self.solutions.append(solution), publish(solution))

    def play(self, samples: Iterable[Sample]) -> list:
        for sample in samples:
            topic = f"/{TOPICS[type(sample)][0]}"
            message = to_message(sample)
            if topic in self.callbacks:
                self.callbacks[topic](serialize_message(message) if isinstance(sample, ImuSample) else message)
        return self.solutions

    def count(self, name: str) -> int:
        return self.node.logbook.counters[name]


@pytest.fixture
def estimator(started) -> Played:
    return Played(started(PoseEstimatorNode, "-p", "ros.output.odometry_rate:=0.0"))


def as_messages_see_them(samples: Iterable[Sample]) -> Iterable[Sample]:
    """Angles go through degrees on their way: the same rounding for both sides."""
    for sample in samples:
        yield convert.nav_sat_fix(to_message(sample))[0] if isinstance(sample, GnssFix) else sample


def numbers(solutions: Iterable) -> list[tuple]:
    """Every number of every solution, to compare bit for bit."""
    return [
        tuple(
            value.tobytes() if isinstance(value, np.ndarray) else value
            for value in (getattr(s, item.name) for item in fields(s))
        )
        for s in solutions
    ]


def navigation(solutions: Iterable) -> list[NavSolution]:
    return [s for s in solutions if isinstance(s, NavSolution)]


# --- one estimator -------------------------------------------------------------------------------------------------
def test_online_equals_offline_bit_for_bit(estimator, flight):
    samples = list(flight.samples(blocks=False))
    engine = PoseEstimator()
    offline = [o for s in as_messages_see_them(samples) for o in engine.feed(s) if not isinstance(o, Event)]
    online = estimator.play(samples)
    assert navigation(online)[-1].mode is Mode.AIDED
    assert len(navigation(online)) > 2000
    assert numbers(online) == numbers(offline)


def test_online_equals_offline_with_a_declination_from_the_model(started, flight):
    """GIVEN a navigator that asks the model WHEN a flight is flown THEN its date is that of the stamps, not today."""
    pytest.importorskip("pygeomag", reason="needs pygeomag (make setup)")
    options = ("aids.declination_from_model:=true", "ros.output.odometry_rate:=0.0")
    node = Played(started(PoseEstimatorNode, *(a for option in options for a in ("-p", option))))
    samples = list(flight.samples(blocks=False))[:1500]
    engine = PoseEstimator(update(Parameters(), {"aids.declination_from_model": True}))
    offline = [o for s in as_messages_see_them(samples) for o in engine.feed(s) if not isinstance(o, Event)]
    online = node.play(samples)
    assert math.degrees(node.node.engine.sins.run.parameters.aids.declination) == pytest.approx(3.3, abs=0.2)
    assert navigation(online)
    assert numbers(online) == numbers(offline)


def test_the_attitude_node_takes_the_declination_at_the_origin_of_the_navigator(started):
    """GIVEN attitude_node alone WHEN the navigator tells its origin THEN the declination is that of place and date."""
    pytest.importorskip("pygeomag", reason="needs pygeomag (make setup)")
    node = Played(started(AttitudeNode, "-p", "aids.declination_from_model:=true"))
    message = NavSatFix()
    fill_origin(message, 1_700_000_000_000_000_000, (math.radians(47.6205), math.radians(-122.3493), 60.0))
    node.callbacks["/sins_node/origin"](message)
    assert math.degrees(node.node.engine.memory.state[attitude_layout.DECLINATION]) == pytest.approx(15.2, abs=0.1)
    assert node.count("mag.declination.model") == 1


def test_the_attitude_node_hears_the_wheels(started):
    """GIVEN attitude_node alone in a car WHEN it drives off THEN it does what its engine does with the wheels."""
    samples = [
        s
        for s in generate("road_vehicle_wheels", duration=40.0, seed=2, imu_rate=50.0).samples(blocks=False)
        if isinstance(s, (ImuSample, MagSample, BodyVelocity))
    ]
    online = Played(started(AttitudeNode)).play(samples)
    with_wheels, without = (
        numbers(o for s in samples if isinstance(s, kinds) for o in engine.feed(s) if isinstance(o, AttitudeSolution))
        for engine, kinds in (
            (AttitudeEngine(), (ImuSample, MagSample, BodyVelocity)),
            (AttitudeEngine(), (ImuSample, MagSample)),
        )
    )
    assert numbers(online) == with_wheels
    assert with_wheels != without


def test_a_second_lap_equals_the_first_bit_for_bit(estimator, flight):
    """Scenario 10: a bag is played twice in a loop."""
    samples = list(flight.samples(blocks=False))
    first = numbers(estimator.play(samples))
    estimator.solutions.clear()
    second = numbers(estimator.play(samples))
    assert second == first
    assert estimator.count("reset") == 1


def test_an_outage_drill_through_the_service(estimator, flight):
    samples = list(flight.samples(blocks=False))
    half = len(samples) // 2
    estimator.play(samples[:half])
    assert estimator.node.engine.mode is Mode.AIDED
    answer = estimator.services["use_gnss"](SetBool.Request(data=False), SetBool.Response())
    assert answer.success
    estimator.play(samples[half:])
    assert estimator.node.engine.mode is Mode.DEAD_RECKONING
    assert "operator" in estimator.node.engine.status().gnss_refusal


def test_reset_through_the_service_aligns_again(estimator, flight):
    samples = list(flight.samples(blocks=False))
    estimator.play(samples[:2500])
    answer = estimator.services["reset"](Trigger.Request(), Trigger.Response())
    assert answer.success
    assert estimator.node.engine.mode is Mode.WAITING_IMU


def lost_and_found(flight: Recording, start: float, end: float, east: float) -> Iterable[Sample]:
    """The flight without GNSS from ``start`` to ``end`` [s]; afterwards its fixes lie ``east`` [m] off."""
    zero = int(flight.imu.stamps_ns[0])
    for sample in flight.samples(blocks=False):
        is_gnss = isinstance(sample, (GnssFix, GnssVelocity))
        t = (sample.stamp_ns - zero) * 1e-9 if is_gnss else 0.0
        if start <= t < end:
            continue
        if isinstance(sample, GnssFix) and t >= end:
            sample = replace(sample, lon=sample.lon + east / (6.38e6 * math.cos(sample.lat)))
        yield sample


@pytest.fixture
def held(started, flight) -> Played:
    """A node with policy hold whose GNSS has come back 400 m off; what is left of the flight is in ``rest``."""
    option = "gnss.reacquisition.policy:=hold", "gnss.reacquisition.implausible_time:=4.0"
    node = Played(started(PoseEstimatorNode, *(a for o in option for a in ("-p", o))))
    samples = list(lost_and_found(flight, 10.0, 14.0, 400.0))
    while samples and not node.count("gnss.held"):
        node.play([samples.pop(0)])
    node.rest = samples
    return node


def test_a_return_that_is_held_is_taken_when_the_operator_accepts(held):
    """GIVEN policy hold and GNSS back 400 m off WHEN the operator accepts THEN the next fix moves the position."""
    assert held.node.engine.mode is Mode.REACQUIRING
    before = navigation(held.solutions)[-1]
    answer = held.services["accept_return"](Trigger.Request(), Trigger.Response())
    assert answer.success
    assert "accepted" in answer.message
    held.play(held.rest)
    after = navigation(held.solutions)[-1]
    assert after.mode is Mode.AIDED
    assert abs(after.lon - before.lon) * 6.38e6 * math.cos(after.lat) > 300.0
    again = held.services["accept_return"](Trigger.Request(), Trigger.Response())
    assert not again.success
    assert "no return" in again.message


def test_a_return_that_is_held_stays_out_when_the_operator_refuses(held):
    """GIVEN policy hold and GNSS back 400 m off WHEN the operator refuses THEN it is held anew, and never taken."""
    answer = held.services["refuse_return"](Trigger.Request(), Trigger.Response())
    assert answer.success
    before = held.count("gnss.held")
    held.play(held.rest)
    assert held.count("gnss.held") > before
    assert held.count("gnss.return.refused") == 1
    assert navigation(held.solutions)[-1].mode is not Mode.AIDED


# --- bad input -----------------------------------------------------------------------------------------------------
def spoiled(samples: list[Sample], kind: str) -> list[Sample]:
    """The flight with damage in its third second and later."""
    imu = [i for i, s in enumerate(samples) if isinstance(s, ImuSample)]
    out = list(samples)
    at = imu[1500]
    good = samples[at]
    if kind == "nan":
        out[at] = ImuSample(good.stamp_ns, (math.nan,) * 3, good.accel)
    elif kind == "infinite":
        out[at] = ImuSample(good.stamp_ns, good.gyro, (math.inf, 0.0, 0.0))
    elif kind == "zero_stamp":
        out[at] = ImuSample(0, good.gyro, good.accel)
    elif kind == "duplicate":
        out.insert(at, good)
    elif kind == "backward":
        out.insert(at + 1, ImuSample(good.stamp_ns - 5_000_000, good.gyro, good.accel))
    elif kind == "gap":
        gap = range(good.stamp_ns, good.stamp_ns + 5_000_000_000)
        out = [s for s in out if s.stamp_ns is None or s.stamp_ns not in gap]
    return out


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        ("nan", "imu.rejected.nan"),
        ("infinite", "imu.rejected.nan"),
        ("zero_stamp", "imu.rejected.zero_stamp"),
        ("duplicate", "imu.rejected.duplicate"),
        ("backward", "imu.rejected.backward"),
        ("gap", "imu.gap"),
    ],
)
def test_bad_imu_data_is_counted_and_the_node_lives_on(estimator, flight, kind, name):
    solutions = estimator.play(spoiled(list(flight.samples(blocks=False)), kind))
    assert estimator.count(name) == 1
    assert navigation(solutions)[-1].mode is Mode.AIDED
    assert navigation(solutions)[-1].stamp_ns == flight.imu.stamps_ns[-1]
    assert all(np.isfinite(s.position_enu).all() for s in navigation(solutions))


def test_an_error_in_a_callback_is_counted_and_the_node_lives_on(estimator, flight):
    samples = list(flight.samples(blocks=False))[:100]
    fail = {"next": True}
    feed = estimator.node.engine.feed

    def failing(sample):
        if fail.pop("next", False):
            raise ZeroDivisionError("division by zero")
        return feed(sample)

    estimator.node.engine.feed = failing
    solutions = estimator.play(samples)
    assert estimator.count("callback.failed.imu/data_raw") == 1
    assert [s for s in solutions if isinstance(s, AttitudeSolution)]


def test_a_solution_that_is_not_a_number_is_withheld(estimator, flight):
    feed = estimator.node.engine.feed

    def poisoned(sample):
        outputs = feed(sample)
        for output in outputs:
            if isinstance(output, AttitudeSolution):
                output.q_nb[:] = math.nan
        return outputs

    estimator.node.engine.feed = poisoned
    assert estimator.play(list(flight.samples(blocks=False))[:50]) == []
    assert estimator.count("output.withheld.nan") > 0


def test_a_message_of_garbage_does_no_harm(estimator):
    estimator.callbacks["/imu/data_raw"](b"\x00\x01\x00\x00garbage")
    estimator.callbacks["/gps/fix"](None)
    assert estimator.count("callback.failed.imu/data_raw") == 1
    assert estimator.count("callback.failed.gps/fix") == 1


def test_fix_stamps_in_the_past_are_refused_by_name(estimator, flight):
    """A driver whose clock was never set: the fixes say 1970."""
    samples = []
    for sample in flight.samples(blocks=False):
        if isinstance(sample, GnssFix):
            old = sample.stamp_ns - flight.start_ns + 77_000_000_000
            sample = GnssFix(old, sample.lat, sample.lon, sample.alt, sample.status, sample.cov_enu)
        samples.append(sample)
    estimator.play(samples)
    assert estimator.node.engine.mode is not Mode.AIDED
    assert estimator.count("reset") == 0
    status = estimator.node.engine.status()
    assert any("rejected" in name and count for name, count in status.counters.items()), status.counters


# --- the nodes alone -----------------------------------------------------------------------------------------------
def test_the_navigator_alone_equals_the_navigator_in_the_composed_node(started, flight):
    samples = list(flight.samples(blocks=False))
    alone = Played(started(SinsNode)).play(samples)
    engine = PoseEstimator(attitude=False)
    composed = [o for s in as_messages_see_them(samples) for o in engine.feed(s) if isinstance(o, NavSolution)]
    assert numbers(alone) == numbers(composed)


def test_the_attitude_alone_levels_itself(started, flight):
    samples = [s for s in flight.samples(blocks=False) if isinstance(s, (ImuSample, MagSample))]
    solutions = Played(started(AttitudeNode)).play(samples)
    assert len(solutions) == len(flight.imu)
    up = np.array([0.0, 0.0, 1.0])
    w, x, y, z = solutions[150].q_nb
    tilted = np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
    w, x, y, z = flight.truth.q_nb[150]
    true = np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
    assert math.degrees(math.acos(min(tilted @ true, 1.0))) < 2.0, (tilted, true, up)
