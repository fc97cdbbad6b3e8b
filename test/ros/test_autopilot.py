"""The way back to the autopilot, piece by piece: frames with known answers, times, permission, echoes, misuse."""

import math
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from nav_msgs.msg import Odometry

from autopilot_consumer import TO_FRD, TO_NED, GpsInput, Mavros, Px4, matrix
from driver_types import GPSINPUT, VEHICLE_LOCAL_POSITION, VEHICLE_ODOMETRY, make, sent
from nav_pose_estimator.core.earth.gps_time import week_and_milliseconds
from nav_pose_estimator.core.numerics.rotation import quat_from_euler
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import ParameterError, update
from nav_pose_estimator.engine.samples import GnssFix
from nav_pose_estimator.engine.solutions import Mode, NavSolution
from nav_pose_estimator.nodes.sins_node import SinsNode
from nav_pose_estimator.ros import qos
from nav_pose_estimator.ros.autopilot import link
from nav_pose_estimator.ros.autopilot.channels import MavrosGps, MavrosOdometry, Px4Odometry, quality
from nav_pose_estimator.ros.autopilot.echo import EchoWatch, Finding
from nav_pose_estimator.ros.autopilot.frames import attitude_frd_to_ned, px4_north_east
from nav_pose_estimator.ros.autopilot.permission import Permission
from nav_pose_estimator.ros.autopilot.px4_clock import Px4Clock, reference

STAMP = 1_700_000_000_123_000_000
NORTH, EAST, DOWN = np.eye(3)
WITH_GEOID = update(Parameters(), {"ros.output.autopilot_geoid": 47.0}).ros


def solution(
    q_nb: np.ndarray | None = None, correction: tuple[float, ...] = (0.0, 0.0, 0.0), resets: int = 0, **change
):
    rng = np.random.default_rng(4)
    root = rng.normal(size=(15, 15))
    parts = {
        "lat": math.radians(47.4),
        "lon": math.radians(8.55),
        "alt": 500.0,
        "vel_n": np.array([1.0, 2.0, -3.0]),
        "q_nb": np.array([1.0, 0.0, 0.0, 0.0]) if q_nb is None else q_nb,
        "rate_b": np.array([0.1, 0.2, 0.3]),
        "cov": root @ root.T,
        "position_enu": np.array([10.0, 20.0, 30.0]),
        **change,
    }
    return NavSolution.of(STAMP, Mode.DEAD_RECKONING, correction_enu=np.array(correction), reset_count=resets, **parts)


# --- frames --------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("euler_enu", "nose", "right", "down"),
    [
        ((0, 0, 0), EAST, -NORTH, DOWN),  # nose to the East: its right is the South
        ((0, 0, 90), NORTH, EAST, DOWN),
        ((0, 0, 180), -EAST, NORTH, DOWN),
        ((0, 0, -90), -NORTH, -EAST, DOWN),
        ((0, -90, 0), -DOWN, -NORTH, EAST),  # nose up from facing East: the belly looks forward
        ((180, 0, 90), NORTH, -EAST, -DOWN),  # on its back, nose to the North
    ],
)
def test_six_attitudes_in_the_axes_of_autopilots(euler_enu, nose, right, down):
    C = matrix(attitude_frd_to_ned(quat_from_euler(*np.radians(euler_enu))))
    np.testing.assert_allclose(C.T, [nose, right, down], atol=1e-12)


def test_any_attitude_turns_as_its_matrix_and_back():
    for q in np.random.default_rng(1).normal(size=(50, 4)):
        q /= np.linalg.norm(q)
        turned = attitude_frd_to_ned(q)
        assert turned[0] >= 0.0
        np.testing.assert_allclose(matrix(turned), TO_NED @ matrix(q) @ TO_FRD, atol=1e-12)
        np.testing.assert_allclose(matrix(attitude_frd_to_ned(turned)), matrix(q), atol=1e-12)


def test_the_projection_of_px4_has_its_own_metres():
    """On the sphere of 6371 km; 0.01 degrees of latitude are 1111.949 m there, on the ellipsoid 1111.84 m."""
    lat, lon = math.radians(47.4), math.radians(8.55)
    north, east = px4_north_east(lat + math.radians(0.01), lon, lat, lon)
    assert (north, east) == pytest.approx((1111.949, 0.0), abs=1e-3)
    north, east = px4_north_east(lat, lon + math.radians(0.01), lat, lon)
    assert east == pytest.approx(1111.949 * math.cos(lat), abs=1e-3)
    assert px4_north_east(lat, lon, lat, lon) == (0.0, 0.0)
    tiny = px4_north_east(lat + 1e-8, lon, lat, lon)
    assert tiny[0] == pytest.approx(0.06371, abs=1e-8)


# --- messages ------------------------------------------------------------------------------------------------------
def test_odometry_for_mavros_starts_in_map_and_does_not_jump():
    """GIVEN 5 m of earlier corrections WHEN sending begins and 7 m more come THEN the position begins in map and goes
    on without them, the twist is in the body, and the attitude that MAVROS makes of it is right."""
    channel, q = MavrosOdometry(Odometry(), Parameters().ros), quat_from_euler(0.1, -0.2, 1.3)
    first = solution(q, (5.0, 0.0, 0.0))
    channel.begin(first)
    channel.fill(first)
    taken = Mavros().read(channel.message)
    np.testing.assert_allclose(taken.position, [20.0, 10.0, -30.0])
    np.testing.assert_allclose(taken.velocity, [2.0, 1.0, 3.0])
    np.testing.assert_allclose(taken.attitude, matrix(attitude_frd_to_ned(q)), atol=1e-12)
    later = solution(q, (12.0, 0.0, 0.0), position_enu=np.array([17.0, 20.0, 30.0]))
    channel.fill(later)
    np.testing.assert_allclose(Mavros().read(channel.message).position, [20.0, 10.0, -30.0])
    body = channel.message.twist.twist.linear
    np.testing.assert_allclose([body.x, body.y, body.z], matrix(q).T @ [1.0, 2.0, -3.0])


def test_a_gps_input_has_the_fields_of_a_receiver():
    """2023-11-14 22:13:20.123 UTC, a Tuesday: two days, 80000 s and 18 leap seconds into week 2288."""
    channel, given = MavrosGps(make(GPSINPUT), WITH_GEOID), solution()
    channel.fill(given)
    message = sent(channel.message)
    assert (message.time_week, message.time_week_ms) == (2288, 252_818_123)
    assert (message.lat, message.lon, message.alt) == (474_000_000, 85_500_000, 453.0)
    assert (message.vn, message.ve, message.vd) == (2.0, 1.0, 3.0)
    P = np.diag(given.cov)
    assert message.horiz_accuracy == pytest.approx(math.sqrt(P[6] + P[7]), rel=1e-6)
    assert message.vert_accuracy == pytest.approx(math.sqrt(P[8]), rel=1e-6)
    assert message.speed_accuracy == pytest.approx(math.sqrt(P[3:6].sum()), rel=1e-6)
    assert (message.fix_type, message.ignore_flags, message.satellites_visible, message.yaw) == (3, 6, 255, 0)
    GpsInput().read(message)


@pytest.mark.parametrize(
    ("utc_s", "week", "second"),
    [
        (1_483_228_800, 1930, 18),  # the leap second of 2017 has just gone by: Sunday 0 h UTC
        (1_554_595_182, 2048, 0),  # the second rollover of ten bits, 2019-04-06 23:59:42 UTC
        (1_700_000_000, 2288, 252_818),
        (77, 0, 0),  # time since boot
    ],
)
def test_gps_weeks(utc_s, week, second):
    assert week_and_milliseconds(utc_s * 10**9) == (week, second * 1000)


def local_position(**values):
    known = {"xy_global": True, "z_global": True, "ref_lat": 47.39, "ref_lon": 8.55, "ref_alt": 400.0}
    return make(VEHICLE_LOCAL_POSITION, **{**known, **values})


def test_a_vehicle_odometry_lies_in_the_local_frame_of_px4():
    channel, q = Px4Odometry(make(VEHICLE_ODOMETRY), WITH_GEOID), quat_from_euler(0.1, -0.2, 1.3)
    channel.reference = reference(local_position())
    given = solution(q)
    channel.fill(given)
    message = sent(channel.message)
    taken = Px4().read(message)
    np.testing.assert_allclose(taken.position, [1111.949, 0.0, -53.0], atol=2e-3)
    np.testing.assert_allclose(taken.velocity, [2.0, 1.0, 3.0])
    np.testing.assert_allclose(taken.attitude, matrix(attitude_frd_to_ned(q)), atol=1e-6)
    np.testing.assert_allclose(message.angular_velocity, [0.1, -0.2, -0.3], rtol=1e-6)
    P = given.cov
    np.testing.assert_allclose(message.position_variance, np.diag(P)[[7, 6, 8]], rtol=1e-6)
    np.testing.assert_allclose(message.velocity_variance, np.diag(P)[[4, 3, 5]], rtol=1e-6)
    np.testing.assert_allclose(message.orientation_variance, np.diag(matrix(q).T @ P[:3, :3] @ matrix(q)), rtol=1e-5)
    assert message.timestamp == message.timestamp_sample == STAMP // 1000


def test_a_position_without_a_frame_is_unknown_and_a_height_without_a_geoid_counts_for_nothing():
    channel = Px4Odometry(make(VEHICLE_ODOMETRY), Parameters().ros)
    channel.fill(solution())
    assert np.isnan(channel.message.position).all()
    assert np.isnan(channel.message.position_variance).all()
    assert np.isfinite(channel.message.velocity).all()
    channel.reference = reference(local_position())
    channel.fill(solution())
    assert channel.message.position[2] == -30.0
    assert channel.message.position_variance[2] > 9_999.0


def test_every_discontinuity_counts_as_a_reset_for_px4():
    channel = Px4Odometry(make(VEHICLE_ODOMETRY), WITH_GEOID)
    counts = []
    steps = [
        lambda: channel.begin(solution()),
        lambda: None,
        lambda: setattr(channel, "reference", reference(local_position())),
        lambda: setattr(channel, "reference", reference(local_position(ref_timestamp=9, ref_lat=47.0))),
    ]
    for step in steps:
        step()
        channel.fill(solution())
        counts.append(channel.message.reset_counter)
    channel.fill(solution(resets=255))
    assert counts == [1, 1, 2, 3]
    assert channel.message.reset_counter == 2


def test_quality_falls_with_sigma_and_is_never_unknown():
    assert [quality(sigma) for sigma in (0.0, 0.5, 1.0, 4.0, 50.0, 1e6)] == [100, 100, 100, 25, 2, 1]


# --- time ----------------------------------------------------------------------------------------------------------
def test_stamps_pass_where_px4_keeps_our_time_and_are_moved_where_it_does_not():
    in_step, apart = Px4Clock(), Px4Clock()
    assert in_step.stamp_us(STAMP) == STAMP // 1000
    for delay_us in (3000, 500, 9000):
        in_step.note((STAMP // 1000) - delay_us, STAMP)
        apart.note(60_000_000 - delay_us, STAMP)
    assert in_step.stamp_us(STAMP) == STAMP // 1000
    assert apart.stamp_us(STAMP) == 60_000_000 - 500
    apart.note(1_000_000, STAMP)  # PX4 has started again
    assert apart.stamp_us(STAMP) == 1_000_000


# --- permission ----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("always", "answers"),
    [(False, [False, True, True, True, False, False, False, True]), (True, [True] * 4 + [False, False, True, True])],
)
def test_an_expired_pose_is_not_given_again_before_gnss_has_aided(always, answers):
    """The last but two is the trap: a fix under test makes REACQUIRING of EXPIRED, and the position no better."""
    modes = (
        *(Mode.AIDED, Mode.DEAD_RECKONING, Mode.COASTING, Mode.REACQUIRING),
        *(Mode.EXPIRED, Mode.REACQUIRING, Mode.AIDED, Mode.DEAD_RECKONING),
    )
    permission = Permission(always)
    assert [permission.ask(mode) for mode in modes] == answers


def test_a_navigator_that_has_started_again_begins_a_new_stretch(monkeypatch):
    """GIVEN when: always WHEN three seconds are missing THEN PX4 counts a reset, and one only."""
    heard = []
    publisher = SimpleNamespace(publish=lambda m: heard.append(m.reset_counter), get_subscription_count=lambda: 1)
    monkeypatch.setattr(qos, "advertise", lambda *_: publisher)
    monkeypatch.setattr(qos, "subscribe", lambda *_: None)
    monkeypatch.setattr(link, "message_class", lambda name, word: partial(make, name))
    node = SimpleNamespace(resolve_topic_name=str, say=lambda *_: None)
    values = {"ros.output.autopilot": "px4", "ros.output.autopilot_when": "always"}
    output = link.autopilot_link(node, update(Parameters(), values))
    for i in [*range(100), *range(400, 500)]:
        output.publish(replace(solution(), stamp_ns=STAMP + i * 10_000_000, mode=Mode.AIDED))
    assert set(heard[:20]) == {1}
    assert set(heard[-20:]) == {2}


# --- echoes --------------------------------------------------------------------------------------------------------
def flown(watch: EchoWatch, seconds: float, noise: float, sigma: float = 8.0, delay: float = 0.1) -> list[Finding]:
    """Send a straight flight at 30 Hz, 15 m/s; fixes at 5 Hz are what was sent ``delay`` ago, ``noise`` [m] off."""
    rng, findings = np.random.default_rng(3), []
    lat, lon = 0.8, 0.1
    for i in range(int(seconds * 30)):
        t = i / 30
        watch.sent(STAMP + int(t * 1e9), lat + 15.0 * t / 6.37e6, lon, sigma)
        if i % 6 == 5:
            north, east = rng.normal(scale=noise, size=2) if noise else (0.0, 0.0)
            then = t - delay
            fix = GnssFix(
                STAMP + int(then * 1e9),
                round((lat + (15.0 * then + north) / 6.37e6) * 1.8e9 / math.pi) * math.pi / 1.8e9,
                round((lon + east / 4.44e6) * 1.8e9 / math.pi) * math.pi / 1.8e9,
                500.0,
            )
            findings.append(watch.judge(fix))
    return findings


@pytest.mark.parametrize("lag", [0.0, 0.04])
def test_our_own_track_that_comes_back_is_a_loop_named_once(lag):
    """As it is (a receiver that is us), or as a filter has fused it: 4 cm beside it, of a sigma of 8 m."""
    findings = flown(EchoWatch(), 6.0, noise=lag)
    assert findings.count(Finding.LOOP) == 1
    assert set(findings) == {Finding.SUSPECT, Finding.LOOP}
    assert findings.index(Finding.LOOP) == 15  # 3 s of fixes at 5 Hz


@pytest.mark.parametrize("noise", [0.5, 1.5])
def test_a_receiver_that_agrees_is_no_loop(noise):
    """GIVEN a return of GNSS exactly where the estimate is WHEN its noise is that of a receiver THEN it is used."""
    findings = flown(EchoWatch(), 60.0, noise)
    assert Finding.LOOP not in findings
    assert findings.count(Finding.SUSPECT) < 0.35 * len(findings)


def test_a_loop_ends_with_a_fix_of_its_own_and_outlives_the_end_of_sending():
    watch = EchoWatch()
    flown(watch, 6.0, noise=0.0)
    watch.stopped()
    away = GnssFix(STAMP, 0.81, 0.1, 500.0)
    assert watch.judge(away) is Finding.SUSPECT  # nothing to compare it with
    assert watch.suspects
    watch.sent(STAMP, 0.8, 0.1, 8.0)
    assert watch.judge(away) is Finding.ENDED
    assert watch.judge(away) is Finding.NONE
    assert not watch.suspects


# --- the consumers of the closed loop can say no -------------------------------------------------------------------
def px4_message(**change):
    message = make(
        VEHICLE_ODOMETRY, timestamp=10**9, timestamp_sample=10**9, pose_frame=1, velocity_frame=1, quality=50
    )
    message.q[:] = (1, 0, 0, 0)
    for name in ("position", "velocity", "orientation"):
        getattr(message, f"{name}_variance")[:] = 1.0
    for name, value in change.items():
        if isinstance(value, (tuple, float)):
            getattr(message, name)[:] = value
        else:
            setattr(message, name, value)
    return message


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"pose_frame": 2}, "frame"),
        ({"velocity_frame": 3}, "frame"),
        ({"q": (0.999, 0.0, 0.0, 0.0)}, "attitude"),
        ({"position": (0.0, math.nan, 0.0)}, "position"),
        ({"position_variance": 0.0}, "covariance"),
        ({"velocity_variance": math.nan}, "covariance"),
        ({"velocity": math.nan}, "velocity"),
        ({"timestamp_sample": 998_000_000}, "time"),
        ({"timestamp_sample": 1_100_000_000}, "time"),
        ({"quality": 0}, "quality"),
    ],
)
def test_the_simulated_px4_refuses(change, why):
    consumer = Px4()
    consumer.take(px4_message(), 1000.01)
    assert consumer.refused == []
    consumer.taken.clear()
    consumer.take(px4_message(**change), 1000.01)
    assert [reason.split(":")[0] for reason in consumer.refused] == [why]


@pytest.mark.parametrize(
    ("dt", "north", "counter", "why"),
    [(0.1, 0.5, 0, None), (0.0, 0.0, 0, "time"), (0.3, 0.0, 0, "rate"), (0.1, 5.0, 0, "jump"), (0.1, 5.0, 1, None)],
)
def test_the_simulated_px4_refuses_what_does_not_follow(dt, north, counter, why):
    consumer = Px4()
    consumer.take(px4_message(), 1000.0)
    stamp = 10**9 + int(dt * 1e6)
    later = px4_message(timestamp_sample=stamp, position=(north, 0.0, 0.0), reset_counter=counter)
    consumer.take(later, 1000.0 + dt)
    assert [reason.split(":")[0] for reason in consumer.refused] == ([why] if why else [])


# --- misuse --------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("given", "says"),
    [
        (("autopilot:=mavros_gps", "autopilot_geoid:=47.0"), "needs mavros_msgs/GPSINPUT, but mavros_msgs is not inst"),
        (("autopilot:=px4",), "px4_msgs is not installed here; install ros-jazzy-px4-msgs or choose another word"),
        (("autopilot:=ardupilot",), "'ardupilot' is not one of none, mavros, mavros_gps, px4"),
        (("autopilot:=mavros", "autopilot_rate:=0.0"), "autopilot_rate: 0 is below the minimum 5 Hz"),
        (("autopilot:=mavros_gps",), "set ros.output.autopilot_geoid to the height of the geoid"),
    ],
)
def test_misuse_ends_in_one_sentence(started, given, says):
    for package in ("mavros_msgs", "px4_msgs"):
        if says.find(package) >= 0 and _is_installed(package):
            pytest.skip(f"{package} is installed here")
    with pytest.raises(ParameterError, match=says) as told:
        started(SinsNode, *(word for item in given for word in ("-p", f"ros.output.{item}")))
    assert "\n" not in str(told.value)


def _is_installed(package: str) -> bool:
    try:
        __import__(f"{package}.msg")
    except ImportError:
        return False
    return True


def test_the_fused_position_as_gnss_is_told_at_the_start(started):
    node = started(SinsNode, "-p", "ros.output.autopilot:=mavros", "-r", "gps/fix:=/mavros/global_position/global")
    assert node.logbook.counters["autopilot.feedback.topic"] == 1


def test_without_an_autopilot_nothing_is_advertised(started):
    node = started(SinsNode)
    assert [p.topic_name for p in node.publishers if "autopilot" in p.topic_name or "fmu" in p.topic_name] == []
