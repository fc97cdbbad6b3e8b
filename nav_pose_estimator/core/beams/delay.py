"""How old velocities are when they are stamped: innovations proportional to the acceleration along the beam."""

import math

from nav_pose_estimator.core.filter.layout import DVEL, PHI, PREV_ACCEL, PREV_RATE, QUAT
from nav_pose_estimator.core.numerics.jit import kernel
from nav_pose_estimator.core.numerics.vectors import dot, load3, load4, q_rotate

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
