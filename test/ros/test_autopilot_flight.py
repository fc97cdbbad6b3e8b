"""Outages flown through the real node, and a simulated autopilot that takes what comes, or says why not."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message, serialize_message
from std_srvs.srv import Trigger
from test_nodes import Played, as_messages_see_them, lost_and_found

from autopilot_consumer import TO_FRD, TO_NED, Consumer, GpsInput, Mavros, Px4
from driver_types import VEHICLE_LOCAL_POSITION, make, sent
from nav_pose_estimator.core.earth.ellipsoid import lla_to_enu
from nav_pose_estimator.core.numerics.rotation import quat_to_matrix
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.imu.mounting import rotation_from_rpy
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import GnssFix, GnssVelocity, ImuBlock, ImuSample, MagSample, Sample
from nav_pose_estimator.engine.solutions import Mode, NavSolution
from nav_pose_estimator.nodes.pose_estimator import PoseEstimatorNode
from nav_pose_estimator.offline.flights.recording import load
from nav_pose_estimator.ros import qos
from nav_pose_estimator.ros.autopilot import link
from nav_pose_estimator.sim.recording import Recording
from nav_pose_estimator.sim.scenarios import generate

LOST, FOUND, LENGTH = 14.0, 24.0, 30.0  # s
GEOID = 47.0
ALWAYS = "ros.output.autopilot_when:=always"
HELD = ("gnss.reacquisition.policy:=hold", "gnss.reacquisition.implausible_time:=4.0")
WORDS: dict[str, tuple[str, type[Consumer]]] = {
    "mavros": ("autopilot/odometry", Mavros),
    "mavros_gps": ("autopilot/gps_input", GpsInput),
    "px4": ("fmu/in/vehicle_visual_odometry", Px4),
}


@pytest.fixture(scope="module")
def flight() -> Recording:
    return generate("multirotor_outage", duration=LENGTH, seed=2, imu_rate=100.0)


@dataclass
class Wired:
    """A node whose output goes to ``consumer``; ``arrivals``: when each message left, in IMU time [s]."""

    played: Played
    consumer: Consumer
    arrivals: list[float]
    kinds: dict[str, Callable[[Any], None]]

    @property
    def node(self) -> Any:
        return self.played.node

    def hear_px4(self, recording: Recording, t: float) -> None:
        """PX4 says where its local frame lies: 30 m North-East of ours, with its height above the sea."""
        lat, lon, alt = recording.origin
        at = {"ref_lat": np.degrees(lat) + 2e-4, "ref_lon": np.degrees(lon) + 2e-4, "ref_alt": alt - GEOID}
        stamp = (recording.start_ns + int(t * 1e9)) // 1000
        message = make(VEHICLE_LOCAL_POSITION, timestamp=stamp, xy_global=True, z_global=True, **at)
        self.kinds["fmu/out/vehicle_local_position"](message)


@pytest.fixture
def wired(started, monkeypatch) -> Callable[..., Wired]:
    """``wired(word, *parameters)``: the composed node with that autopilot; its messages pass through their bytes."""

    def make_wired(word: str, *parameters: str) -> Wired:
        topic, consumer = WORDS[word][0], WORDS[word][1]()
        arrivals: list[float] = []
        heard: dict[str, Callable[[Any], None]] = {}
        advertise, subscribe = qos.advertise, qos.subscribe

        def publish(message: Any) -> None:
            arrivals.append(wire.node.newest_ns * 1e-9)
            consumer.take(through_bytes(message), arrivals[-1])

        def our_advertise(node: Any, kind: Any, name: str, profile: Any = None) -> Any:
            if name == topic:
                return SimpleNamespace(publish=publish, get_subscription_count=lambda: 1)
            return advertise(node, kind, name, profile)

        def our_subscribe(node: Any, kind: Any, name: str, callback: Any, *others: Any, **more: Any) -> Any:
            if name.startswith("fmu/"):
                heard[name] = callback
                return None
            return subscribe(node, kind, name, callback, *others, **more)

        monkeypatch.setattr(qos, "advertise", our_advertise)
        monkeypatch.setattr(qos, "subscribe", our_subscribe)
        if word != "mavros":
            monkeypatch.setattr(link, "message_class", lambda name, word: partial(make, name))
        given = (f"ros.output.autopilot:={word}", f"ros.output.autopilot_geoid:={GEOID}", *parameters)
        node = started(PoseEstimatorNode, *(w for item in given for w in ("-p", item)))
        wire = Wired(Played(node), consumer, arrivals, heard)
        return wire

    return make_wired


def through_bytes(message: Any) -> Any:
    """As it arrives."""
    if isinstance(message, Odometry):
        return deserialize_message(serialize_message(message), Odometry)
    return sent(message)


def true_error(flight: Recording, consumer: Consumer, zero: np.ndarray) -> np.ndarray:
    """Distance [m] of every position that was taken from the true one; ``zero``: of the autopilot's frame, ENU [m]."""
    truth, errors = flight.truth, []
    for item in consumer.taken:
        i = min(round((item.t - flight.start_ns * 1e-9) / truth.dt), len(truth) - 1)
        true = lla_to_enu(truth.lat[i], truth.lon[i], truth.alt[i], *flight.origin) - zero
        errors.append(np.linalg.norm(item.position - TO_NED @ true))
    return np.array(errors)


# --- a simulated outage --------------------------------------------------------------------------------------------
@pytest.mark.parametrize("word", WORDS)
def test_a_simulated_autopilot_takes_everything_in_an_outage_and_only_then(wired, flight, word):
    """GIVEN ten seconds without GNSS WHEN the node flies them THEN the autopilot refuses nothing, gets 30 poses a
    second from the loss to the return and none before or after, and they are where the vehicle is."""
    wire = wired(word)
    if word == "px4":
        wire.hear_px4(flight, 0.0)
    wire.played.play(lost_and_found(flight, LOST, FOUND, 0.0))
    assert wire.consumer.refused == []
    seconds = np.array(wire.arrivals) - flight.start_ns * 1e-9
    modes = [(s.stamp_ns, s.mode) for s in wire.played.solutions if hasattr(s, "mode")]
    denied = [stamp for stamp, mode in modes if mode in (Mode.COASTING, Mode.DEAD_RECKONING, Mode.REACQUIRING)]
    lasted = (denied[-1] - denied[0]) * 1e-9
    assert LOST < seconds[0] < LOST + 3.0
    assert FOUND < seconds[-1] < FOUND + 5.0
    assert len(seconds) == pytest.approx(30.0 * lasted, rel=0.05)
    assert wire.played.count("autopilot.sending") == wire.played.count("autopilot.silent") == 1
    drifted = np.linalg.norm(wire.consumer.taken[-1].position - wire.consumer.taken[0].position)
    assert drifted > 1.0, "a vehicle that stands proves no frame"
    zero = {"px4": px4_zero(flight), "mavros": our_zero(wire, flight)}.get(word)
    if zero is not None:
        sigma = np.sqrt([item.position_var.sum() for item in wire.consumer.taken])
        assert (true_error(flight, wire.consumer, zero) < 3.0 * sigma + 1.0).all()


QUARTER = np.pi / 2.0
SIX_MOUNTINGS = {
    "as the body": (0.0, 0.0, 0.0),
    "to the left": (0.0, 0.0, QUARTER),
    "backwards": (0.0, 0.0, 2.0 * QUARTER),
    "on its head": (2.0 * QUARTER, 0.0, 0.0),
    "nose down": (0.0, QUARTER, 0.0),
    "on its side": (QUARTER, 0.0, 0.0),
}


def as_mounted(samples: Iterable[Sample], rpy: tuple[float, float, float]) -> Iterator[Sample]:
    """What the same flight looks like to an IMU, and the magnetometer on its board, that are mounted so."""
    to_sensor = rotation_from_rpy(rpy).T
    for sample in samples:
        if isinstance(sample, ImuSample):
            gyro, accel = (tuple((to_sensor @ np.array(part)).tolist()) for part in (sample.gyro, sample.accel))
            yield ImuSample(sample.stamp_ns, gyro, accel)
        elif isinstance(sample, MagSample):
            yield replace(sample, field=tuple((to_sensor @ np.array(sample.field)).tolist()))
        else:
            yield sample


@pytest.mark.parametrize("mounting", SIX_MOUNTINGS)
def test_an_autopilot_gets_the_body_however_the_imu_is_mounted(wired, flight, mounting):
    """GIVEN an IMU mounted in one of six ways, and told so WHEN GNSS is lost THEN what PX4 takes of attitude and
    velocity, in FRD and NED, is what the estimator makes of an IMU whose axes are the body's."""
    wire = wired("px4", f"imu.mounting_rpy:={list(SIX_MOUNTINGS[mounting])}")
    wire.hear_px4(flight, 0.0)
    wire.played.play(as_mounted(until(flight, LOST + 4.0), SIX_MOUNTINGS[mounting]))
    assert wire.consumer.refused == []
    assert len(wire.consumer.taken) > 30
    engine = PoseEstimator(Parameters())
    outputs = [o for sample in as_messages_see_them(until(flight, LOST + 4.0)) for o in engine.feed(sample)]
    plain = {round(o.stamp_ns * 1e-3): o for o in outputs if isinstance(o, NavSolution)}
    for item in wire.consumer.taken:
        solution = plain[round(item.t * 1e6)]
        np.testing.assert_allclose(item.attitude, TO_NED @ quat_to_matrix(solution.q_nb) @ TO_FRD, atol=1e-4)
        np.testing.assert_allclose(item.velocity, TO_NED @ solution.vel_n, atol=1e-3)


def until(flight: Recording, seconds: float) -> Iterator[Sample]:
    """The flight as far as ``seconds``, without GNSS from ``LOST`` on."""
    for sample in lost_and_found(flight, LOST, FOUND, 0.0):
        if isinstance(sample, ImuSample) and sample.stamp_ns - flight.start_ns > seconds * 1e9:
            return
        yield sample


def px4_zero(flight: Recording) -> np.ndarray:
    lat, lon, alt = flight.origin
    return lla_to_enu(lat + np.radians(2e-4), lon + np.radians(2e-4), alt, lat, lon, alt)


def our_zero(wire: Wired, flight: Recording) -> np.ndarray:
    """The first trusted position of the navigator, ENU of the simulator's origin."""
    return lla_to_enu(*wire.node.engine.origin, *flight.origin)


def fly_to_an_accepted_return(wire: Wired, flight: Recording) -> None:
    """Four seconds without GNSS, then a return 400 m off that the operator accepts."""
    samples = list(lost_and_found(flight, 10.0, 14.0, 400.0))
    while samples and not wire.played.count("gnss.held"):
        wire.played.play([samples.pop(0)])
    assert wire.played.services["accept_return"](Trigger.Request(), Trigger.Response()).success
    wire.played.play(samples)


def test_mavros_gets_no_jump_where_the_position_is_reset(wired, flight):
    """GIVEN when: always WHEN GNSS comes back 400 m off and is taken THEN map jumps and what MAVROS gets does not."""
    wire = wired("mavros", ALWAYS, *HELD)
    fly_to_an_accepted_return(wire, flight)
    assert np.linalg.norm(wire.played.solutions[-1].correction_enu) > 300.0
    assert wire.consumer.refused == []
    assert wire.arrivals[0] < flight.start_ns * 1e-9 + 10.0
    assert len({item.t for item in wire.consumer.taken}) > 400


def test_px4_is_told_of_the_jump_where_the_position_is_reset(wired, flight):
    """GIVEN when: always WHEN GNSS comes back 400 m off and is taken THEN the reset counter says so, PX4 takes it."""
    wire = wired("px4", ALWAYS, *HELD)
    wire.hear_px4(flight, 0.0)
    fly_to_an_accepted_return(wire, flight)
    assert wire.consumer.refused == []
    taken = wire.consumer.taken
    jumps = [np.linalg.norm(b.position - a.position) for a, b in pairwise(taken) if b.resets != a.resets]
    assert len(jumps) == 1
    assert jumps[0] > 300.0


def test_without_a_word_from_px4_only_velocity_is_given(wired, flight):
    wire = wired("px4")
    wire.played.play(lost_and_found(flight, LOST, FOUND, 0.0))
    assert wire.consumer.refused == []
    assert len(wire.consumer.taken) > 200
    assert all(np.isnan(item.position).all() for item in wire.consumer.taken)


def test_a_dry_run_sends_nothing_and_says_it_once_a_second(wired, flight):
    wire = wired("mavros", "ros.output.autopilot_dry_run:=true")
    wire.played.play(lost_and_found(flight, LOST, FOUND, 0.0))
    assert wire.arrivals == []
    assert 9 <= wire.played.count("autopilot.dry_run") <= 16


def test_an_expired_pose_is_no_longer_sent(started, wired, flight):
    wire = wired("mavros")
    wire.node._set_parameters(replace_expiry(wire.node.parameters, 5.0))
    wire.played.play(lost_and_found(flight, LOST, LENGTH, 0.0))
    assert wire.played.count("mode.expired") == 1
    assert wire.arrivals[-1] - flight.start_ns * 1e-9 < LOST + 6.5
    assert wire.consumer.refused == []


def replace_expiry(parameters: Any, seconds: float) -> Any:
    return replace(parameters, navigator=replace(parameters.navigator, expire_after=seconds))


def test_an_outage_over_dds(started, observer, flight):
    """GIVEN a listener in another context WHEN GNSS is lost THEN it hears odometry with the frames of MAVROS."""
    played = Played(started(PoseEstimatorNode, "-p", "ros.output.autopilot:=mavros"))
    messages = observer.listen(Odometry, "autopilot/odometry")
    (publisher,) = (p for p in played.node.publishers if p.topic_name == "/autopilot/odometry")
    observer.until(publisher.get_subscription_count, "the listener")
    until = flight.start_ns + int((LOST + 3.0) * 1e9)
    played.play(s for s in lost_and_found(flight, LOST, LENGTH, 0.0) if (s.stamp_ns or 0) < until)
    observer.until(lambda: len(messages) >= 5, "odometry")
    assert Mavros().read(messages[-1]).t > flight.start_ns * 1e-9 + LOST
    assert (messages[-1].header.frame_id, messages[-1].child_frame_id) == ("odom", "base_link")


# --- feedback ------------------------------------------------------------------------------------------------------
def test_our_own_pose_as_gnss_is_not_used_and_named(wired, flight):
    """GIVEN an autopilot that publishes what it got from us as its position WHEN that comes in as gps/fix in an outage
    THEN no such fix aids the navigator, and one error names the loop."""
    wire = wired("mavros_gps")
    played, zero = wire.played, flight.start_ns
    for sample in lost_and_found(flight, LOST, LENGTH, 0.0):
        played.play([sample])
        if isinstance(sample, ImuSample) and (sample.stamp_ns - zero) % 200_000_000 == 0 and wire.consumer.taken:
            played.play(echo(wire, sample.stamp_ns))
    assert played.count("autopilot.feedback") == 1
    assert played.count("autopilot.feedback.fixes") > 10
    assert played.count("mode.aided") == 1  # at the start, not by ourselves
    assert played.node.engine.mode is not Mode.AIDED


def echo(wire: Wired, stamp_ns: int) -> Iterator[Sample]:
    """What the autopilot publishes: the last position that it got, in the steps of MAVLink, sure of itself."""
    message = wire.node._autopilot.channel.message
    lat, lon = np.radians([message.lat * 1e-7, message.lon * 1e-7]).tolist()
    yield GnssVelocity(stamp_ns, (message.ve, message.vn, -message.vd), np.eye(3) * 0.01)
    yield GnssFix(stamp_ns, lat, lon, message.alt + GEOID, 0, np.eye(3))


# --- a recorded outage ---------------------------------------------------------------------------------------------
@pytest.mark.compiled
@pytest.mark.parametrize("word", ["mavros", "px4"])
def test_a_recorded_outage_passes_through_it(wired, shared_data, word):
    """GIVEN a recorded flight of a quadrotor WHEN GNSS is taken away for 20 s THEN the autopilot takes every pose."""
    bag = shared_data / "flights" / "p4rtk_dot1_bag"
    recording = load(bag)
    wire = wired(word)
    if word == "px4":
        fix = recording.fixes[0]
        at = SimpleNamespace(start_ns=recording.epoch_ns, origin=(fix.lat, fix.lon, fix.alt))
        wire.hear_px4(at, 0.0)
    wire.played.play(without_gnss(recording, 110.0, 130.0, 135.0))
    assert wire.consumer.refused == []
    assert len(wire.consumer.taken) > 18 * 30
    travelled = np.ptp([item.position for item in wire.consumer.taken], axis=0)
    assert np.linalg.norm(travelled) > 5.0


def without_gnss(recording: Any, start: float, end: float, until: float) -> Iterable[Sample]:
    """The flight to ``until`` [s] as single samples, without GNSS from ``start`` to ``end``."""
    for sample in recording.samples:
        if isinstance(sample, ImuBlock):
            for single in sample.samples():
                if (single.stamp_ns - recording.epoch_ns) * 1e-9 > until:
                    return
                yield single
            continue
        t = ((sample.stamp_ns or 0) - recording.epoch_ns) * 1e-9
        if not (isinstance(sample, (GnssFix, GnssVelocity)) and start <= t < end):
            yield sample
