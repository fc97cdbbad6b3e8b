"""A height corrects the vertical channel and nothing else, with an honest covariance."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from filter_start import plain_constants
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.filter.blocks import BLOCKS, state_count
from nav_pose_estimator.core.filter.kalman import ACCEPTED, INFLATED, REJECTED
from nav_pose_estimator.core.filter.vertical_channel import gated_height

CHOICES = st.sampled_from([(), BLOCKS])
UP, CLIMB = at.DPOS + 2, at.DVEL + 2


def filter_with_ties(n: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """(nav, P) with every state tied to every other."""
    A = np.random.default_rng(seed).normal(size=(n, n))
    nav = np.zeros(at.NAV_SIZE)
    nav[at.QUAT], nav[at.LAT], nav[at.ALT] = 1.0, 0.8, 300.0
    return nav, A @ A.T / n + 0.01 * np.eye(n)


@given(CHOICES, st.integers(0, 1000), st.floats(-2.0, 2.0), st.floats(0.01, 100.0))
def test_only_the_vertical_channel_moves_and_p_is_that_of_the_gain(blocks, seed, z, variance):
    """GIVEN ties between all states WHEN a height comes THEN only ALT and climb move, and P is Joseph's."""
    constants = plain_constants(blocks)
    n = state_count(constants)
    nav, P = filter_with_ties(n, seed)
    before, P0 = nav.copy(), P.copy()
    status, nis = gated_height(nav, P, constants, z, variance, 1e6, 1e7)
    S = P0[UP, UP] + variance
    gain = np.zeros((n, 1))
    gain[[UP, CLIMB], 0] = P0[[UP, CLIMB], UP] / S
    H = np.zeros((1, n))
    H[0, UP] = 1.0
    M = np.eye(n) - gain @ H
    expected = M @ P0 @ M.T + variance * gain @ gain.T
    assert status == ACCEPTED
    np.testing.assert_allclose(nis, z * z / S, atol=1e-12)
    np.testing.assert_allclose(P, expected, atol=1e-9)
    assert np.linalg.eigvalsh(P).min() > 0.0
    moved = np.flatnonzero(np.abs(nav - before) > 1e-12)
    assert set(moved) <= {at.ALT, at.VEL + 2}
    np.testing.assert_allclose(nav[at.ALT], before[at.ALT] - gain[UP, 0] * z, atol=1e-9)


def test_the_gate_accepts_inflates_and_rejects():
    """GIVEN a gate of 4 and 25 WHEN heights lie 1, 3 and 10 deviations off THEN each status comes, in order."""
    statuses, corrections = [], []
    for deviations in (1.0, 3.0, 10.0, np.nan):
        nav, P = filter_with_ties(at.BASE_STATES, 1)
        sd, P0 = np.sqrt(P[UP, UP] + 1.0), P.copy()
        status, _ = gated_height(nav, P, plain_constants(), deviations * sd, 1.0, 4.0, 25.0)
        statuses.append(status)
        corrections.append((300.0 - nav[at.ALT]) / sd)
        if status == REJECTED:
            np.testing.assert_array_equal(P, P0)
    assert statuses == [ACCEPTED, INFLATED, REJECTED, REJECTED]
    # three deviations are taken as the 4/9 of a gain that makes their NIS the soft threshold
    np.testing.assert_allclose(corrections[1] / corrections[0], 3.0 * 4.0 / 9.0)
    assert corrections[2:] == [0.0, 0.0]
