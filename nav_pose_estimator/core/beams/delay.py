"""How old velocities are when they are stamped: innovations proportional to the acceleration along the beam."""

import math

import numpy as np

from nav_pose_estimator.core.filter.layout import DVEL, PHI, PREV_ACCEL, PREV_RATE, QUAT, VEL
from nav_pose_estimator.core.numerics.jit import kernel
from nav_pose_estimator.core.numerics.vectors import (
    add,
    cross,
    dot,
    load3,
    load4,
    q_rotate,
    q_rotate_back,
    store3,
)

_MEMORY = 0.998  # of one message


@kernel
def add_delay(sums, z, H, nav):
    """Add innovations ``z`` (n,) [m/s], estimate minus measurement, NaN where lost, with their rows ``H`` to ``sums``.

    These (4,) are slope times innovation, slope squared [m^2/s^4], innovation squared [m^2/s^2], and how many beams.
    The slope is how fast the velocity along the beam changes: by the acceleration, and by the turning of the beam.
    """
    acceleration = load3(nav, PREV_ACCEL)
    turning = q_rotate(load4(nav, QUAT), load3(nav, PREV_RATE))
    for i in range(len(sums)):
        sums[i] *= _MEMORY
    for i in range(len(z)):
        if not math.isfinite(z[i]):
            continue
        slope = dot(load3(H[i], DVEL), acceleration) - dot(load3(H[i], PHI), turning)
        sums[0] += slope * z[i]
        sums[1] += slope * slope
        sums[2] += z[i] * z[i]
        sums[3] += 1.0


@kernel
def velocity_at(nav, lever):
    """Velocity (3,) over ground in b [m/s] of a point at ``lever`` (3,) [m] from the IMU."""
    velocity = np.empty(3)
    swing = cross(load3(nav, PREV_RATE), load3(lever, 0))
    store3(velocity, 0, add(q_rotate_back(load4(nav, QUAT), load3(nav, VEL)), swing))
    return velocity
