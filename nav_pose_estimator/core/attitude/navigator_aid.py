"""Aiding of an attitude filter by a navigator: its change of velocity, and while GNSS aids it also its attitude.

Kernels on the state vector of ``core.attitude.layout`` and on the aid, a vector of ``SIZE`` numbers.
"""

import math

from nav_pose_estimator.core.attitude.layout import (
    COV,
    FORCE_BIAS,
    GRAVITY,
    NAV_HEADING,
    NAV_HEADING_VAR,
    QUAT,
)
from nav_pose_estimator.core.attitude.motion import subtract_velocity_change
from nav_pose_estimator.core.numerics.jit import inlined, kernel
from nav_pose_estimator.core.numerics.vectors import load4

DT = 0  # s since the last velocity
CHANGE = 1  # 3: change of the velocity since then, ENU, m/s
SPEED = 4  # m/s, negative when unknown
ATTITUDE = 5  # 4: q_nb, scalar first; zeros when unknown
HEADING_VAR = 9  # rad^2: variance of its heading as an observation, 0 where it is not one
LEVELLING = 10  # fraction of the difference in tilt that corrects the accelerometer bias, 0 for none
SIZE = 11

_MOST_BIAS = 0.5  # m/s^2: bound of the accelerometer bias
# rad: a filter with a larger heading deviation cannot resolve a velocity without orientation in its own axes.
_KNOWN_HEADING = 0.35


@kernel
def follow_navigator(s, aid):
    """Pass the change of the velocity to the filter, which is not gravity; learn heading and accelerometer bias.

    False, and nothing is done, where the navigator's axes are unknown because neither has a heading.
    """
    q = load4(aid, ATTITUDE)
    turn = 0.0
    if q[0] == 0.0 and q[1] == 0.0 and q[2] == 0.0 and q[3] == 0.0:
        if not s[COV + 8] < _KNOWN_HEADING * _KNOWN_HEADING:
            return False
    else:
        turn = _turn(load4(s, QUAT), q)
        if aid[HEADING_VAR] > 0.0:
            s[NAV_HEADING], s[NAV_HEADING_VAR] = _within_half_turn(-turn), aid[HEADING_VAR]
        if aid[LEVELLING] > 0.0:
            _learn_force_bias(s, q, aid[LEVELLING])
    c, d = math.cos(turn), math.sin(turn)
    east, north = aid[CHANGE], aid[CHANGE + 1]
    change = (c * east - d * north, d * east + c * north, aid[CHANGE + 2])
    subtract_velocity_change(s, change, aid[DT], 2.0 * aid[DT], aid[SPEED])
    return True


@inlined
def _turn(ours, q):
    """Angle [rad] about Up from the axes of the attitude ``q`` to those of the filter's attitude ``ours``."""
    a, b, c, d = ours
    w, x, y, z = q
    return 2.0 * math.atan2(d * w - a * z + c * x - b * y, a * w + b * x + c * y + d * z)


@inlined
def _within_half_turn(angle):
    """``angle`` [rad], of up to a whole turn, between -pi and pi."""
    if angle > math.pi:
        return angle - 2.0 * math.pi
    return angle + 2.0 * math.pi if angle < -math.pi else angle


@inlined
def _learn_force_bias(s, q, fraction):
    """The filter's up (from the accelerometer) less that of the attitude ``q``, in b, is the bias over gravity."""
    ours, theirs = _up_in_b(load4(s, QUAT)), _up_in_b(q)
    for i in range(3):
        bias = s[FORCE_BIAS + i] + fraction * s[GRAVITY] * (ours[i] - theirs[i])
        s[FORCE_BIAS + i] = min(max(bias, -_MOST_BIAS), _MOST_BIAS)


@inlined
def _up_in_b(q):
    w, x, y, z = q
    return 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)
