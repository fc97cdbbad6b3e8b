"""The integrator against motions that are known exactly."""

import math

import numpy as np
import pytest
from exact_motion import Motion, Signal, aerobatics, rest, survey, times_of, zero_covariance
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from imu_run import run_imu
from nav_pose_estimator.core.earth.ellipsoid import (
    OMEGA,
    ecef_to_enu_matrix,
    ecef_to_lla,
    gravity,
    gravity_many,
    lla_to_ecef,
    radii,
)
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.filter.blocks import GYRO_MATRIX, GaussMarkov
from nav_pose_estimator.core.filter.constants import make_constants
from nav_pose_estimator.core.filter.strapdown import flush_covariance, propagate, unaided_velocities
from nav_pose_estimator.core.numerics.jit import COMPILED
from nav_pose_estimator.core.numerics.rotation import quat_multiply, rotvec_from_quat_many


def constants(**changes):
    numbers = {
        "gyro_noise": 1e-4,
        "accel_noise": 1e-3,
        "gyro_bias_sd": 1e-5,
        "gyro_bias_tau": 300.0,
        "accel_bias_sd": 1e-3,
        "accel_bias_tau": 300.0,
        "covariance_period": 0.02,
        "gap_dt": 0.5,
        "gap_rate_sd": 0.3,
        "gap_accel_sd": 2.0,
    }
    return make_constants(**(numbers | changes))


WITHOUT_COVARIANCE = constants(covariance_period=1e9)


def navigate(motion, times, numbers=WITHOUT_COVARIANCE, point_sampled=False):
    """Errors (N, 9) along a motion that is integrated from its true start."""
    nav = motion.nav(times[0])
    rows = motion.imu_rows(times, point_sampled)
    out = np.empty((len(rows), at.OUT_COLUMNS))
    run_imu(nav, zero_covariance(), numbers, rows, out)
    p, v, q = out[:, at.OUT_POS :], out[:, at.OUT_VEL :], out[:, at.OUT_QUAT :]
    return motion.error(out[:, at.OUT_T], p[:, 0], p[:, 1], p[:, 2], v[:, :3], q[:, :4])


@pytest.mark.parametrize("lat", [-1.2, 0.0, 0.8])
def test_an_hour_at_rest_drifts_less_than_a_metre(lat):
    motion, times = rest(lat), times_of(3600.0, 200.0 if COMPILED else 5.0)
    rows = np.tile(motion.imu_rows(times[:2]), (len(times) - 1, 1))
    rows[:, 0] = times[1:]
    nav = motion.nav(0.0)
    run_imu(nav, zero_covariance(), WITHOUT_COVARIANCE, rows, np.empty((len(rows), at.OUT_COLUMNS)))
    assert np.abs(motion.error_of(nav)[at.DPOS : at.DPOS + 3]).max() < 0.1
    assert np.abs(motion.error_of(nav)[at.PHI : at.PHI + 3]).max() < 1e-9


def test_aerobatics_come_back_within_a_centimetre():
    errors = navigate(aerobatics(), times_of(60.0, 200.0))
    assert np.linalg.norm(errors[-1, at.DPOS : at.DPOS + 3]) < 0.01
    assert np.abs(errors[:, at.PHI : at.PHI + 3]).max() < 2e-5


def test_aerobatics_from_instantaneous_samples():
    # The trapezoidal rule is blunter than true means, but far better than to take one for the other.
    numbers = constants(point_sampled=True, covariance_period=1e9)
    as_points, as_means = (
        navigate(aerobatics(), times_of(60.0, 400.0), c, True) for c in (numbers, WITHOUT_COVARIANCE)
    )
    assert np.linalg.norm(as_points[-1, at.DPOS : at.DPOS + 3]) < 0.5
    assert np.linalg.norm(as_means[-1, at.DPOS : at.DPOS + 3]) > 5.0


def test_error_falls_at_least_with_the_square_of_the_interval():
    ends = [np.linalg.norm(navigate(aerobatics(), times_of(12.0, rate))[-1, at.DPOS :]) for rate in (50.0, 100.0)]
    assert ends[0] / ends[1] > 3.5


def test_schuler_period():
    # GIVEN a navigator at rest on the equator that believes to be tilted about East, its height held
    motion, tilt, rate = rest(0.0), 1e-4, 2.0
    times = times_of(2700.0, rate)
    nav = motion.nav(0.0)
    nav[at.QUAT : at.QUAT + 4] = quat_multiply(np.array([1.0, 0.5 * tilt, 0.0, 0.0]), nav[at.QUAT : at.QUAT + 4])
    north = []
    for row in motion.imu_rows(times):
        propagate(nav, zero_covariance(), WITHOUT_COVARIANCE, row)
        nav[at.ALT], nav[at.VEL + 2] = 100.0, 0.0
        north.append(nav[at.VEL + 1])
    # THEN its North velocity swings with the period of a pendulum as long as the radius of the Earth
    north = np.array(north)
    last = np.flatnonzero(np.diff(np.sign(north[10:])))[0] + 10
    crossing = times[1:][last] + north[last] / (north[last] - north[last + 1]) / rate
    R_M, _ = radii(0.0)
    assert 2.0 * crossing == pytest.approx(2.0 * math.pi * math.sqrt((R_M + 100.0) / gravity(0.0, 100.0)), rel=0.01)


def test_free_fall_agrees_with_newton_in_earth_fixed_axes():
    # GIVEN a body that feels no force and does not turn in inertial space, thrown at 300 m/s
    lat, lon, alt, v_n = 0.8, 0.2, 30000.0, np.array([200.0, -150.0, 160.0])

    def fall(_, state):
        lat, lon, h = ecef_to_lla(state[:3])
        down = -gravity_many(lat, h) * ecef_to_enu_matrix(lat, lon)[2]
        coriolis = 2.0 * OMEGA * np.array([-state[4], state[3], 0.0])
        return np.concatenate((state[3:], down - coriolis))

    start = np.concatenate((lla_to_ecef(lat, lon, alt), ecef_to_enu_matrix(lat, lon).T @ v_n))
    end = solve_ivp(fall, (0.0, 60.0), start, method="DOP853", rtol=1e-12, atol=1e-9).y[:, -1]
    # WHEN the navigator integrates zeros
    nav = np.zeros(at.NAV_SIZE)
    nav[[at.LAT, at.LON, at.ALT]] = lat, lon, alt
    nav[at.VEL : at.VEL + 3] = v_n
    nav[at.QUAT] = 1.0
    rows = np.zeros((6000, at.IMU_COLUMNS))
    rows[:, 0] = times_of(60.0, 100.0)[1:]
    run_imu(nav, zero_covariance(), WITHOUT_COVARIANCE, rows, np.empty((len(rows), at.OUT_COLUMNS)))
    # THEN it falls along the same curve, and its attitude counts the turn of the level frame
    C_en = ecef_to_enu_matrix(nav[at.LAT], nav[at.LON])
    assert np.allclose(lla_to_ecef(nav[at.LAT], nav[at.LON], nav[at.ALT]), end[:3], rtol=0.0, atol=0.01)
    assert np.allclose(C_en.T @ nav[at.VEL : at.VEL + 3], end[3:], rtol=0.0, atol=1e-3)
    turn = OMEGA * 60.0
    earth = np.array([[math.cos(turn), -math.sin(turn), 0.0], [math.sin(turn), math.cos(turn), 0.0], [0.0, 0.0, 1.0]])
    x, y, z, w = Rotation.from_matrix(C_en @ earth.T @ ecef_to_enu_matrix(lat, lon).T).as_quat()
    difference = rotvec_from_quat_many(quat_multiply(nav[at.QUAT : at.QUAT + 4] * (1, -1, -1, -1), (w, x, y, z)))
    assert np.abs(difference).max() < 1e-8


def test_coning_needs_the_rate_of_the_interval_before():
    # GIVEN a body whose axis runs round a cone of 3 deg, ten times a second
    cone = 2.0 * math.pi * 10.0
    wobble = math.radians(3.0)
    motion = Motion(
        Signal(0.8),
        Signal(0.2),
        Signal(100.0),
        roll=Signal(waves=[(wobble, cone, 0.0)]),
        pitch=Signal(waves=[(wobble, cone, math.pi / 2)]),
    )
    times = times_of(20.0, 200.0)
    with_coning = np.abs(navigate(motion, times)[:, at.PHI : at.PHI + 3]).max()
    # WHEN the memory is emptied before each interval THEN the attitude drifts much more
    nav = motion.nav(0.0)
    for row in motion.imu_rows(times):
        nav[at.PREV_RATE : at.PREV_RATE + 3] = 0.0
        propagate(nav, zero_covariance(), WITHOUT_COVARIANCE, row)
    without_coning = np.abs(motion.error_of(nav)[at.PHI : at.PHI + 3]).max()
    assert with_coning < 0.05 * without_coning
    assert with_coning < 1e-3


def test_an_interval_may_be_split():
    # GIVEN intervals that are cut in two at 30 %, with the same means in both parts
    motion, times = survey(), times_of(20.0, 200.0)
    rows = motion.imu_rows(times)
    first = rows.copy()
    first[:, 0] = times[:-1] + 0.3 * np.diff(times)
    whole, halves = motion.nav(0.0), motion.nav(0.0)
    P_whole, P_halves = np.eye(15) * 1e-4, np.eye(15) * 1e-4
    for row, part in zip(rows, first, strict=True):
        propagate(whole, P_whole, constants(), row)
        propagate(halves, P_halves, constants(), part)
        propagate(halves, P_halves, constants(), row)
    flush_covariance(whole, P_whole, constants())
    flush_covariance(halves, P_halves, constants())
    # THEN nothing is lost but part of the coning term
    difference = motion.error_of(whole) - motion.error_of(halves)
    assert np.abs(difference[at.DPOS : at.DPOS + 3]).max() < 1e-3
    assert np.abs(difference[at.PHI : at.PHI + 3]).max() < 1e-6
    assert np.allclose(P_whole, P_halves, rtol=1e-3, atol=1e-9)


def test_a_block_equals_its_rows_bit_for_bit():
    rows = aerobatics().imu_rows(times_of(2.0, 200.0))
    one, many = aerobatics().nav(0.0), aerobatics().nav(0.0)
    P_one, P_many = np.eye(15), np.eye(15)
    for row in rows:
        propagate(one, P_one, constants(), row)
    run_imu(many, P_many, constants(), rows, np.empty((len(rows), at.OUT_COLUMNS)))
    assert np.array_equal(one, many)
    assert np.array_equal(P_one, P_many)


@pytest.mark.parametrize("dt", [0.0, -0.01, math.nan])
def test_a_row_that_is_not_later_does_nothing(dt):
    nav = aerobatics().nav(5.0)
    before, P = nav.copy(), np.eye(15)
    propagate(nav, P, constants(), np.array([5.0 + dt, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0]))
    assert np.array_equal(nav, before)
    assert np.array_equal(P, np.eye(15))


def test_biases_and_gyro_matrix_are_taken_out():
    # GIVEN a gyroscope with bias and scale errors that the navigator knows
    motion, times = survey(), times_of(10.0, 200.0)
    M = np.array([[2e-4, 1e-4, 0.0], [0.0, -3e-4, 1e-4], [1e-4, 0.0, 2e-4]])
    rows = motion.imu_rows(times)
    rows[:, 1:4] = rows[:, 1:4] @ (np.eye(3) + M).T + (1e-3, -2e-3, 3e-3)
    rows[:, 4:] += (0.1, -0.2, 0.3)
    nav = motion.nav(0.0)
    nav[at.GYRO_BIAS : at.GYRO_BIAS + 3] = 1e-3, -2e-3, 3e-3
    nav[at.ACCEL_BIAS : at.ACCEL_BIAS + 3] = 0.1, -0.2, 0.3
    nav[at.GYRO_MATRIX : at.GYRO_MATRIX + 9] = M.ravel()
    numbers = constants(blocks={GYRO_MATRIX: GaussMarkov()}, covariance_period=1e9)
    run_imu(nav, np.zeros((24, 24)), numbers, rows, np.empty((len(rows), at.OUT_COLUMNS)))
    # THEN the motion is that of the true rates (the inverse of I + M is taken to first order)
    assert np.linalg.norm(motion.error_of(nav)[at.DPOS : at.DPOS + 3]) < 0.01


def test_a_gap_opens_the_covariance():
    # GIVEN a second without samples in a calm flight
    motion = survey()
    times = np.concatenate((times_of(5.0, 200.0), 6.0 + times_of(5.0, 200.0)))
    nav, P = motion.nav(0.0), np.eye(15) * 1e-8
    run_imu(nav, P, constants(), motion.imu_rows(times, True), np.empty((len(times) - 1, at.OUT_COLUMNS)))
    sd = np.sqrt(np.diag(P))
    # THEN the attitude is as uncertain as the unknown rate makes it, and what was lost is covered
    assert sd[at.PHI] > 0.29
    assert sd[at.DVEL] > 1.9
    assert np.all(np.abs(motion.error_of(nav)) < 3.0 * sd[:9])
    assert nav[at.SUM_GAP] == 0.0
    assert np.linalg.eigvalsh(P).min() > 0.0


@pytest.mark.parametrize("lat", [math.pi / 2, -math.pi / 2, 1.5707, 1.57])
def test_a_pole_gives_finite_numbers(lat):
    nav, P = np.zeros(at.NAV_SIZE), np.eye(15)
    nav[at.LAT], nav[at.QUAT] = lat, 1.0
    nav[at.VEL : at.VEL + 3] = 50.0, 50.0, 0.0
    rows = np.tile([0.0, 0.0, 0.0, 0.1, 0.0, 0.0, 9.83], (2000, 1))
    rows[:, 0] = times_of(20.0, 100.0)[1:]
    out = np.empty((len(rows), at.OUT_COLUMNS))
    run_imu(nav, P, constants(), rows, out)
    assert np.isfinite(out).all()
    assert np.isfinite(P).all()
    assert np.abs(out[:, at.OUT_POS + 1]).max() <= math.pi


def test_the_date_line_is_crossed():
    motion = Motion(Signal(0.3), Signal(math.pi - 1e-5, slope=1e-5), Signal(50.0))
    nav = motion.nav(0.0)
    rows = motion.imu_rows(times_of(2.0, 100.0))
    run_imu(nav, zero_covariance(), WITHOUT_COVARIANCE, rows, np.empty((len(rows), at.OUT_COLUMNS)))
    assert nav[at.LON] == pytest.approx(-math.pi + 1e-5, abs=1e-9)


def test_velocities_on_the_imu_alone_are_those_of_the_mechanization():
    # GIVEN aerobatics
    motion, second = aerobatics(), 200
    rows = motion.imu_rows(times_of(10.0, 200.0))
    whole, alone = motion.nav(0.0), motion.nav(0.0)
    out, trace, angle = np.empty((len(rows), at.OUT_COLUMNS)), np.empty((len(rows), 4)), np.zeros(3)
    run_imu(whole, zero_covariance(), WITHOUT_COVARIANCE, rows, out)
    # WHEN only the velocity is propagated, with latitude and gravity once a second
    for k in range(0, len(rows), second):
        part = slice(k, k + second)
        unaided_velocities(alone, WITHOUT_COVARIANCE, rows[part], np.zeros(3), trace[part], angle)
    # THEN it is the same horizontally, and vertically but for the change of gravity with the height
    apart = np.abs(out[:, at.OUT_VEL : at.OUT_VEL + 3] - trace[:, 1:]).max(axis=0)
    assert apart[:2].max() < 1e-6
    assert apart[2] < 1e-3
    assert trace[-1, 0] == whole[at.TIME]
