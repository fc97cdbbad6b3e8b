"""The wind in the residuals of a prediction: its mean, how much it changes, and what it is by now."""

import numpy as np
import pytest

from nav_pose_estimator.core.motion.epochs import PERIOD
from nav_pose_estimator.core.motion.wind import WIND_TIME, mean_wind, mean_wind_cov, track, unseen, wind_spread

STEPS = round(WIND_TIME / PERIOD)
POOR_AHEAD = np.array([25.0, 0.04, 0.04])  # m^2/s^2: a fixed wing's speed ahead is vague, its sideslip is not


def turning(count: int, period: float = 40.0) -> np.ndarray:
    """Attitudes C_nb (N, 3, 3) of level flight in a steady turn of ``period`` seconds."""
    yaw = 2.0 * np.pi * PERIOD * np.arange(count) / period
    C = np.zeros((count, 3, 3))
    C[:, 0, 0] = C[:, 1, 1] = np.cos(yaw)
    C[:, 1, 0], C[:, 0, 1], C[:, 2, 2] = np.sin(yaw), -np.sin(yaw), 1.0
    return C


def felt(C: np.ndarray, wind: np.ndarray, noise: np.ndarray, seed: int = 1) -> np.ndarray:
    """Residuals in b (N, 3) of ``wind`` (N, 2) with white noise of variances ``noise`` (3,)."""
    random = np.random.default_rng(seed)
    return np.einsum("nij,ni->nj", C[:, :2], wind) + random.normal(0.0, np.sqrt(noise), (len(C), 3))


def walk(count: int, spread: float, seed: int) -> np.ndarray:
    """A wind (N, 2) that changes as the model says."""
    random = np.random.default_rng(seed)
    decay = np.exp(-PERIOD / WIND_TIME)
    wind = np.zeros((count, 2))
    for i in range(1, count):
        wind[i] = decay * wind[i - 1] + random.normal(0.0, np.sqrt(spread * (1.0 - decay**2)), 2)
    return wind


def test_a_step_of_the_wind_is_followed_and_forgotten() -> None:
    """GIVEN residuals of nought WHEN the wind steps by 2 m/s THEN it is found, and forgotten again when it is over."""
    C = turning(4 * STEPS)
    wind = np.zeros((len(C), 2))
    wind[STEPS : 2 * STEPS] = [2.0, -1.0]
    noise = np.full(3, 0.5)
    residual = felt(C, wind, noise)
    state = np.zeros(2), np.eye(2)
    found = []
    for first, last in ((0, STEPS), (STEPS, 2 * STEPS), (2 * STEPS, 4 * STEPS)):
        *state, _ = track(C[first:last], residual[first:last], noise * PERIOD, 1.0, *state)
        found.append(state[0])
    assert np.abs(found[0]).max() < 0.6
    np.testing.assert_allclose(found[1], [2.0, -1.0], atol=0.6)
    assert np.abs(found[2]).max() < 0.6


def test_the_stated_covariance_is_that_of_the_error() -> None:
    """GIVEN many winds drawn from the process, felt with a vague speed ahead WHEN tracked THEN the normalised error
    squared is two on average, one for each axis."""
    C = turning(60)
    normalised = []
    for seed in range(300):
        wind = walk(len(C), 1.0, seed)
        residual = felt(C, wind, POOR_AHEAD, 1000 + seed)
        found, cov, _ = track(C, residual, POOR_AHEAD * PERIOD, 1.0, np.zeros(2), np.eye(2))
        error = found - wind[-1]
        normalised.append(error @ np.linalg.solve(cov, error))
    assert np.mean(normalised) == pytest.approx(2.0, rel=0.2)


def test_a_wind_that_nobody_sees_changes_as_one_whose_residuals_say_nothing() -> None:
    """GIVEN a wind and its covariance WHEN 20 s pass unseen THEN it is as after 20 s of residuals without worth."""
    wind, cov = np.array([3.0, -1.0]), np.array([[0.4, 0.1], [0.1, 0.2]])
    count = round(20.0 / PERIOD)
    followed, stated, _ = track(turning(count), np.zeros((count, 3)), np.full(3, 1e12), 2.0, wind, cov)
    later, vaguer = unseen(wind, cov, 2.0, count * PERIOD)
    np.testing.assert_allclose(later, followed, rtol=1e-6)
    np.testing.assert_allclose(vaguer, stated, rtol=1e-6)
    assert vaguer[0, 0] > cov[0, 0]


def test_what_was_expected_does_not_know_the_residual() -> None:
    """GIVEN two residuals WHEN each is tracked from the same start THEN what was expected before is the same."""
    C = turning(1)
    start = np.array([1.0, 0.0]), 0.3 * np.eye(2)
    one, other = (track(C, np.full((1, 3), value), np.full(3, 0.5), 1.0, *start) for value in (9.0, -9.0))
    np.testing.assert_array_equal(one[2], other[2])
    np.testing.assert_array_equal(one[1], other[1])
    assert (one[0] != other[0]).any()
    np.testing.assert_array_equal(start[0], [1.0, 0.0])  # not written to


def test_a_vague_axis_does_not_decide_about_the_spread() -> None:
    """GIVEN a steady wind, and a speed ahead whose residuals last for ten seconds WHEN the spread is estimated THEN it
    is small, though residuals of metres per second are alike ten seconds later."""
    C = turning(1200)
    slow = np.repeat(np.random.default_rng(2).normal(0.0, 5.0, 60), 20)
    residual = felt(C, np.zeros((len(C), 2)), np.full(3, 0.04))
    residual[:, 0] += slow
    assert wind_spread(C, residual) < 0.1


def test_the_spread_of_a_changing_wind_is_found() -> None:
    """GIVEN winds of a spread of one WHEN estimated over ten minutes each THEN right to a factor of two on average,
    and a little less because ten seconds later it has faded."""
    C = turning(1200)
    found = [wind_spread(C, felt(C, walk(len(C), 1.0, seed), POOR_AHEAD, seed)) for seed in range(10)]
    assert 0.4 < np.mean(found) < 1.5


def test_the_mean_wind_is_found_though_the_speed_ahead_is_vague() -> None:
    """GIVEN a wind of 6 m/s and a law of the inputs WHEN solved for THEN it is right to 0.3 m/s; the residuals of
    the speed ahead alone would leave a metre per second."""
    C = turning(600)
    random = np.random.default_rng(4)
    z = np.column_stack([random.normal(size=(len(C), 2)), np.ones(len(C))])
    law = z @ np.array([[2.0, 0.5, 0.1], [0.3, -0.2, 0.4], [15.0, 0.0, 0.0]])
    velocity = law + felt(C, np.tile([-2.0, 6.0], (len(C), 1)), POOR_AHEAD)
    wind = mean_wind(C, velocity, z, 1e-6 * np.eye(3), 1e-4)
    np.testing.assert_allclose(wind, [-2.0, 6.0], atol=0.3)


def test_without_turns_the_wind_is_as_uncertain_as_before() -> None:
    """GIVEN a law with a constant that is not known WHEN the vehicle goes straight on THEN constant and wind are one
    number and nothing of the wind is known; WHEN it turns THEN the wind is known as well as noise and time allow."""
    noise, unknown, count = np.array([0.4, 0.4, 0.1]), 25.0, 4 * STEPS
    z, ridge = np.ones((count, 1)), 1e-9 * np.eye(1)
    straight, turned = np.tile(np.eye(3), (count, 1, 1)), turning(count)
    np.testing.assert_allclose(mean_wind_cov(straight, z, ridge, noise, unknown), unknown * np.eye(2), rtol=1e-3)
    expected = 0.4 / (count * PERIOD) * np.eye(2)
    np.testing.assert_allclose(mean_wind_cov(turned, z, ridge, noise, unknown), expected, rtol=0.1, atol=1e-4)


def test_a_law_that_is_known_tells_the_wind_without_turns() -> None:
    """GIVEN a law that a strong penalty holds WHEN the vehicle goes straight on THEN the wind is known."""
    count = 2 * STEPS
    straight, z = np.tile(np.eye(3), (count, 1, 1)), np.ones((count, 1))
    cov = mean_wind_cov(straight, z, 1e9 * np.eye(1), np.full(3, 0.4), 25.0)
    np.testing.assert_allclose(cov, 0.4 / (count * PERIOD) * np.eye(2), rtol=0.01)
