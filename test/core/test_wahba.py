"""Wahba's problem: the rotation found is the one of the singular value decomposition, and the trace is its own."""

import numpy as np
import pytest

from nav_pose_estimator.core.numerics.rotation import quat_to_matrix
from nav_pose_estimator.core.numerics.wahba import best_rotation


@pytest.mark.parametrize("seed", range(20))
def test_it_is_the_solution_by_singular_values(seed: int) -> None:
    """GIVEN noisy vectors, rotated or mirrored, THEN rotation and trace are those that singular values give."""
    rng = np.random.default_rng(seed)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    s = rng.normal([0.0, 0.0, 9.8], 1.0, (6, 3))
    B = (s @ turn.T + rng.normal(0.0, 0.3, s.shape)).T @ s
    left, singular, right = np.linalg.svd(B)
    sign = np.linalg.det(left @ right)
    q, trace = best_rotation(B)
    np.testing.assert_allclose(quat_to_matrix(np.array(q)), left @ np.diag([1.0, 1.0, sign]) @ right, atol=1e-11)
    assert trace == pytest.approx(singular[0] + singular[1] + sign * singular[2], rel=1e-13)


def test_parallel_vectors_have_a_rotation() -> None:
    """GIVEN vectors that are all parallel THEN one of the rotations that fit is found."""
    q, trace = best_rotation(np.diag([0.0, 0.0, 9.8]))
    np.testing.assert_allclose(quat_to_matrix(np.array(q))[2], [0.0, 0.0, 1.0], atol=1e-12)
    assert trace == pytest.approx(9.8)
