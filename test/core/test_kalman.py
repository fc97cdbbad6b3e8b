"""The filter against the textbook, against long runs of tiny noise, and against its own sign conventions."""

import math

import numpy as np
import pytest
from exact_motion import rest, survey, times_of
from hypothesis import given
from hypothesis import strategies as st

from filter_start import initial_covariance, names, plain_constants
from imu_run import run_imu
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.filter.blocks import BLOCKS, GYRO_MATRIX, WIND, state_count
from nav_pose_estimator.core.filter.error_state import inject
from nav_pose_estimator.core.filter.kalman import (
    ACCEPTED,
    INFLATED,
    REJECTED,
    correct,
    gated_correct,
    horizontal_sd,
    innovation,
    predicted_horizontal_sd,
)
from nav_pose_estimator.core.filter.strapdown import flush_covariance
from nav_pose_estimator.core.numerics.rotation import (
    quat_conjugate,
    quat_from_rotvec,
    quat_multiply,
    rotvec_from_quat_many,
    skew,
)

CHOICES = ((), (WIND,), (GYRO_MATRIX,), BLOCKS)


def start_covariance(numbers):
    return initial_covariance(
        numbers,
        misalignment_sd=(0.01, 0.01, 0.1),
        velocity_sd=0.3,
        position_sd=(2.0, 2.0, 4.0),
        gyro_bias_sd=1e-3,
        accel_bias_sd=0.05,
        block_sd=dict.fromkeys(BLOCKS, 0.005) | {WIND: 3.0},
    )


def position_rows(n: int) -> np.ndarray:
    H = np.zeros((3, n))
    H[:, at.DPOS : at.DPOS + 3] = np.eye(3)
    return H


def case(seed: int, numbers: np.ndarray, m: int):
    """A random observation: nav, P, z, H, R."""
    n = state_count(numbers)
    rng = np.random.default_rng(seed)
    factor, noise = rng.normal(size=(n, n)), rng.normal(size=(m, m))
    nav = survey().nav(2.0)
    return nav, 1e-4 * factor @ factor.T, 1e-3 * rng.normal(size=m), rng.normal(size=(m, n)), 1e-4 * noise @ noise.T


@given(st.integers(0, 1000), st.sampled_from(CHOICES), st.integers(1, 6))
def test_correction_is_that_of_the_textbook(seed, blocks, m):
    numbers = plain_constants(blocks)
    nav, P, z, H, R = case(seed, numbers, m)
    n = len(P)
    S = H @ P @ H.T + R
    K = np.linalg.solve(S, H @ P).T
    reset = np.eye(n)
    reset[:3, :3] += 0.5 * skew((K @ z)[:3])
    expected = reset @ (P - K @ S @ K.T) @ reset.T
    before = nav.copy()
    nis = correct(nav, P, numbers, z, H, R)
    assert nis == pytest.approx(z @ np.linalg.solve(S, z), rel=1e-6)
    assert np.allclose(P, expected, rtol=0.0, atol=1e-9 * np.abs(P).max())
    assert np.array_equal(P, P.T)
    assert np.allclose(nav[at.VEL : at.VEL + 3], before[at.VEL : at.VEL + 3] - (K @ z)[3:6], atol=1e-9)


@pytest.mark.parametrize("blocks", CHOICES, ids=names)
def test_injection_takes_an_error_out_by_the_conventions(blocks):
    # GIVEN an estimate that errs by known amounts: C_hat = Exp(-phi) C, v_hat = v + dv, b = b_hat + missing
    numbers = plain_constants(blocks)
    n = state_count(numbers)
    rng = np.random.default_rng(n)
    truth, error = survey().nav(4.0), 1e-3 * rng.normal(size=n)
    estimate = truth.copy()
    estimate[at.QUAT : at.QUAT + 4] = quat_multiply(quat_from_rotvec(-error[:3]), truth[at.QUAT : at.QUAT + 4])
    estimate[at.VEL : at.VEL + 3] += error[at.DVEL : at.DVEL + 3]
    estimate[at.GYRO_BIAS : at.ACCEL_BIAS + 3] -= error[at.D_GYRO_BIAS : at.BASE_STATES]
    for block in blocks:
        estimate[block.estimates] -= error[block.states(numbers)]
    errors = survey().error_of(estimate)
    assert np.allclose(errors[:6], error[:6], atol=1e-12)
    # WHEN the error is injected THEN the truth comes out, but for the position, which was true
    inject(estimate, numbers, error)
    left = survey().error_of(estimate)
    assert np.allclose(left[:6], 0.0, atol=1e-12)
    assert np.allclose(left[at.DPOS : at.DPOS + 3], -error[at.DPOS : at.DPOS + 3], atol=1e-8)
    assert np.allclose(estimate[at.GYRO_BIAS : at.TIME], truth[at.GYRO_BIAS : at.TIME], atol=1e-15)


def test_reset_turns_the_covariance_as_the_remaining_error_turns():
    # GIVEN misalignments scattered about a large correction phi
    rng, phi = np.random.default_rng(3), np.array([0.2, -0.1, 0.3])
    scatter = 1e-6 * rng.normal(size=(200, 3))
    left = [
        rotvec_from_quat_many(quat_multiply(quat_from_rotvec(phi + d), quat_conjugate(quat_from_rotvec(phi))))
        for d in scatter
    ]
    # THEN what is left after C <- Exp(phi) C is (I + [phi x] / 2) times the scatter, to second order in phi
    assert np.allclose(left, scatter @ (np.eye(3) + 0.5 * skew(phi)).T, atol=0.2 * phi @ phi * 3e-6)
    assert not np.allclose(left, scatter @ (np.eye(3) - 0.5 * skew(phi)).T, atol=0.2 * phi @ phi * 3e-6)


def test_injection_wraps_the_longitude():
    nav = rest().nav(0.0)
    nav[at.LON] = math.pi - 1e-9
    error = np.zeros(15)
    error[at.DPOS] = -1.0
    inject(nav, plain_constants(), error)
    assert -math.pi <= nav[at.LON] < -math.pi + 1e-6


@pytest.mark.filterwarnings("ignore:invalid value:RuntimeWarning")
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("where", ["z", "H", "R", "P"])
def test_numbers_that_are_not_finite_change_nothing(bad, where):
    arrays = {"P": start_covariance(plain_constants()), "z": np.zeros(3), "H": position_rows(15), "R": np.eye(3)}
    arrays[where].flat[arrays[where].size // 2 if where != "H" else at.DPOS] = bad
    nav = survey().nav(0.0)
    before, P_before = nav.copy(), arrays["P"].copy()
    P = arrays["P"]
    assert correct(nav, P, plain_constants(), arrays["z"], arrays["H"], arrays["R"]) == math.inf
    status, nis = gated_correct(nav, P, plain_constants(), arrays["z"], arrays["H"], arrays["R"], 7.8, 1e300)
    assert (status, nis) == (REJECTED, math.inf)
    assert np.array_equal(nav, before)
    assert np.array_equal(P, P_before, equal_nan=True)


def test_a_noise_that_is_not_positive_definite_changes_nothing():
    nav, P = survey().nav(0.0), np.zeros((15, 15))
    assert correct(nav, P, plain_constants(), np.ones(3), position_rows(15), -np.eye(3)) == math.inf
    assert not P.any()


def test_gate_accepts_inflates_and_rejects():
    numbers, H, R, soft, hard = plain_constants(), position_rows(15), np.eye(3), 7.8, 100.0
    for size, expected in ((0.5, ACCEPTED), (11.0, INFLATED), (100.0, REJECTED)):
        nav, P, z = survey().nav(0.0), start_covariance(numbers), np.array([size, 0.0, 0.0])
        before, P_before = nav.copy(), P.copy()
        status, nis = gated_correct(nav, P, numbers, z, H, R, soft, hard)
        assert status == expected
        assert nis == pytest.approx(size * size / (P_before[at.DPOS, at.DPOS] + 1.0))
        assert np.array_equal(nav, before) == (expected == REJECTED)
        assert np.array_equal(P, P_before) == (expected == REJECTED)


def test_inflated_noise_makes_the_innovation_as_large_as_the_soft_gate():
    numbers = plain_constants()
    nav, P, z, H, R = case(7, numbers, 3)
    z *= 100.0
    soft = 0.3 * innovation(P, z, H, R)
    S = H @ P @ H.T + R
    wider = R + (1.0 / 0.3 - 1.0) * S
    other_nav, other_P = nav.copy(), P.copy()
    assert innovation(P, z, H, wider) == pytest.approx(soft, rel=1e-9)
    status, _ = gated_correct(nav, P, numbers, z, H, R, soft, math.inf)
    correct(other_nav, other_P, numbers, z, H, wider)
    assert status == INFLATED
    assert np.allclose(nav, other_nav, rtol=1e-12)
    assert np.allclose(P, other_P, rtol=1e-9)


@pytest.mark.parametrize("sd", [1e-9, 1e-3])
@pytest.mark.parametrize("blocks", [False, True])
def test_covariance_stays_positive_definite_with_tiny_noise(sd, blocks):
    # GIVEN a position that is measured to a nanometre, again and again, from a start that knows little
    numbers = plain_constants(BLOCKS if blocks else ())
    n = state_count(numbers)
    nav, P = survey().nav(0.0), 1e4 * start_covariance(numbers)
    rows = survey().imu_rows(times_of(20.0, 50.0))
    out = np.empty((len(rows), at.OUT_COLUMNS))
    for i in range(0, len(rows), 5):
        run_imu(nav, P, numbers, rows[i : i + 5], out[i : i + 5])
        flush_covariance(nav, P, numbers)
        correct(nav, P, numbers, np.zeros(3), position_rows(n), np.eye(3) * sd * sd)
        scale = 1.0 / np.sqrt(np.diag(P))
        assert np.array_equal(P, P.T)
        assert np.linalg.eigvalsh(P * np.outer(scale, scale)).min() > 0.0
    assert np.sqrt(P[at.DPOS, at.DPOS]) < 1.01 * sd


def test_outlook_is_what_coasting_gives():
    # GIVEN a vehicle that hovers for half a minute without GNSS
    numbers, motion = plain_constants(), rest()
    nav, P = motion.nav(0.0), start_covariance(plain_constants())
    expected = predicted_horizontal_sd(nav, P, numbers, 30.0)
    now = horizontal_sd(P)
    rows = motion.imu_rows(times_of(30.0, 50.0))
    run_imu(nav, P, numbers, rows, np.empty((len(rows), at.OUT_COLUMNS)))
    flush_covariance(nav, P, numbers)
    assert expected == pytest.approx(horizontal_sd(P), rel=0.01)
    assert expected > 2.0 * now
    assert predicted_horizontal_sd(nav, P, numbers, 0.0) == horizontal_sd(P)
