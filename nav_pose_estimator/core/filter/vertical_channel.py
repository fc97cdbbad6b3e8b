"""Height update of the vertical channel alone: only vertical position and velocity are corrected.

In an outage the tilt errors grow to many degrees, and the covariance then correlates height with the horizontal states.
That correlation is linear, and a barometer has errors of metres over a minute (wind, dynamic pressure). A full update
turns them into false and over-confident corrections of tilt and horizontal position. On recorded flights a barometer
that corrected every state made the horizontal drift at 60 s up to a fifth larger, and its stated deviation a third too
small.

A gain with zeros is not optimal. Joseph's form holds for any gain, so the covariance remains valid.
Source: Schmidt's consider filter with a gain set to zero, Simon, "Optimal State Estimation", section 10.2.
"""

import math

import numpy as np

from nav_pose_estimator.core.filter.error_state import inject
from nav_pose_estimator.core.filter.kalman import ACCEPTED, INFLATED, REJECTED
from nav_pose_estimator.core.filter.layout import DPOS, DVEL
from nav_pose_estimator.core.numerics.jit import kernel

_UP = DPOS + 2


@kernel
def gated_height(nav, P, constants, z, variance, soft, hard):
    """Update by a height: innovation ``z`` [m], estimate minus measurement, of ``variance`` [m^2].

    Returns (status, nis); gate and statuses are those of ``kalman.gated_correct``.
    """
    n = P.shape[0]
    S = P[_UP, _UP] + variance
    nis = z * z / S if S > 0.0 else math.inf
    if not (nis <= hard and nis < math.inf):
        return REJECTED, nis
    status = ACCEPTED
    if nis > soft:
        status = INFLATED
        S *= nis / soft
    gain = np.zeros(n)
    gain[DVEL + 2] = P[DVEL + 2, _UP] / S
    gain[_UP] = P[_UP, _UP] / S
    row = P[_UP].copy()
    # Joseph's form of one observation of one state: P - k p' - p k' + S k k'
    for i in range(n):
        for j in range(i + 1):
            P[i, j] += S * gain[i] * gain[j] - gain[i] * row[j] - row[i] * gain[j]
            P[j, i] = P[i, j]
    for i in range(n):
        gain[i] *= z
    inject(nav, constants, gain)
    return status, nis
