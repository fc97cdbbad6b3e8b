"""Solutions to messages and back; raw bytes against whole messages; words for pilots."""

import math
from dataclasses import replace

import numpy as np
import pytest
from geometry_msgs.msg import PoseWithCovarianceStamped
from hypothesis import given
from hypothesis import strategies as st
from nav_msgs.msg import Odometry
from rclpy.serialization import serialize_message
from sensor_msgs.msg import Imu, NavSatFix

from nav_pose_estimator.core.attitude.layout import HEAD_SIZE
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.filter.layout import D_GYRO_BIAS, DPOS, DVEL, PHI
from nav_pose_estimator.core.numerics.rotation import quat_from_euler, quat_from_rotvec, quat_multiply, quat_to_matrix
from nav_pose_estimator.engine.samples import (
    Airspeed,
    BodyVelocity,
    GnssFix,
    GnssVelocity,
    ImuSample,
    MagSample,
    PressureSample,
    RangeToGround,
    SatelliteCount,
)
from nav_pose_estimator.engine.solutions import AttitudeSolution, Event, Level, Mode, NavSolution, Status
from nav_pose_estimator.ros import wording
from nav_pose_estimator.ros.logbook import Logbook
from nav_pose_estimator.ros.messages import convert, from_bytes, satellites
from nav_pose_estimator.ros.messages import outgoing as messages
from nav_pose_estimator.ros.messages.cdr import CdrError, peek_stamp_ns
from nav_pose_estimator.ros.messages.sample_messages import TOPICS, to_message
from nav_pose_estimator.sim.scenarios import SCENARIOS, generate

STAMP = 1_700_000_000_123_456_789
finite = st.floats(-1e9, 1e9)


# --- raw IMU -------------------------------------------------------------------------------------------------------
@given(
    st.text(st.characters(codec="ascii", exclude_characters="\0"), max_size=40),
    st.lists(finite, min_size=6, max_size=6),
)
def test_raw_imu_equals_the_whole_message(frame, values):
    message = to_message(ImuSample(STAMP, tuple(values[:3]), tuple(values[3:])))
    message.header.frame_id = frame
    data = serialize_message(message)
    assert from_bytes.imu(data) == convert.imu(message)
    assert peek_stamp_ns(data) == STAMP


def test_raw_imu_says_when_a_half_is_absent():
    message = to_message(ImuSample(STAMP, (0.0,) * 3, (0.0, 0.0, 9.8)))
    message.linear_acceleration_covariance[0] = -1.0
    assert from_bytes.imu(serialize_message(message))[0].name == "imu.rejected.absent"


def test_a_specific_force_of_exactly_zero_is_half_an_imu():
    message = to_message(ImuSample(STAMP, (0.1, 0.2, 0.3), (0.0,) * 3))
    (event,) = from_bytes.imu(serialize_message(message))
    assert event.name == "imu.rejected.absent"
    assert "both needed" in event.text
    assert convert.imu(message) == (event,)


@pytest.mark.parametrize(
    "spoil", [lambda d: d[:-40], lambda d: b"\x00\x00" + d[2:], lambda d: b"\x00\x07" + d[2:], lambda d: b""]
)
def test_damaged_bytes_are_one_kind_of_error(spoil):
    data = serialize_message(to_message(ImuSample(STAMP, (0.0,) * 3, (0.0, 0.0, 9.8))))
    with pytest.raises(CdrError):
        from_bytes.imu(spoil(data))


# --- samples out and in --------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("sample", "back"),
    [
        (ImuSample(STAMP, (0.1, 0.2, 0.3), (1.0, 2.0, 9.8)), convert.imu),
        (MagSample(STAMP, (1e-5, 2e-5, -4e-5)), convert.magnetic_field),
        (GnssFix(STAMP, 0.82, 0.15, 500.0, 0), convert.nav_sat_fix),
        (GnssVelocity(STAMP, (1.0, 2.0, 3.0)), convert.twist_with_covariance),
        (BodyVelocity(STAMP, (1.0, 2.0, 3.0)), convert.body_velocity),
        (PressureSample(STAMP, 95_000.0, 4.0), convert.fluid_pressure),
        (Airspeed(STAMP, 14.5), convert.airspeed),
        (RangeToGround(STAMP, 2.5, 0.25, 0.5), convert.range_to_ground),
        (SatelliteCount(None, 12), satellites.from_uint32),
        (SatelliteCount(None, None), satellites.from_uint32),
    ],
)
def test_a_sample_survives_the_way_through_a_message(sample, back):
    (result,) = back(to_message(sample))
    if isinstance(sample, Airspeed):  # its deviation is unknown, and NaN equals nothing
        assert (result.stamp_ns, result.speed) == (sample.stamp_ns, sample.speed)
    elif isinstance(sample, GnssFix):
        assert (result.lat, result.lon) == pytest.approx((sample.lat, sample.lon), abs=1e-15)
        assert result.cov_enu is None
    else:
        assert result == sample


def test_every_sensor_of_every_scenario_has_a_topic():
    """GIVEN a few seconds of each scenario THEN synthetic_sensors can publish all that its sensors measure."""
    kinds = {type(timed.sample) for name in SCENARIOS for timed in generate(name, 5.0, 1, imu_rate=50.0).others}
    assert {Airspeed, RangeToGround} <= kinds <= set(TOPICS)


def test_covariances_survive_too():
    cov = np.array([[2.0, 0.1, 0.2], [0.1, 3.0, 0.3], [0.2, 0.3, 4.0]])
    np.testing.assert_array_equal(
        convert.nav_sat_fix(to_message(GnssFix(STAMP, 0.8, 0.1, 5.0, 0, cov)))[0].cov_enu, cov
    )
    velocity = to_message(GnssVelocity(STAMP, (1.0, 2.0, 3.0), cov))
    np.testing.assert_array_equal(convert.twist_with_covariance(velocity)[0].cov_enu, cov)


# --- solutions -----------------------------------------------------------------------------------------------------
def solution(**changes) -> NavSolution:
    rng = np.random.default_rng(3)
    factor = 0.01 * rng.standard_normal((15, 15))
    parts = {
        "vel_n": np.array([5.0, -2.0, 1.0]),
        "q_nb": quat_from_euler(0.2, -0.3, 2.0),
        "rate_b": np.array([0.1, 0.2, 0.3]),
        "force_b": np.array([0.0, 0.0, 9.8]),
        "cov": factor @ factor.T,
        "position_enu": np.array([10.0, 20.0, 30.0]),
    }
    values = np.zeros(at.SOLUTION_SIZE)
    values[at.OUT_POS : at.OUT_VEL] = 0.8, 0.1, 500.0
    result = NavSolution(STAMP, Mode.AIDED, values, np.array([1.0, 2.0, 3.0]), 0)
    for name, value in {**parts, **changes}.items():
        getattr(result, name)[:] = value
    return result


def test_odometry_holds_the_pose_in_odom_and_the_velocity_in_the_body():
    message = Odometry()
    messages.fill_odometry(message, solution())
    p, v, q = message.pose.pose.position, message.twist.twist.linear, message.pose.pose.orientation
    assert (p.x, p.y, p.z) == (9.0, 18.0, 27.0)
    s = solution()
    np.testing.assert_allclose((v.x, v.y, v.z), quat_to_matrix(s.q_nb).T @ s.vel_n)
    np.testing.assert_array_equal((q.w, q.x, q.y, q.z), s.q_nb)
    assert convert.stamp_ns(message) == STAMP


def test_a_correction_moves_map_and_leaves_odom():
    before, after = Odometry(), Odometry()
    jump = np.array([30.0, -4.0, 2.0])
    messages.fill_odometry(before, solution())
    s = solution()
    messages.fill_odometry(after, solution(position_enu=s.position_enu + jump, correction_enu=s.correction_enu + jump))
    assert before == after
    pose = PoseWithCovarianceStamped()
    messages.fill_pose(pose, solution(position_enu=s.position_enu + jump))
    assert pose.pose.pose.position.x == 40.0


def test_covariances_are_those_of_sampled_errors():
    """GIVEN errors drawn from P WHEN each is applied to the state THEN pose and twist scatter as the messages say."""
    s, rng, n = solution(), np.random.default_rng(5), 40_000
    C, draws = quat_to_matrix(s.q_nb), rng.multivariate_normal(np.zeros(15), s.cov, n)
    poses, twists = np.empty((n, 6)), np.empty((n, 6))
    for i, x in enumerate(draws):
        q_hat = quat_multiply(quat_from_rotvec(-x[PHI : PHI + 3]), s.q_nb)
        poses[i] = [*x[DPOS : DPOS + 3], *(-x[PHI : PHI + 3])]
        v_b = quat_to_matrix(q_hat).T @ (s.vel_n + x[DVEL : DVEL + 3])
        twists[i] = [*(v_b - C.T @ s.vel_n), *x[D_GYRO_BIAS : D_GYRO_BIAS + 3]]
    for drawn, stated in (
        (poses, messages.pose_covariance(s.cov)),
        (twists, messages.twist_covariance(s.cov, C, s.vel_n)),
    ):
        sd = np.sqrt(np.diag(stated))
        np.testing.assert_allclose(np.cov(drawn.T) / np.outer(sd, sd), stated / np.outer(sd, sd), atol=0.03)


@pytest.mark.parametrize(
    ("mode", "status", "service", "kind"),
    [
        (Mode.AIDED, 0, 1, 3),
        (Mode.COASTING, -1, 0, 3),
        (Mode.DEAD_RECKONING, -1, 0, 3),
        (Mode.REACQUIRING, -1, 0, 3),
        (Mode.EXPIRED, -1, 0, 0),
    ],
)
def test_a_position_without_gnss_is_no_fix(mode, status, service, kind):
    """GIVEN an outage WHEN gps/filtered goes on THEN it says NO_FIX, and EXPIRED takes back the covariance, too."""
    message = NavSatFix()
    messages.fill_fix(message, replace(solution(), mode=mode))
    assert message.latitude == math.degrees(0.8)
    assert (message.status.status, message.status.service, message.position_covariance_type) == (status, service, kind)
    np.testing.assert_array_equal(message.position_covariance, solution().cov[6:9, 6:9].ravel())


def test_attitude_carries_its_covariance():
    s = AttitudeSolution(STAMP, np.zeros(HEAD_SIZE))
    s.q_nb[:], s.cov_n[:] = quat_from_euler(0.1, 0.2, 0.3), np.diag([1.0, 2.0, 3.0])
    message = Imu()
    messages.fill_imu(message, s)
    assert message.orientation.w == s.q_nb[0]
    assert message.orientation_covariance[8] == 3.0
    messages.fill_imu(message, s, "ned")
    assert message.orientation_covariance[0] == 2.0


@pytest.mark.parametrize("field", ["position_enu", "vel_n", "q_nb", "rate_b", "cov"])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_what_is_not_a_number_is_found(field, value):
    assert messages.is_finite(solution())
    assert not messages.is_finite(solution(**{field: np.full_like(getattr(solution(), field), value)}))


# --- words ---------------------------------------------------------------------------------------------------------
def status(mode=Mode.AIDED, **changes) -> Status:
    values = {
        "stamp_ns": STAMP,
        "mode": mode,
        "waiting_for": "",
        "seconds_coasting": 0.0,
        "horizontal_sd": 0.4,
        "horizontal_sd_in_30_s": 21.0,
        "gnss_refusal": "",
        "satellites": 12,
        "counters": {},
        "values": {"nis.x": math.inf},
    }
    return Status(**{**values, **changes})


def test_a_pilot_reads_what_matters():
    text = wording.sentence(status(Mode.DEAD_RECKONING, seconds_coasting=12.4, gnss_refusal="3 satellites"))
    assert text == (
        "DEAD_RECKONING: GNSS is lost, only the IMU is left, for 12 s, position good to 0.4 m (1 sigma), "
        "to 21 m in 30 s, GNSS refused: 3 satellites"
    )
    assert wording.sentence(status()) == "AIDED: GNSS is used, position good to 0.4 m (1 sigma)"


def test_coasting_names_what_holds_the_drift():
    """GIVEN an outage WHEN something bounds the drift THEN the status names that, and no aid that is not there."""
    text = wording.sentence(status(Mode.COASTING, held_by="the airspeed"))
    assert text.startswith("COASTING: GNSS is lost, the drift is held by the airspeed, position good to")
    assert wording.sentence(status(Mode.COASTING)).startswith("COASTING: GNSS is lost, the drift is held, position")


@pytest.mark.parametrize("mode", list(Mode))
def test_every_mode_has_a_level_and_words(mode):
    assert wording.sentence(status(mode, horizontal_sd=math.inf)).startswith(f"{mode.value}: ")
    assert wording.level_of(status(mode)) == {Mode.AIDED: 0, Mode.EXPIRED: 2}.get(mode, 1)
    assert dict(wording.facts(status(mode)))["nis.x"] == "unknown"


def test_a_silent_input_is_named():
    quiet = wording.InputReport("gps/fix", 9, 0.0, 0, 4.0, 0, True)
    never = wording.InputReport("imu/data_raw", 0, 0.0, 0, math.inf, 1, True)
    idle = wording.InputReport("baro", 0, 0.0, 0, math.inf, 0, False)
    assert wording.input_sentence([idle]) == (wording.OK, "all needed inputs arrive")
    level, text = wording.input_sentence([quiet, never, idle])
    assert (level, text) == (
        wording.WARN,
        "gps/fix silent for 4 s (0 publishers); imu/data_raw was never received (1 publishers)",
    )
    assert "last unknown s ago" in dict(wording.input_facts([never]))["imu/data_raw"]


def test_an_input_whose_publisher_has_died_is_named():
    """GIVEN predictions of anfis_node WHEN that dies THEN the navigator's diagnostics warn, though it can fly on."""
    gone = wording.InputReport("outage/velocity_error", 9, 0.0, 0, 4.0, 0, False, is_gone=True)
    lossy = wording.InputReport("imu/data_raw", 900, 200.0, 7, 0.0, 1, True, lost_lately=7)
    assert wording.input_sentence([gone, lossy]) == (
        wording.WARN,
        "outage/velocity_error: its publisher is gone; imu/data_raw: 7 messages lost",
    )


def test_the_log_counts_everything_and_repeats_itself_rarely():
    said: list[str] = []

    class Logger:
        debug = info = warning = error = staticmethod(said.append)

    book = Logbook(Logger)
    for _ in range(1000):
        book.note(Event(STAMP, "imu.rejected.nan", Level.WARN, "NaN"))
        book.note(Event(STAMP, "silent"))
    assert book.counters == {"imu.rejected.nan": 1000, "silent": 1000}
    assert said == ["NaN", "NaN (10 times so far)", "NaN (100 times so far)", "NaN (1000 times so far)"]
    for _ in range(3):
        book.note(Event(STAMP, "mode.aided", Level.INFO, "AIDED"))
    assert said[4:] == ["AIDED"] * 3
