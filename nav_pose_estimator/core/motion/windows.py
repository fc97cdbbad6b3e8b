"""The last second of the solution as the input of a network: 50 means per second, whatever the rate of the IMU.

Means rather than samples, for content above 25 Hz is vibration, which sampling would alias into the motion.
"""

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.filter.layout import OUT_FORCE, OUT_QUAT, OUT_RATE, OUT_T, OUT_VEL
from nav_pose_estimator.core.learning.conv_lstm import STEPS
from nav_pose_estimator.core.numerics.rotation import quat_to_matrix

Array = NDArray[np.float64]

SECONDS = 1.0
"""Length of the window [s]."""
CHANNELS = 9
"""Specific force (3) [m/s^2], angular rate (3) [rad/s], upward direction (3), all in b."""
INCREMENTS = 9
"""Number of values that ``increments`` returns."""
_SMALLEST = 1e-9  # rad: below, the rotation vector needs no scaling


def window(rows: Array) -> Array:
    """Means (STEPS, CHANNELS) over the second that ends with the newest of ``rows`` (N, OUT_COLUMNS), N > 0.

    A sample holds from the one before it; where the rows begin later than the window, the first one is extended back.
    """
    values = np.empty((len(rows), CHANNELS))
    values[:, :3], values[:, 3:6] = rows[:, OUT_FORCE : OUT_FORCE + 3], rows[:, OUT_RATE : OUT_RATE + 3]
    q0, q1, q2, q3 = rows[:, OUT_QUAT : OUT_QUAT + 4].T
    values[:, 6], values[:, 7] = 2.0 * (q1 * q3 - q0 * q2), 2.0 * (q2 * q3 + q0 * q1)
    values[:, 8] = 1.0 - 2.0 * (q1 * q1 + q2 * q2)
    if len(rows) == 1:
        return np.repeat(values, STEPS, axis=0)
    t = rows[:, OUT_T] - rows[-1, OUT_T]
    integral = np.zeros_like(values)
    np.cumsum(values[1:] * np.diff(t)[:, None], axis=0, out=integral[1:])
    edges = np.linspace(-SECONDS, 0.0, STEPS + 1)
    before = np.clip(np.searchsorted(t, edges, side="right") - 1, 0, len(t) - 2)
    at_edges = integral[before] + (edges - t[before])[:, None] * values[before + 1]
    return np.asarray(np.diff(at_edges, axis=0) * (STEPS / SECONDS))


def increments(rows: Array) -> Array:
    """Increments over that second, (INCREMENTS,): dp [m], dtheta [rad], dv [m/s], resolved in b at its end.

    dtheta is the rotation vector Log(C_begin' C_end), dp the integral of the velocity.
    """
    t = rows[:, OUT_T] - rows[-1, OUT_T]
    first = int(np.searchsorted(t, -SECONDS))
    v = rows[first:, OUT_VEL : OUT_VEL + 3]
    begin, end = (quat_to_matrix(rows[i, OUT_QUAT : OUT_QUAT + 4]) for i in (first, -1))
    return np.concatenate([SECONDS * v.mean(axis=0) @ end, rotation_vector(begin.T @ end), (v[-1] - v[0]) @ end])


def rotation_vector(C: Array) -> Array:
    """Logarithm (3,) of a rotation matrix (3, 3), for less than half a turn [rad]."""
    axis = 0.5 * np.array((C[2, 1] - C[1, 2], C[0, 2] - C[2, 0], C[1, 0] - C[0, 1]))
    sine = float(np.linalg.norm(axis))
    angle = float(np.arctan2(sine, 0.5 * (np.trace(C) - 1.0)))
    return axis * (angle / sine if sine > _SMALLEST else 1.0)
