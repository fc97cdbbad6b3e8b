"""Rotations of many rows by scipy, independent of the package's kernels."""

import numpy as np
from scipy.spatial.transform import Rotation


def _rotations(q: np.ndarray) -> Rotation:
    return Rotation.from_quat(np.roll(q.reshape(-1, 4), -1, axis=1))


def rotation_vectors(q: np.ndarray) -> np.ndarray:
    """Rotation vectors (..., 3) [rad], of length at most pi, of the unit quaternions ``q`` (..., 4)."""
    return _rotations(q).as_rotvec().reshape((*q.shape[:-1], 3))


def rotation_matrices(q: np.ndarray) -> np.ndarray:
    """Rotation matrices (..., 3, 3) of the unit quaternions ``q`` (..., 4)."""
    return _rotations(q).as_matrix().reshape((*q.shape[:-1], 3, 3))
