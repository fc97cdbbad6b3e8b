"""The rotation that takes vectors nearest to others (Wahba's problem), for the inside of kernels.

Davenport's q method: the quaternion that maximises the trace is the eigenvector of the largest eigenvalue of a
symmetric matrix (4, 4), and the eigenvalue is that trace (Markley & Crassidis, Fundamentals of Spacecraft Attitude
Determination and Control, 2014, section 5.3). Eigenvalues by Jacobi's method, which is exact to rounding for any of
them; of vectors that are all parallel it finds one of the many rotations.
"""

import math

import numpy as np

from nav_pose_estimator.core.numerics.jit import kernel
from nav_pose_estimator.core.numerics.vectors import load4

_SWEEPS = 12  # quadratic convergence needs four or five
_NEGLIGIBLE = 1e-34  # squared, of what is beside the diagonal in parts of the matrix


@kernel
def best_rotation(B):
    """Quaternion (4 numbers) of the rotation R with the largest tr R'B, ``B`` (3, 3) = sum u s', and that trace.

    R takes the vectors s nearest to the vectors u.
    """
    K, V = np.empty((4, 4)), np.eye(4)
    K[0, 0] = B[0, 0] + B[1, 1] + B[2, 2]
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        K[0, 1 + i] = K[1 + i, 0] = B[k, j] - B[j, k]
        K[1 + i, 1 + i] = B[i, i] - B[j, j] - B[k, k]
        K[1 + i, 1 + j] = K[1 + j, 1 + i] = B[i, j] + B[j, i]
    _diagonalise(K, V)
    best = 0
    for i in range(1, 4):
        if K[i, i] > K[best, best]:
            best = i
    return load4(V[:, best], 0), K[best, best]


@kernel
def _diagonalise(A, V):
    """Jacobi's rotations until the symmetric ``A`` (4, 4) is diagonal; they are collected in ``V`` (4, 4)."""
    for _ in range(_SWEEPS):
        beside, total = 0.0, 0.0
        for i in range(4):
            for j in range(4):
                total += A[i, j] * A[i, j]
                beside += 0.0 if i == j else A[i, j] * A[i, j]
        if beside <= _NEGLIGIBLE * total:
            return
        for p in range(3):
            for q in range(p + 1, 4):
                _rotate(A, V, p, q)


@kernel
def _rotate(A, V, p, q):
    """Turn ``A`` (4, 4) in the plane of axes ``p`` and ``q`` so that their element vanishes."""
    if A[p, q] == 0.0:
        return
    slope = (A[q, q] - A[p, p]) / (2.0 * A[p, q])
    t = math.copysign(1.0, slope) / (abs(slope) + math.sqrt(slope * slope + 1.0))
    c = 1.0 / math.sqrt(t * t + 1.0)
    s = t * c
    for k in range(4):
        A[k, p], A[k, q] = c * A[k, p] - s * A[k, q], s * A[k, p] + c * A[k, q]
    for k in range(4):
        A[p, k], A[q, k] = c * A[p, k] - s * A[q, k], s * A[p, k] + c * A[q, k]
        V[k, p], V[k, q] = c * V[k, p] - s * V[k, q], s * V[k, p] + c * V[k, q]
