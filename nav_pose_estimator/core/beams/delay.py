"""How old velocities are when they are stamped: innovations proportional to the acceleration along the beam."""

import math

import numpy as np

from nav_pose_estimator.core.filter.layout import DVEL, DVL_DELAY, PHI, PREV_ACCEL, PREV_RATE, QUAT, VEL
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
_SPAN, _LONGEST = 0.19, 1.1  # s over which the velocity's change is taken, at the least and at the most
_SETTLES = 3.0  # s after a return of GNSS, in which what it corrects is no change of the vehicle's velocity
_OLD, _NEW = 0, 4  # time [s] and velocity at the sensor in b (3) of two earlier messages
_SETTLED, _GNSS_WAS_GOOD = 8, 9  # s; 0 or 1
_PAST_SIZE = 10


def no_past():
    """What ``velocity_change`` remembers before the first message."""
    past = np.full(_PAST_SIZE, -np.inf)
    past[_GNSS_WAS_GOOD] = 1.0
    return past


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


@kernel
def velocity_change(past, nav, P, t, lever, gnss_is_good, delay):
    """How fast the velocity at ``lever`` (3,) [m] in b has changed until ``t`` [s], what that tells of the delay.

    By differences over two tenths of a second, or from one message to the next where these come more slowly: vibration
    does not show in them, and they are as good for a delay as a line between the two is. ``past`` is brought up to
    date; ``delay`` is the state of block ``dvl_delay``. Returns the change (3,) [m/s^2], zero where unknown; the
    deviation of the delay [s]; and the noise that an uncertain change adds to a late velocity [m^2/s^2]. Without that
    the delay would seem too small, and its deviation too, while the velocity is vague.
    """
    if gnss_is_good and past[_GNSS_WAS_GOOD] == 0.0:
        past[_SETTLED] = t + _SETTLES
    past[_GNSS_WAS_GOOD] = 1.0 if gnss_is_good else 0.0
    if t < past[_SETTLED] or past[_NEW] >= t:
        past[_OLD] = past[_NEW] = -math.inf
    change, variance, spread = np.zeros(3), 0.0, P[delay, delay]
    velocity = velocity_at(nav, lever)
    begin = _NEW if t - past[_NEW] >= _SPAN else _OLD
    span = t - past[begin]
    if span <= _LONGEST:
        for i in range(3):
            change[i] = (velocity[i] - past[begin + 1 + i]) / span
        vague = max(P[DVEL, DVEL], P[DVEL + 1, DVEL + 1], P[DVEL + 2, DVEL + 2])
        variance = (nav[DVL_DELAY] * nav[DVL_DELAY] + spread) * vague / (span * span)
    if begin == _NEW:
        for i in range(_NEW - _OLD):  # no slices: their errors take seconds to compile
            past[_OLD + i] = past[_NEW + i]
        past[_NEW] = t
        store3(past, _NEW + 1, load3(velocity, 0))
    return change, math.sqrt(spread), variance
