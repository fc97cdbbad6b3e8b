"""The error model against the navigator itself, and the covariance step against matrix exponentials."""

import numpy as np
import pytest
from exact_motion import survey, zero_covariance
from scipy.linalg import expm

from filter_start import SUBSETS, names
from imu_run import run_imu
from nav_pose_estimator.core.earth.ellipsoid import cos_latitude, radii
from nav_pose_estimator.core.filter import error_model
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.filter.blocks import (
    AIRSPEED,
    BLOCKS,
    DEPTH,
    DVL,
    DVL_DELAY,
    GNSS_ERROR,
    GRAVITY,
    GYRO_MATRIX,
    WIND,
    GaussMarkov,
    state_count,
)
from nav_pose_estimator.core.filter.constants import make_constants
from nav_pose_estimator.core.filter.error_state import inject
from nav_pose_estimator.core.filter.strapdown import corrected_rate, propagate
from nav_pose_estimator.core.numerics.rotation import quat_conjugate, quat_multiply, quat_rotate, rotvec_from_quat_many

EARTH = 6.4e6
ALL_STATES = at.BASE_STATES + at.OPTIONAL_STATES
WANDERS = {
    WIND: GaussMarkov(0.1, 500.0),
    GYRO_MATRIX: GaussMarkov(1e-6),
    DVL: GaussMarkov((3e-5, 3e-5, 3e-5, 3e-5, 1e-5, 1e-6, 1e-6, 1e-6), 2000.0),
    DEPTH: GaussMarkov(1e-3, 900.0),
    GRAVITY: GaussMarkov(1e-6, 700.0),
    AIRSPEED: GaussMarkov(1e-4, 600.0),
    GNSS_ERROR: GaussMarkov((2e-4,) * 3 + (1e-4,) * 3, (60.0,) * 3 + (5.0,) * 3),
    DVL_DELAY: GaussMarkov(1e-3),
}


def constants(**changes):
    numbers = {
        "gyro_noise": 2e-4,
        "accel_noise": 3e-3,
        "gyro_bias_sd": 1e-4,
        "gyro_bias_tau": 100.0,
        "accel_bias_sd": 1e-2,
        "accel_bias_tau": 200.0,
        "covariance_period": 1e9,
        "gap_dt": 1.0,
        "gap_rate_sd": 0.3,
        "gap_accel_sd": 2.0,
        "blocks": WANDERS,
    }
    return make_constants(**(numbers | changes))


def cruising() -> np.ndarray:
    """A state with everything in motion; fast, so that the terms of the curved Earth are seen."""
    nav = survey().nav(3.0)
    nav[at.VEL : at.VEL + 3] = 120.0, -90.0, 20.0
    nav[at.GYRO_BIAS : at.GYRO_BIAS + 3] = 1e-3, -2e-3, 5e-4
    nav[at.ACCEL_BIAS : at.ACCEL_BIAS + 3] = 0.1, 0.05, -0.1
    return nav


def difference(nav, other) -> np.ndarray:
    """Errors (ALL_STATES,) of ``nav`` as an estimate of ``other``, by the definitions of ``core.filter.layout``."""
    e = np.zeros(ALL_STATES)
    q, true_q = nav[at.QUAT : at.QUAT + 4], other[at.QUAT : at.QUAT + 4]
    e[at.PHI : at.PHI + 3] = rotvec_from_quat_many(quat_multiply(true_q, quat_conjugate(q)))
    e[at.DVEL : at.DVEL + 3] = nav[at.VEL : at.VEL + 3] - other[at.VEL : at.VEL + 3]
    R_M, R_N = radii(other[at.LAT])
    e[at.DPOS] = (nav[at.LON] - other[at.LON]) * (R_N + other[at.ALT]) * cos_latitude(other[at.LAT])
    e[at.DPOS + 1] = (nav[at.LAT] - other[at.LAT]) * (R_M + other[at.ALT])
    e[at.DPOS + 2] = nav[at.ALT] - other[at.ALT]
    e[at.D_GYRO_BIAS : at.BASE_STATES] = (other - nav)[at.GYRO_BIAS : at.ACCEL_BIAS + 3]
    e[at.BASE_STATES :] = (other - nav)[at.WIND : at.TIME]
    return e


def remember(nav, row, numbers) -> None:
    """Fill the memory as if the values of ``row`` had been there before."""
    rate = corrected_rate(nav, numbers, tuple(row[1:4]))
    nav[at.PREV_RATE : at.PREV_RATE + 3] = rate
    nav[at.PREV_FORCE : at.PREV_FORCE + 3] = row[4:] - nav[at.ACCEL_BIAS : at.ACCEL_BIAS + 3]
    trial = nav.copy()
    propagate(trial, np.zeros((ALL_STATES, ALL_STATES)), numbers, row)
    nav[at.PREV_ACCEL : at.PREV_ACCEL + 3] = trial[at.PREV_ACCEL : at.PREV_ACCEL + 3]


def measured_transition(nav, row, numbers) -> np.ndarray:
    """(Phi - I) / dt of the navigator over the interval of ``row``, by central differences of errors in every state."""
    step = np.full(ALL_STATES, 1e-3)
    step[at.PHI : at.PHI + 3] = 1e-4
    step[at.DVEL : at.DVEL + 3] = 0.1
    step[at.DPOS : at.DPOS + 3] = 1e4
    dt = row[0] - nav[at.TIME]
    end = nav.copy()
    propagate(end, np.zeros((ALL_STATES, ALL_STATES)), numbers, row)
    columns = []
    for j in range(ALL_STATES):
        ends = []
        for sign in (1.0, -1.0):
            error = np.zeros(ALL_STATES)
            error[j] = sign * step[j]
            estimate = nav.copy()
            inject(estimate, numbers, -error)
            remember(estimate, row, numbers)
            start = difference(estimate, nav)
            propagate(estimate, np.zeros((ALL_STATES, ALL_STATES)), numbers, row)
            ends.append((difference(estimate, end) - start) / dt)
        columns.append((ends[0] - ends[1]) / (2.0 * step[j]))
    return np.array(columns).T


def test_system_matrix_is_the_derivative_of_the_navigator():
    # GIVEN one short interval, biases and gyro matrix held as the navigator holds them
    dt, numbers = (
        1e-3,
        constants(gyro_bias_tau=np.inf, accel_bias_tau=np.inf, blocks=dict.fromkeys(BLOCKS, GaussMarkov())),
    )
    nav = cruising()
    row = np.array([nav[at.TIME] + dt, 0.4, -0.3, 0.6, 1.5, -2.0, 9.9])
    remember(nav, row, numbers)
    middle = nav.copy()
    half_row = row.copy()
    half_row[0] = nav[at.TIME] + 0.5 * dt
    propagate(middle, np.zeros((ALL_STATES, ALL_STATES)), numbers, half_row)
    f_n = quat_rotate(middle[at.QUAT : at.QUAT + 4], nav[at.PREV_FORCE : at.PREV_FORCE + 3])
    F = error_model.system_matrix(middle, numbers, ALL_STATES, f_n, nav[at.PREV_RATE : at.PREV_RATE + 3])
    # WHEN the navigator is disturbed in each state
    measured = measured_transition(nav, row, numbers)
    expected = (expm(F * dt) - np.eye(ALL_STATES)) / dt
    # THEN both agree to 1e-6 with positions counted in radii of the Earth, so that no term hides behind its smallness
    scale = np.ones(ALL_STATES)
    scale[at.DPOS : at.DPOS + 3] = EARTH
    deviation = np.abs(measured - expected) * scale / scale[:, None]
    dropped = np.zeros_like(deviation, dtype=bool)
    dropped[at.PHI : at.DVEL + 3, at.DPOS + 1] = True  # radii in w_en, gravity with latitude
    dropped[at.DVEL + 2, at.DPOS + 2] = True  # gravity falls with height as on a sphere
    assert deviation[~dropped].max() < 1e-6
    assert deviation[at.DVEL + 2, at.DPOS + 1] < 0.06  # m/s^2 per radius of the Earth
    assert deviation[at.DVEL + 2, at.DPOS + 2] < 0.08  # of 19.6
    assert deviation[at.DVEL : at.DVEL + 2, at.DPOS + 1].max() < 2e-4
    assert deviation[at.PHI : at.PHI + 3, at.DPOS + 1].max() < 1e-6


def random_covariance(n: int) -> np.ndarray:
    factor = np.random.default_rng(5).normal(size=(n, n))
    sd = np.ones(n)
    sd[at.PHI : at.PHI + 3] = 1e-2
    sd[at.D_GYRO_BIAS : at.D_GYRO_BIAS + 3] = 1e-3
    sd[at.D_ACCEL_BIAS : at.D_ACCEL_BIAS + 3] = 0.05
    sd[17:] = 1e-3
    return (factor @ factor.T / n + np.eye(n)) * np.outer(sd, sd)


def van_loan(P, F, Q, T) -> np.ndarray:
    """Phi P Phi' + Q_d without approximation (C. F. Van Loan, IEEE Trans. Automatic Control 23(3), 1978)."""
    n = len(P)
    block = expm(np.block([[-F, Q], [np.zeros((n, n)), F.T]]) * T)
    transition = block[n:, n:].T
    return transition @ P @ transition.T + transition @ block[:n, n:]


def noise(numbers) -> np.ndarray:
    Q = np.zeros((ALL_STATES, ALL_STATES))
    densities = [at.GYRO_NOISE_PSD] * 3 + [at.ACCEL_NOISE_PSD] * 3 + [None] * 3 + [at.GYRO_BIAS_PSD] * 3
    densities += [at.ACCEL_BIAS_PSD] * 3
    densities += list(range(at.BLOCK_PSD, at.BLOCK_PSD + at.OPTIONAL_STATES))
    np.fill_diagonal(Q, [0.0 if name is None else numbers[name] for name in densities])
    return Q


@pytest.mark.parametrize("form", ["_propagate_by_shears", "_propagate_by_products"])
@pytest.mark.parametrize("T", [0.02, 0.1])
def test_covariance_step_is_of_second_order(form, T):
    numbers, nav = constants(), cruising()
    F = error_model.system_matrix(nav, numbers, ALL_STATES, np.array([1.0, 2.0, 9.7]), np.array([0.1, 0.2, 0.5]))
    P0 = random_covariance(ALL_STATES)
    sd = np.sqrt(np.diag(P0))
    deviations = []
    for steps in (1, 2):
        P = P0.copy()
        for _ in range(steps):
            getattr(error_model, form)(P, F, numbers, T / steps)
        assert np.array_equal(P, P.T)
        deviations.append(np.abs((P - van_loan(P0, F, noise(numbers), T)) / np.outer(sd, sd)).max())
    assert deviations[0] < 0.2 * T**3
    assert deviations[1] < 0.3 * deviations[0]


@pytest.mark.parametrize("blocks", SUBSETS, ids=names)
def test_step_is_the_same_for_every_choice_of_states(blocks):
    numbers = constants(blocks={block: WANDERS[block] for block in blocks})
    n, T = state_count(numbers), 0.04
    force, rate = np.array([1.0, 2.0, 9.7]), np.array([0.1, 0.2, 0.5])
    F = error_model.system_matrix(cruising(), numbers, n, force, rate)
    P0 = random_covariance(n)
    by_shears, by_products = P0.copy(), P0.copy()
    error_model._propagate_by_shears(by_shears, F, numbers, T)
    error_model._propagate_by_products(by_products, F, numbers, T)
    sd = np.sqrt(np.diag(P0))
    assert np.array_equal(by_shears, by_shears.T)
    assert np.abs((by_shears - by_products) / np.outer(sd, sd)).max() < 0.4 * T**3


def test_step_uses_the_sums_and_empties_them():
    numbers, nav = constants(covariance_period=0.02), survey().nav(0.0)
    P = random_covariance(ALL_STATES)
    before = P.copy()
    rows = survey().imu_rows(np.arange(5) * 0.005)
    for row in rows[:3]:
        propagate(nav, P, numbers, row)
    assert np.array_equal(P, before)
    assert nav[at.SUM_TIME] == pytest.approx(0.015)
    propagate(nav, P, numbers, rows[3])
    assert not np.array_equal(P, before)
    assert not nav[at.SUM_TIME : at.SUM_GAP + 1].any()
    after = P.copy()
    error_model.covariance_step(nav, P, numbers)
    assert np.array_equal(P, after)


@pytest.mark.parametrize("blocks", SUBSETS, ids=names)
def test_optional_blocks_leave_the_base_states_alone(blocks):
    # GIVEN blocks that are known exactly and stay so
    numbers, alone = constants(blocks=dict.fromkeys(blocks, GaussMarkov())), constants(blocks=None)
    n = state_count(numbers)
    P, P_alone = np.zeros((n, n)), random_covariance(at.BASE_STATES)
    P[: at.BASE_STATES, : at.BASE_STATES] = P_alone
    for covariance, c in ((P, numbers), (P_alone, alone)):
        nav = survey().nav(0.0)
        rows = survey().imu_rows(np.arange(41) * 0.005)
        run_imu(nav, covariance, c, rows, np.empty((len(rows), at.OUT_COLUMNS)))
        error_model.covariance_step(nav, covariance, c)
    assert np.allclose(P[: at.BASE_STATES, : at.BASE_STATES], P_alone, rtol=1e-12)


def test_covariance_at_50_hz_is_as_good_as_at_200():
    ends = []
    for period in (0.02, 0.005):
        nav, P = survey().nav(0.0), random_covariance(at.BASE_STATES)
        numbers = constants(covariance_period=period, blocks=None)
        rows = survey().imu_rows(np.arange(2001) * 0.005)
        run_imu(nav, P, numbers, rows, np.empty((len(rows), at.OUT_COLUMNS)))
        error_model.covariance_step(nav, P, numbers)
        ends.append(np.sqrt(np.diag(P)))
    assert np.allclose(*ends, rtol=1e-3)


def test_nothing_moves_without_time():
    nav, P = survey().nav(0.0), zero_covariance()
    error_model.covariance_step(nav, P, constants(blocks=None))
    assert not P.any()
