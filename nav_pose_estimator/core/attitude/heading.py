"""Heading observation at the end of a window: from the navigator while GNSS aids it, else from the magnetic field.

The navigator's heading is observable through the accelerations that GNSS sees, and is the better one while available.
Meanwhile the difference to the compass is learned as an offset: residual mounting about the vertical, declination, hard
iron. The offset remains in use when the navigator's heading is no longer available.
"""

import math

from nav_pose_estimator.core.attitude.layout import (
    AGE,
    COMPASS_OFFSET,
    COV,
    FIELD_TRUST,
    FIELD_TURN,
    HEADING_PSD,
    NAV_HEADING,
    NAV_HEADING_VAR,
    NEW_HEADING_VAR,
    OFFSET_SUPPORT,
    OFFSET_TIME,
    PLACE_VAR,
)
from nav_pose_estimator.core.attitude.magnetic_field import FIRST, NOTHING, REPLACED, USUAL, observe_field
from nav_pose_estimator.core.numerics.jit import inlined, kernel

_OFFSET_TAU = 60.0  # s: averaging time of the compass offset
_UNKNOWN = 0.35  # rad: a heading with a larger standard deviation is replaced instead of corrected


@kernel
def observe_heading(s):
    """``(kind, error [rad], variance [rad^2], least [rad^2])``: the heading error as an observation of ``variance``.

    Kinds are those of ``observe_field``. ``least`` is a lower bound of the heading's variance before the update. Where
    the reference field was replaced, that bound is the squared contradiction between heading and new field.
    """
    kind, error, window = observe_field(s)
    if s[NAV_HEADING_VAR] > 0.0:
        nav, variance = s[NAV_HEADING], s[NAV_HEADING_VAR]
        s[NAV_HEADING_VAR] = 0.0
        if kind != NOTHING:
            _learn_offset(s, _wrapped(error - nav), window)
        unknown = kind == FIRST or s[COV + 8] > _UNKNOWN * _UNKNOWN
        return (FIRST if unknown else USUAL), nav, variance, 0.0
    if kind == NOTHING:
        return NOTHING, 0.0, 0.0, 0.0
    variance = s[HEADING_PSD] / (window * max(s[FIELD_TRUST], 1e-12))
    error = _wrapped(error - s[COMPASS_OFFSET])
    if kind == REPLACED:
        return kind, error, variance, max(s[COV + 8], min(error * error, s[NEW_HEADING_VAR]))
    return kind, error, variance, s[PLACE_VAR] / (1.0 + s[FIELD_TURN])


@inlined
def _learn_offset(s, offset, window):
    weight = s[FIELD_TRUST] * window
    s[OFFSET_TIME] = s[AGE]
    s[OFFSET_SUPPORT] = min(s[OFFSET_SUPPORT] + weight, _OFFSET_TAU)
    s[COMPASS_OFFSET] += weight / max(s[OFFSET_SUPPORT], 1e-9) * _wrapped(offset - s[COMPASS_OFFSET])


@inlined
def _wrapped(angle):
    return angle - 2.0 * math.pi * math.floor((angle + math.pi) / (2.0 * math.pi))
