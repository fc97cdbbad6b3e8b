"""Messages to samples: units, axes, the three readings of a covariance, and nothing that is lost without a word."""

import math
from types import SimpleNamespace as Message

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from nav_pose_estimator.engine.samples import (
    Airspeed,
    AttitudeSample,
    GnssFix,
    GnssVelocity,
    ImuSample,
    NavigatorVelocity,
    SetPose,
)
from nav_pose_estimator.engine.solutions import Event
from nav_pose_estimator.ros.messages import convert, covariance, gps_umd, px4, satellites
from nav_pose_estimator.ros.messages.covariance import Knowledge

stamps = st.integers(1, 2**31 * 10**9 - 1)
numbers = st.floats(-1e6, 1e6)


def header(stamp_ns: int = 1_500_000_000, frame: str = "x") -> Message:
    return Message(stamp=Message(sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9), frame_id=frame)


def xyz(x=0.0, y=0.0, z=0.0) -> Message:
    return Message(x=x, y=y, z=z)


def unit(w=1.0, x=0.0, y=0.0, z=0.0) -> Message:
    return Message(w=w, x=x, y=y, z=z)


def imu_message(stamp_ns=1_500_000_000, gyro=(0, 0, 0), accel=(0, 0, 9.8), gyro_cov=0.0, accel_cov=0.0) -> Message:
    return Message(
        header=header(stamp_ns),
        orientation=unit(),
        orientation_covariance=np.zeros(9),
        angular_velocity=xyz(*gyro),
        angular_velocity_covariance=np.array([gyro_cov] + [0.0] * 8),
        linear_acceleration=xyz(*accel),
        linear_acceleration_covariance=np.array([accel_cov] + [0.0] * 8),
    )


def fix_message(status=0, cov=None, cov_type=2, lat=47.0, lon=8.5, alt=500.0) -> Message:
    return Message(
        header=header(),
        status=Message(status=status, service=1),
        latitude=lat,
        longitude=lon,
        altitude=alt,
        position_covariance=np.diag([1.0, 4.0, 9.0]).ravel() if cov is None else np.asarray(cov, float),
        position_covariance_type=cov_type,
    )


def twist_message(linear=(1.0, 2.0, 3.0), cov=None) -> Message:
    whole = np.zeros(36) if cov is None else np.asarray(cov, float)
    inner = Message(twist=Message(linear=xyz(*linear), angular=xyz()), covariance=whole)
    return Message(header=header(), twist=inner)


# --- covariance ----------------------------------------------------------------------------------------------------
@given(arrays(float, (3, 3), elements=st.floats(-1e3, 1e3)))
def test_every_proper_covariance_is_known(factor):
    matrix = factor @ factor.T + 1e-3 * np.eye(3)
    reading = covariance.read(matrix.ravel(), 3)
    assert reading.knowledge is Knowledge.KNOWN, reading.flaw
    np.testing.assert_allclose(reading.matrix, matrix, rtol=1e-9, atol=1e-9 * np.abs(matrix).max())


@given(arrays(float, 9, elements=st.floats(allow_nan=True, allow_infinity=True)))
def test_whatever_comes_a_known_covariance_is_sound(field):
    reading = covariance.read(field, 3)
    if reading.knowledge is not Knowledge.KNOWN:
        assert reading.matrix is None
        return
    assert np.isfinite(reading.matrix).all()
    assert np.array_equal(reading.matrix, reading.matrix.T)
    sd = np.sqrt(np.diag(reading.matrix))
    assert np.linalg.eigvalsh(reading.matrix / np.outer(sd, sd))[0] > -1e-8


@pytest.mark.parametrize(
    ("diagonal", "flaw"),
    [
        ((math.nan, 1, 1), "not_finite"),
        ((1, math.inf, 1), "not_finite"),
        ((1, -2, 1), "negative"),
        ((1, 1, 1.7e308), "too_large"),
        ((1, 0, 1), "zero_variance"),
    ],
)
def test_a_covariance_that_is_none_is_unknown_and_named(diagonal, flaw):
    reading = covariance.read(np.diag(diagonal).ravel(), 3)
    assert (reading.knowledge, reading.matrix, reading.flaw) == (Knowledge.UNKNOWN, None, flaw)


def test_asymmetric_and_indefinite_covariances_are_unknown():
    assert covariance.read([1, 0.5, 0, 0, 1, 0, 0, 0, 1], 3).flaw == "asymmetric"
    assert covariance.read([1, 2, 0, 2, 1, 0, 0, 0, 1], 3).flaw == "indefinite"


def test_zero_is_unknown_and_minus_one_absent():
    assert covariance.read(np.zeros(9), 3) == covariance.Reading(Knowledge.UNKNOWN)
    assert covariance.read([-1.0] + [0.0] * 8, 3) == covariance.Reading(Knowledge.ABSENT)


# --- IMU -----------------------------------------------------------------------------------------------------------
@given(stamps, st.tuples(numbers, numbers, numbers), st.tuples(numbers, numbers, numbers).filter(any))
def test_imu_keeps_stamp_and_values_exactly(stamp, gyro, accel):
    assert convert.imu(imu_message(stamp, gyro, accel)) == (ImuSample(stamp, gyro, accel),)


@pytest.mark.parametrize("half", ["gyro_cov", "accel_cov"])
def test_imu_without_one_half_is_refused_by_name(half):
    (event,) = convert.imu(imu_message(**{half: -1.0}))
    assert isinstance(event, Event)
    assert event.name == "imu.rejected.absent"


def test_orientation_of_an_imu_message():
    message = imu_message()
    message.orientation = unit(0.0, 0.0, 0.0, 0.99)
    message.orientation_covariance = np.diag([1e-4, 1e-4, 1e-2]).ravel()
    (sample,) = convert.imu_attitude(message)
    assert isinstance(sample, AttitudeSample)
    assert sample.q_nb == (0.0, 0.0, 0.0, 1.0)
    assert sample.cov_n[2, 2] == 1e-2
    message.orientation_covariance[0] = -1.0
    assert convert.imu_attitude(message)[0].name == "attitude.rejected.absent"
    message.orientation, message.orientation_covariance = unit(0.0), np.zeros(9)
    assert convert.imu_attitude(message)[0].name == "attitude.rejected.absent"


# --- GNSS ----------------------------------------------------------------------------------------------------------
def test_fix_in_radians_with_its_covariance():
    (fix,) = convert.nav_sat_fix(fix_message())
    assert (fix.lat, fix.lon, fix.alt, fix.status) == (math.radians(47.0), math.radians(8.5), 500.0, 0)
    np.testing.assert_array_equal(fix.cov_enu, np.diag([1.0, 4.0, 9.0]))


@pytest.mark.parametrize("status", [-2, -1])
def test_unknown_status_and_no_fix_stay_negative(status):
    assert convert.nav_sat_fix(fix_message(status))[0].status < 0


@pytest.mark.parametrize(
    ("cov", "cov_type"),
    [(np.zeros(9), 2), ([-1.0] + [0.0] * 8, 0), ([-1.0] + [0.0] * 8, 2), (np.eye(3).ravel(), 0)],
    ids=["zeros", "mavros_unknown", "absent", "type_unknown"],
)
def test_a_covariance_that_the_driver_does_not_know_is_none(cov, cov_type):
    assert convert.nav_sat_fix(fix_message(cov=cov, cov_type=cov_type))[0].cov_enu is None


def test_a_flawed_covariance_gives_the_fix_and_an_event():
    fix, event = convert.nav_sat_fix(fix_message(cov=np.diag([1.0, 1e308, 1.0]).ravel()))
    assert isinstance(fix, GnssFix)
    assert fix.cov_enu is None
    assert event.name == "gnss.position.covariance.too_large"


def test_velocity_of_ublox_marks_only_its_angular_part_as_absent():
    cov = np.zeros((6, 6))
    cov[0, 0] = cov[1, 1] = cov[2, 2] = 0.04
    cov[3, 3] = -1.0
    (velocity,) = convert.twist_with_covariance(twist_message(cov=cov.ravel()))
    assert velocity.vel_enu == (1.0, 2.0, 3.0)
    np.testing.assert_array_equal(velocity.cov_enu, 0.04 * np.eye(3))


def test_velocity_without_vertical_axis():
    message = Message(header=header(), twist=Message(linear=xyz(1.0, 2.0, 0.0), angular=xyz()))
    (velocity,) = convert.without_vertical(convert.twist)(message)
    assert velocity.vel_enu[:2] == (1.0, 2.0)
    assert math.isnan(velocity.vel_enu[2])
    assert velocity.cov_enu is None


def test_north_east_down_becomes_east_north_up():
    cov = np.zeros((6, 6))
    cov[:3, :3] = [[1.0, 0.1, 0.2], [0.1, 4.0, 0.3], [0.2, 0.3, 9.0]]
    (velocity,) = convert.from_ned(convert.twist_with_covariance)(twist_message((1.0, 2.0, 3.0), cov.ravel()))
    assert velocity.vel_enu == (2.0, 1.0, -3.0)
    np.testing.assert_array_equal(velocity.cov_enu, [[4.0, 0.1, -0.3], [0.1, 1.0, -0.2], [-0.3, -0.2, 9.0]])


def test_gpsfix_gives_position_velocity_and_count():
    message = fix_message()
    message.status = Message(status=0, satellites_used=9)
    message.track, message.speed, message.climb, message.err_speed, message.err_climb = 90.0, 5.0, -1.0, 0.98, 1.96
    (fix,), (velocity,) = gps_umd.fix(message), gps_umd.velocity(message)
    assert isinstance(fix, GnssFix)
    np.testing.assert_allclose(velocity.vel_enu, (5.0, 0.0, -1.0), atol=1e-12)
    np.testing.assert_allclose(np.diag(velocity.cov_enu), [0.25, 0.25, 1.0])
    assert satellites.from_gpsfix(message)[0].count == 9
    message.err_speed = math.nan
    assert gps_umd.velocity(message)[0].cov_enu is None


@pytest.mark.parametrize(
    ("adapter", "message", "count"),
    [
        (satellites.from_uint32, Message(data=12), 12),
        (satellites.from_uint32, Message(data=255), None),
        (satellites.from_gpsraw, Message(header=header(), satellites_visible=255), None),
        (satellites.from_gpsraw, Message(header=header(), satellites_visible=0), 0),
        (satellites.from_gpsfix, Message(header=header(), status=Message(status=0, satellites_used=0)), None),
        (satellites.from_gpsfix, Message(header=header(), status=Message(status=-1, satellites_used=0)), 0),
        (satellites.from_navpvt, Message(num_sv=17), 17),
        (px4.satellites, Message(timestamp=1, satellites_used=255), None),
    ],
)
def test_a_count_is_a_number_or_unknown_never_invented(adapter, message, count):
    assert adapter(message)[0].count == count


def px4_gps(**changes) -> Message:
    values = {
        "timestamp": 1_700_000_000_123_456,
        "timestamp_sample": 5,
        "latitude_deg": 47.0,
        "longitude_deg": 8.5,
        "altitude_ellipsoid_m": 548.0,
        "altitude_msl_m": 500.0,
        "fix_type": 3,
        "eph": 1.5,
        "epv": 2.0,
        "vel_n_m_s": 1.0,
        "vel_e_m_s": 2.0,
        "vel_d_m_s": 3.0,
        "s_variance_m_s": 0.3,
        "vel_ned_valid": True,
        "satellites_used": 14,
    }
    return Message(**{**values, **changes})


def test_px4_in_microseconds_down_and_above_the_ellipsoid():
    (fix,), (velocity,) = px4.fix(px4_gps()), px4.velocity(px4_gps())
    assert (fix.stamp_ns, fix.alt, fix.status) == (1_700_000_000_123_456_000, 548.0, 0)
    np.testing.assert_allclose(np.diag(fix.cov_enu), [2.25, 2.25, 4.0])
    assert velocity.vel_enu == (2.0, 1.0, -3.0)
    np.testing.assert_allclose(velocity.cov_enu, 0.09 * np.eye(3))


@pytest.mark.parametrize("fix_type", [0, 1, 2, 8])
def test_px4_without_a_3d_fix_is_no_fix(fix_type):
    assert px4.fix(px4_gps(fix_type=fix_type))[0].status < 0


def test_px4_says_what_is_not_valid():
    assert px4.velocity(px4_gps(vel_ned_valid=False))[0].name == "gnss.velocity.rejected.invalid"
    assert px4.fix(px4_gps(eph=math.nan))[0].cov_enu is None
    message = Message(timestamp=7, accelerometer_timestamp_relative=0x7FFFFFFF)
    assert px4.imu(message)[0].name == "imu.rejected.absent"
    single = np.array([1.0, 2.0, 3.0], np.float32)
    message = Message(timestamp=7, accelerometer_timestamp_relative=0, gyro_rad=single, accelerometer_m_s2=single)
    assert px4.imu(message) == (ImuSample(7000, (1.0, 2.0, 3.0), (1.0, 2.0, 3.0)),)


# --- the others ----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("value", "variance", "flaw"),
    [
        (0.0, None, ""),
        (4.0, 4.0, ""),
        (-3.0, None, "negative"),
        (math.nan, None, "not_finite"),
        (1e300, None, "too_large"),
    ],
)
def test_pressure_and_its_variance(value, variance, flaw):
    sample, *events = convert.fluid_pressure(Message(header=header(), fluid_pressure=95_000.0, variance=value))
    assert (sample.pressure, sample.variance) == (95_000.0, variance)
    assert [event.name for event in events] == ([f"baro.covariance.{flaw}"] if flaw else [])


# --- airspeed and range ----------------------------------------------------------------------------------------------


def test_an_airspeed_has_its_unit_its_stamp_and_no_invented_deviation():
    (told,) = convert.airspeed(Message(header=header(), twist=Message(linear=xyz(17.5, 1.0, 2.0))))
    assert (told.stamp_ns, told.speed) == (convert.stamp_ns(Message(header=header())), 17.5)
    assert math.isnan(told.sd)
    (told,) = convert.airspeed_number(Message(data=17.5))
    assert (told.stamp_ns, told.speed) == (None, 17.5)


def test_a_differential_pressure_passes_with_its_sign():
    message = Message(header=header(), fluid_pressure=-3.0, variance=0.0)
    assert convert.differential_pressure(message)[0].pressure == -3.0


@pytest.mark.parametrize(("speed", "is_there"), [(12.0, True), (0.0, False), (-1.0, False), (math.nan, False)])
def test_px4_says_without_an_airspeed_that_it_has_none(speed, is_there):
    (item,) = px4.airspeed(Message(timestamp=5, true_airspeed_m_s=speed))
    assert isinstance(item, Airspeed) is is_there
    assert item.stamp_ns == 5000
    assert is_there or item.name == "airspeed.rejected.absent"


def range_message(distance: float, lowest: float = 0.3, farthest: float = 40.0, variance: float = 0.0) -> Message:
    return Message(
        header=header(), field_of_view=0.2, min_range=lowest, max_range=farthest, range=distance, variance=variance
    )


@pytest.mark.parametrize(
    ("distance", "lowest", "farthest"),
    [
        (0.2, 0.3, 40.0),
        (41.0, 0.3, 40.0),
        (math.inf, 0.3, 0.0),
        (-math.inf, 0.0, 40.0),
        (math.nan, 0.3, 40.0),
        (-1.0, 0, 0),
    ],
)
def test_a_range_outside_its_own_limits_is_none(distance, lowest, farthest):
    """REP-117: -Inf too close, +Inf out of reach, NaN an error."""
    (event,) = convert.range_to_ground(range_message(distance, lowest, farthest))
    assert event.name == "range.rejected.outside"


def test_a_range_within_its_limits_keeps_what_the_sensor_says():
    (told,) = convert.range_to_ground(range_message(12.0, variance=0.04))
    assert (told.distance, told.field_of_view, told.sd) == (12.0, 0.2, 0.2)
    (told,) = convert.range_to_ground(range_message(12.0, 0.0, 0.0))  # limits that are not filled
    assert math.isnan(told.sd)
    told, event = convert.range_to_ground(range_message(12.0, variance=-2.0))
    assert (event.name, told.distance) == ("range.covariance.negative", 12.0)


def pose_message(frame="map", orientation=None, position=(1.0, 2.0, 3.0)) -> Message:
    pose = Message(position=xyz(*position), orientation=orientation or unit())
    return Message(header=header(frame=frame), pose=Message(pose=pose, covariance=np.zeros(36)))


def test_set_pose_only_in_its_frame_and_only_with_numbers():
    assert isinstance(convert.set_pose(pose_message("/map"))[0], SetPose)
    assert isinstance(convert.set_pose(pose_message(""))[0], SetPose)
    assert convert.set_pose(pose_message("odom"))[0].name == "set_pose.rejected.frame"
    assert convert.set_pose(pose_message(orientation=unit(0.0)))[0].name == "set_pose.rejected.nan"
    assert convert.set_pose(pose_message(position=(math.nan, 0.0, 0.0)))[0].name == "set_pose.rejected.nan"


def test_velocity_of_odometry_is_turned_into_the_world():
    half = math.sqrt(0.5)
    message = Message(
        header=header(),
        pose=Message(
            pose=Message(orientation=unit(half, 0.0, 0.0, half)),
            covariance=np.diag([1.0, 1.0, 1.0, 4e-4, 1e-4, 9e-4]).ravel(),
        ),
        twist=Message(twist=Message(linear=xyz(2.0, 0.0, 1.0)), covariance=np.eye(6).ravel()),
    )
    (sample,) = convert.odometry_velocity(message)
    assert isinstance(sample, NavigatorVelocity)
    assert sample.valid
    np.testing.assert_allclose(sample.vel_enu, (0.0, 2.0, 1.0), atol=1e-15)
    np.testing.assert_allclose((sample.tilt_sd, sample.heading_sd), (0.02, 0.03))
    message.twist.covariance = message.pose.covariance = np.zeros(36)
    (sample,) = convert.odometry_velocity(message)
    assert not sample.valid
    assert math.isnan(sample.tilt_sd)
    assert math.isnan(sample.heading_sd)


def test_a_message_without_a_stamp_has_stamp_zero():
    message = twist_message()
    message.header = header(0)
    sample = convert.twist_with_covariance(message)[0]
    assert isinstance(sample, GnssVelocity)
    assert sample.stamp_ns == 0
