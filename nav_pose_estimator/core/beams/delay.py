"""Latency of beam velocities, observed as innovations proportional to the acceleration along the beam."""

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

_FORGETTING = 0.998  # factor of the sums from one message to the next
_SPAN, _LONGEST = 0.19, 1.1  # s: shortest and longest interval over which the velocity is differenced
_SETTLES = 3.0  # s after a return of GNSS in which its corrections must not pass for an acceleration of the vehicle
# Layout of ``past``:
_OLD, _NEW = 0, 4  # time [s] and velocity at the sensor in b (3) [m/s] of two earlier messages
_SETTLED, _GNSS_WAS_GOOD = 8, 9  # time [s] at which the corrections have settled; 0 or 1
_PAST_SIZE = 10


def no_past():
    """Memory (10,) of ``velocity_change`` before the first message."""
    past = np.full(_PAST_SIZE, -np.inf)
    past[_GNSS_WAS_GOOD] = 1.0
    return past


@kernel
def add_delay(sums, z, H, nav):
    """Add innovations ``z`` (n,) [m/s] with their rows ``H`` (n, states) to the regression ``sums`` (4,).

    ``z`` is estimate minus measurement, NaN where lost. The sums are slope times innovation [m^2/s^3], slope squared
    [m^2/s^4], innovation squared [m^2/s^2], and the number of beams. The slope is the rate of change of the velocity
    along the beam, by the vehicle's acceleration and by the rotation of the beam. The delay is the first sum over the
    second.
    """
    acceleration = load3(nav, PREV_ACCEL)
    turning = q_rotate(load4(nav, QUAT), load3(nav, PREV_RATE))
    for i in range(len(sums)):
        sums[i] *= _FORGETTING
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
    """Velocity over ground (3,) in b [m/s] of the point at lever arm ``lever`` (3,) [m] in b from the IMU."""
    velocity = np.empty(3)
    swing = cross(load3(nav, PREV_RATE), load3(lever, 0))
    store3(velocity, 0, add(q_rotate_back(load4(nav, QUAT), load3(nav, VEL)), swing))
    return velocity


@kernel
def velocity_change(past, nav, P, t, lever, gnss_is_good, delay):
    """Rate of change of the velocity in b, at lever arm ``lever`` (3,) [m] and time ``t`` [s], for the delay estimate.

    The velocity is differenced over two tenths of a second, or from one message to the next at lower rates, which
    averages out vibration. ``past`` (10,) is updated; ``delay`` is the index of the state of block ``dvl_delay``.
    Returns that rate of change (3,) [m/s^2], zero where unknown; the standard deviation of the delay [s]; and the
    variance that an uncertain rate of change adds to a delayed velocity [m^2/s^2]. Without that variance the delay and
    its deviation would be estimated too small while the velocity is uncertain.
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
