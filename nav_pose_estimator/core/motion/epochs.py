"""Epochs: half-second means of the navigation solution, the data of training and prediction.

An epoch is one row (COLUMNS,): time of its end, mean attitude matrix, and the means of velocity (body and level frame),
specific force, angular rate and position. Velocity in b is the mean of ``C^T v``, not the product of the means: an
aerobatic aircraft rolls far within half a second.
"""

import math

import numpy as np

from nav_pose_estimator.core.filter.layout import OUT_FORCE, OUT_POS, OUT_QUAT, OUT_RATE, OUT_VEL
from nav_pose_estimator.core.numerics.jit import kernel
from nav_pose_estimator.core.numerics.rotation import quat_to_matrix

PERIOD = 0.5  # s: length of an epoch
TIME, ATTITUDE, BODY_VELOCITY, VELOCITY, FORCE, RATE, POSITION, COLUMNS = 0, 1, 10, 13, 16, 19, 22, 25
"""Columns: s, C_nb row-major (9), C^T v [m/s] (3), v_n [m/s] (3), f_b [m/s^2] (3), w_b [rad/s] (3), lat, lon, alt."""
ACTIVITY_EPOCHS = 4
"""Epochs over which ``activity`` is averaged: two seconds, enough to tell a hovering multirotor from a moving one."""
_STILL = 1e-4  # (m/s^2)^2: added to the mean square acceleration, so that its logarithm is bounded at rest


@kernel
def epoch(t, rows):
    """The epoch that ends at ``t`` [s] from output rows (N, OUT_COLUMNS) of ``core.filter.layout``, N > 0."""
    mean = np.zeros(COLUMNS)
    N = rows.shape[0]
    for n in range(N):
        C = quat_to_matrix(rows[n, OUT_QUAT : OUT_QUAT + 4])
        for i in range(3):
            for j in range(3):
                mean[ATTITUDE + 3 * i + j] += C[i, j]
                mean[BODY_VELOCITY + i] += C[j, i] * rows[n, OUT_VEL + j]
            mean[VELOCITY + i] += rows[n, OUT_VEL + i]
            mean[FORCE + i] += rows[n, OUT_FORCE + i]
            mean[RATE + i] += rows[n, OUT_RATE + i]
            mean[POSITION + i] += rows[n, OUT_POS + i]
    for c in range(COLUMNS):
        mean[c] /= N
    mean[TIME] = t
    return mean


def attitude(epochs: np.ndarray) -> np.ndarray:
    """C_nb of epochs (N, COLUMNS), (N, 3, 3)."""
    return epochs[:, ATTITUDE:BODY_VELOCITY].reshape(-1, 3, 3)


def inputs(epochs: np.ndarray) -> np.ndarray:
    """Inputs of a law of motion, (N, 9 + K), from epochs (N, COLUMNS + K): specific force, angular rate and upward
    direction in b, and the K columns that the method adds to an epoch."""
    return np.concatenate([epochs[:, FORCE:POSITION], attitude(epochs)[:, 2], epochs[:, COLUMNS:]], axis=1)


def activity(epochs: np.ndarray) -> np.ndarray:
    """Logarithm (N,) of the RMS horizontal acceleration [m/s^2] over the two seconds that end with each epoch."""
    return np.asarray(_activity(np.ascontiguousarray(epochs)))


@kernel
def _activity(epochs):
    count = len(epochs)
    squares, active = np.zeros(count), np.empty(count)
    for n in range(count):
        for i in range(2):
            along = 0.0
            for j in range(3):
                along += epochs[n, ATTITUDE + 3 * i + j] * epochs[n, FORCE + j]
            squares[n] += along * along
        first = max(n + 1 - ACTIVITY_EPOCHS, 0)
        active[n] = 0.5 * math.log(squares[first : n + 1].mean() + _STILL)
    return active
