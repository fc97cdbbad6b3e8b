"""Evidence for a wrong scale of the gyroscope: the Bayes factor from the posterior of a filter with a narrow prior."""

import numpy as np
import pytest

from nav_pose_estimator.core.alignment.gyro_evidence import SIZE, GyroEvidence

V, WRONG, SMALL = 0.01**2, (0.3**2, 1.0), 0.02**2  # variances of the narrow prior, of wrong scales, of sound ones
DIAGONAL = np.eye(SIZE)[:, [0, 4, 8]]
COMMON = DIAGONAL.sum(axis=1, keepdims=True)
ONE_AXIS = [DIAGONAL[:, [axis]] for axis in range(3)]
SCALED = (DIAGONAL @ np.full(3, 0.2)).astype(float)


def second(rng: np.random.Generator, truth: np.ndarray, rows: int = 6) -> tuple[np.ndarray, np.ndarray]:
    """(J, h) of observations with unit noise in one second; every element of M acts."""
    H = 4.0 * rng.standard_normal((rows, SIZE))
    return H.T @ H, H.T @ (H @ truth + rng.standard_normal(rows))


def posterior(J: np.ndarray, h: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(m, P) of a filter that started with the narrow prior about zero."""
    P = np.linalg.inv(J + np.eye(SIZE) / V)
    return P @ h, 0.5 * (P + P.T)


def evidence_of(truth: np.ndarray, seconds: int, nis: float = 0.1) -> tuple[GyroEvidence, np.ndarray, np.ndarray]:
    """The evidence after some ``seconds``, with J and h."""
    rng, found = np.random.default_rng(3), GyroEvidence()
    J, h = np.zeros((SIZE, SIZE)), np.zeros(SIZE)
    found.add(*posterior(J, h), 0.0)
    for _ in range(seconds):
        more = second(rng, truth)
        J, h = J + more[0], h + more[1]
        found.add(*posterior(J, h), nis)
    return found, J, h


def log_marginal(J: np.ndarray, h: np.ndarray, prior: np.ndarray) -> float:
    """Log-density of the observations, up to a constant, under N(0, ``prior``)."""
    inside = np.eye(SIZE) + prior @ J
    return float(-0.5 * np.linalg.slogdet(inside)[1] + 0.5 * h @ np.linalg.solve(inside, prior @ h))


@pytest.mark.parametrize("truth", [np.zeros(SIZE), SCALED, np.eye(SIZE)[8] * -0.2], ids=["right", "all", "z"])
def test_the_odds_are_the_bayes_factor_of_the_two_priors(truth: np.ndarray) -> None:
    """GIVEN observations of M WHEN the odds are computed from the narrow posterior THEN they are the exact ones."""
    found, J, h = evidence_of(truth, seconds=4)
    wide, small = (
        [
            log_marginal(J, h, V * np.eye(SIZE) + w * B @ B.T) - chosen * (B.shape[1] == 1 and B is not COMMON)
            for B in (COMMON, DIAGONAL, *ONE_AXIS)
            for w in added
        ]
        for added, chosen in ((WRONG, np.log(3.0)), ((0.0, SMALL), 0.0))
    )
    assert found.odds == pytest.approx(max(wide) - max(small), rel=1e-6, abs=1e-6)


def test_a_scale_of_an_uncalibrated_gyroscope_is_right() -> None:
    """GIVEN a scale error of 3 %, three deviations of the filter's prior, WHEN GNSS shows it THEN it is no evidence."""
    assert evidence_of(0.15 * SCALED, seconds=30)[0].odds < 0.0


def test_a_wrong_scale_is_told_from_a_right_one() -> None:
    """GIVEN the same motion WHEN the scale is right, or wrong by 20 % THEN the odds are against, or for it."""
    assert evidence_of(np.zeros(SIZE), seconds=6)[0].odds < -1.5
    assert evidence_of(SCALED, seconds=6)[0].odds > 8.0


def test_axes_that_are_right_say_nothing_of_the_third() -> None:
    """GIVEN motion that has shown x and y to be right for a minute, and z not at all THEN the odds are those of a
    choice among three axes: that minute does not count against a wrong z."""
    shown = np.zeros((SIZE, SIZE))
    shown[:6, :6] = 60.0 * second(np.random.default_rng(3), np.zeros(SIZE))[0][:6, :6]
    found = GyroEvidence()
    for J in (np.zeros((SIZE, SIZE)), shown):
        found.add(*posterior(J, np.zeros(SIZE)), 0.1)
    assert found.odds == pytest.approx(-np.log(3.0), abs=0.1)


def test_seconds_of_large_innovations_count_less() -> None:
    """GIVEN a wrong scale WHEN the variance of unit weight is 50 THEN the odds are much smaller."""
    calm, rough = evidence_of(SCALED, seconds=4)[0].odds, evidence_of(SCALED, seconds=4, nis=50.0)[0].odds
    assert rough < 0.1 * calm


def test_a_change_of_the_prior_is_no_observation() -> None:
    """GIVEN some evidence WHEN the covariance is enlarged, or the next second is to be skipped THEN it stays."""
    found, J, h = evidence_of(SCALED, seconds=4)
    before = found.odds
    m, P = posterior(J, h)
    found.add(m, 4.0 * P, 0.1)
    found.skip()
    found.add(m, P, 0.1)
    assert found.odds == before


def test_a_new_filter_begins_without_evidence() -> None:
    """GIVEN evidence WHEN the filter starts again about another estimate THEN the odds are even."""
    found, _, _ = evidence_of(SCALED, seconds=4)
    found.begin_again()
    found.add(np.full(SIZE, 0.1), V * np.eye(SIZE), 0.0)
    assert found.odds == pytest.approx(0.0, abs=1e-9)
    assert found.centre.tolist() == [0.1] * SIZE


@pytest.mark.parametrize("known", [1.0, 0.1], ids=["from the start", "after an outage"])
def test_what_a_random_walk_takes_is_no_evidence(known: float) -> None:
    """GIVEN a filter whose covariance of M is its prior, or a share of it after seconds that do not count, WHEN only
    the random walk of M changes it for an hour THEN the odds stay even: information below zero would raise them."""
    walk, found = 1e-11, GyroEvidence()
    found.add(np.zeros(SIZE), V * np.eye(SIZE), 0.1, walk)
    found.skip()
    for seconds in range(3000):
        found.add(np.zeros(SIZE), (known * V + seconds * walk) * np.eye(SIZE), 0.1, walk)
    assert found.odds == pytest.approx(0.0, abs=0.01)
