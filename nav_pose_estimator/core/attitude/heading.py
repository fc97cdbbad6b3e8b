"""What is known of the heading at the end of a window: by the field, and by the navigator while GNSS aids it.

The navigator's heading comes from the acceleration that GNSS sees. While it is there it is the better one, and the
compass is compared with it: what is left of a mounting about the vertical, a declination or hard iron is learned as an
offset, and stays taken out when the navigator's heading is gone.
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

_OFFSET_TAU = 60.0  # s: memory of the compass offset
_UNKNOWN = 0.35  # rad: a heading of this deviation is replaced, not corrected


@kernel
def observe_heading(s):
    """``(kind, error [rad], variance, least)``: the turn that the heading needs, as an observation of that variance.

    Kinds are those of ``observe_field``. ``least`` [rad^2]: before it, the heading's variance cannot be smaller. Where
    the reference was replaced, the heading is worth as little as it contradicts the new field.
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
