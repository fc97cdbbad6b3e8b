"""Solution of Wahba's problem, the rotation that best fits two sets of vectors, for use inside kernels.

Davenport's q method: the quaternion that maximises the trace is the eigenvector of the largest eigenvalue of a
symmetric matrix (4, 4), and the eigenvalue is that trace (Markley & Crassidis, Fundamentals of Spacecraft Attitude
Determination and Control, 2014, section 5.3). The eigenvalues are computed by Jacobi's method, which is accurate to
rounding even where some of them are equal. For parallel vectors, where the rotation is not unique, the result is one of
the solutions.
"""

import math

import numpy as np

from nav_pose_estimator.core.numerics.jit import kernel
from nav_pose_estimator.core.numerics.vectors import load4

_MAX_SWEEPS = 12  # quadratic convergence needs four or five
_NEGLIGIBLE = 1e-34  # sum of squares off the diagonal, relative to that of the matrix, that counts as zero
_ROUNDING = 1e-17  # size of an element, relative to the diagonal, below which it changes nothing


@kernel
def best_rotation(B):
    """Quaternion (4 numbers) of the rotation R that maximises tr R'B, with ``B`` (3, 3) = sum u s', and that trace.

    R minimises the sum of |u - R s|^2 over the pairs of vectors (u, s).
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
    """Diagonalise the symmetric ``A`` (4, 4) in place by Jacobi rotations; the columns of ``V`` become eigenvectors."""
    for _ in range(_MAX_SWEEPS):
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
    """Apply the Jacobi rotation in the plane of the axes ``p`` and ``q`` that makes ``A[p, q]`` zero."""
    if abs(A[p, q]) <= _ROUNDING * (abs(A[p, p]) + abs(A[q, q])):
        A[p, q] = A[q, p] = 0.0
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
