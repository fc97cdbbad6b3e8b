"""Lasting errors of GNSS as states: against a plain scalar filter, and how the flight tells what lasts of an error."""

import math

import numpy as np
import pytest
from exact_motion import survey

from filter_start import plain_constants
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.filter import measurements
from nav_pose_estimator.core.filter.blocks import GNSS_ERROR, GaussMarkov, set_process, state_count
from nav_pose_estimator.core.filter.error_model import covariance_step
from nav_pose_estimator.core.filter.error_state import inject
from nav_pose_estimator.core.filter.kalman import correct
from nav_pose_estimator.core.filter.noise_identification import LEAST_WHITE, ErrorShares

SD, TAU, WHITE, STEP = 1.5, 20.0, 0.3, 0.2
"""m, s, m, s: of an error and of the noise on top of it, and the time between fixes."""


def constants_with_error() -> np.ndarray:
    constants = plain_constants([GNSS_ERROR])
    set_process(constants, GNSS_ERROR, GaussMarkov(SD * math.sqrt(2.0 / TAU), TAU))
    return constants


def plain_filter(measured: np.ndarray) -> tuple[np.ndarray, float]:
    """Estimates (N,) and last variance of a first-order Gauss-Markov process seen in white noise: a scalar filter."""
    estimate, variance, fade = 0.0, SD**2, math.exp(-STEP / TAU)
    found = []
    for one in measured:
        estimate, variance = fade * estimate, fade**2 * variance + SD**2 * (1.0 - fade**2)
        gain = variance / (variance + WHITE**2)
        estimate, variance = estimate + gain * (one - estimate), (1.0 - gain) * variance
        found.append(estimate)
    return np.array(found), variance


@pytest.mark.parametrize("part", [measurements.POSITION, measurements.VELOCITY])
def test_the_states_are_those_of_a_plain_filter(part: int) -> None:
    """GIVEN a vehicle whose motion is known WHEN GNSS errs THEN the filter finds of that what a scalar one does."""
    constants = constants_with_error()
    n = state_count(constants)
    own = GNSS_ERROR.states(constants)
    nav, P = survey().nav(0.0), np.zeros((n, n))
    P[own, own] = SD**2 * np.eye(6)
    known = nav[: at.QUAT].copy()
    measured = np.random.default_rng(1).normal(size=(60, 3)).cumsum(axis=0) * 0.2
    found = []
    for error in measured:
        _wait(nav, P, constants, own)
        nav[: at.QUAT] = known
        if part == measurements.POSITION:
            z, H = measurements.gnss_position(nav, n, *nav[:3], np.zeros(3))
        else:
            z, H = measurements.gnss_velocity(nav, n, nav[at.VEL : at.QUAT], np.zeros(3))
        measurements.see_gnss_error(z, H, nav, constants, part)
        correct(nav, P, constants, z - error, H, WHITE**2 * np.eye(3))
        found.append(nav[at.GNSS_ERROR + part : at.GNSS_ERROR + part + 3].copy())
    for axis in range(3):
        expected, variance = plain_filter(measured[:, axis])
        np.testing.assert_allclose(np.array(found)[:, axis], expected, atol=2e-3)
        state = own.start + part + axis
        assert P[state, state] == pytest.approx(variance, rel=2e-3)


def _wait(nav: np.ndarray, P: np.ndarray, constants: np.ndarray, own: slice) -> None:
    """``STEP`` without IMU noise: the vehicle's states stay known, only the errors of GNSS move."""
    for _ in range(20):
        nav[at.SUM_TIME] = STEP / 20
        nav[at.SUM_FORCE + 2] = 9.8 * STEP / 20
        covariance_step(nav, P, constants)
    errors = P[own, own].copy()
    P[:] = 0.0
    P[own, own] = errors


def test_the_observation_matrix_is_the_derivative() -> None:
    constants = constants_with_error()
    n, nav = state_count(constants), survey().nav(1.0)
    for part, function, value in (
        (measurements.POSITION, measurements.gnss_position, (0.7, 0.1, 400.0)),
        (measurements.VELOCITY, measurements.gnss_velocity, (np.array([1.0, -2.0, 0.5]),)),
    ):
        numeric = np.empty((3, 6))
        for k in range(6):
            both = []
            for sign in (1.0, -1.0):
                moved, error = nav.copy(), np.zeros(n)
                error[GNSS_ERROR.states(constants).start + k] = -sign * 1e-3  # missing where the estimate has too much
                inject(moved, constants, error)
                z, H = function(moved, n, *value, np.zeros(3))
                measurements.see_gnss_error(z, H, moved, constants, part)
                both.append(z)
            numeric[:, k] = (both[0] - both[1]) / 2e-3
        np.testing.assert_allclose(numeric, H[:, GNSS_ERROR.states(constants)], atol=1e-6)


def test_without_the_states_nothing_is_seen_of_them() -> None:
    constants = plain_constants()
    z, H = np.ones(3), np.ones((3, at.BASE_STATES))
    measurements.see_gnss_error(z, H, survey().nav(1.0), constants, measurements.POSITION)
    np.testing.assert_array_equal(z, 1.0)
    np.testing.assert_array_equal(H, 1.0)


def innovations(correlation: float) -> list[tuple[float, float]]:
    random, z = np.random.default_rng(2), np.zeros((1500, 2))
    for i in range(1, len(z)):
        z[i] = correlation * z[i - 1] + random.normal(size=2)
    return [(float(a), float(b)) for a, b in z]


def test_innovations_that_last_say_that_the_error_moves_faster() -> None:
    shares = ErrorShares(largest=12.0)
    shares.note(innovations(0.8))
    assert (shares.lasting, shares.white) == (12.0, LEAST_WHITE)


def test_innovations_that_alternate_say_that_it_is_noise() -> None:
    shares = ErrorShares(largest=12.0)
    shares.note(innovations(-0.4))
    assert shares.lasting == 1.0
    assert shares.white > 5.0


def test_white_innovations_leave_the_shares() -> None:
    """Whatever their size."""
    shares = ErrorShares(largest=12.0)
    shares.note((100.0 * east, 100.0 * north) for east, north in innovations(0.0))
    assert shares.lasting < 2.0
    assert 0.5 < shares.white < 2.0


def test_an_interruption_parts_what_was_from_what_comes() -> None:
    """GIVEN one innovation at a time and pauses between them THEN nothing is learned."""
    shares = ErrorShares(largest=12.0)
    for one in innovations(0.9)[:50]:
        shares.note([one])
        shares.interrupt()
    assert (shares.lasting, shares.white) == (1.0, 1.0)
