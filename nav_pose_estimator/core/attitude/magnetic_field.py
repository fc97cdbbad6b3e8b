"""Magnetic heading observation: reference field, noise that grows with the field's anomaly, and magnetometer delay.

The horizontal and downward parts of the undisturbed field do not depend on the heading. They are learned as a
reference. The deviation of the present field from them indicates the size of the unobservable part of a disturbance,
the one that turns the heading. So the noise of a magnetic heading grows with that anomaly, in place of a gate. A steady
field that disagrees with the reference for longer than the reference was supported replaces it.

A magnetometer lags behind the gyroscope by its integration time and filter. In a turn, the measured field is then
turned by the rate times the delay: by 4 deg at 5 rad/s and 15 ms. The norm of the horizontal part and the downward part
show this delay whatever the heading. So it is estimated, and its effect is removed from the field.
"""

import math

from nav_pose_estimator.core.attitude.hard_iron import learn_iron
from nav_pose_estimator.core.attitude.layout import (
    AGE,
    ANOMALY_GAIN,
    ANOMALY_TAU,
    DECLINATION,
    FIELD_ANOMALY,
    FIELD_CHANGES,
    FIELD_COUNT,
    FIELD_H,
    FIELD_SUPPORT,
    FIELD_TAU,
    FIELD_TIME,
    FIELD_TRUST,
    FIELD_TURN,
    FIELD_V,
    MAG_DELAY,
    MAG_DELAY_VAR,
    MOTION,
    NEW_AFTER,
    NEW_AGE,
    NEW_ANOMALY,
    NEW_H,
    NEW_LIMIT,
    NEW_SUPPORT,
    NEW_TAU,
    NEW_V,
    PERIOD,
    SUM_FIELD,
    SUM_SWEEP,
)
from nav_pose_estimator.core.numerics.jit import inlined, kernel
from nav_pose_estimator.core.numerics.vectors import add_scaled, load3, scale, store3

_SHORTEST = 0.05  # horizontal part of the field, relative to its downward part, below which there is no heading
_LONGEST = 1.0  # s: longest time that one observation stands for
_MIN_SUPPORT = 3.0  # s: smallest support that a candidate needs
_TURNING = 0.2  # rad/s: support of a candidate counts only while turning; at rest any field is steady
_DELAY_PSD = 0.02  # s: noise density of a part of the field, relative to the horizontal part squared, for the delay
_MOST_DELAY = 0.1  # s: bound of the estimated delay
NOTHING, FIRST, USUAL, REPLACED = 0, 1, 2, 3


@kernel
def field_anomaly(s):
    """Smoothed squared deviation of the field from the learned one, relative to it; infinite for a useless field."""
    return s[FIELD_ANOMALY] if s[FIELD_TRUST] > 0.0 else math.inf


@kernel
def observe_field(s):
    """Evaluate the mean field of the window: ``(kind, heading error [rad], seconds that it stands for)``.

    Kinds: NOTHING, no usable field; FIRST, the heading is unknown and has to be set; USUAL; REPLACED, a new reference
    replaced a wrong one, and the heading based on the old one is unreliable.
    """
    count = s[FIELD_COUNT]
    if count == 0.0:
        return NOTHING, 0.0, 0.0
    sweep = scale(1.0 / count, load3(s, SUM_SWEEP))
    field = add_scaled(scale(1.0 / count, load3(s, SUM_FIELD)), -s[MAG_DELAY], sweep)
    learn_iron(s, field)
    east, north, down = field[0], field[1], -field[2]
    s[FIELD_COUNT] = 0.0
    store3(s, SUM_FIELD, (0.0, 0.0, 0.0))
    store3(s, SUM_SWEEP, (0.0, 0.0, 0.0))
    horizontal = math.sqrt(east * east + north * north)
    if horizontal <= _SHORTEST * abs(down):
        s[FIELD_TRUST] = 0.0
        return NOTHING, 0.0, 0.0
    error = math.atan2(east, north) - s[DECLINATION]
    error -= 2.0 * math.pi * math.floor((error + math.pi) / (2.0 * math.pi))
    window = min(max(s[AGE] - s[FIELD_TIME], s[PERIOD]), _LONGEST)
    s[FIELD_TIME] = s[AGE]
    if s[FIELD_H] == 0.0:
        s[FIELD_H], s[FIELD_V], s[FIELD_SUPPORT], s[FIELD_TRUST] = horizontal, down, window, 1.0
        s[NEW_H], s[NEW_V] = horizontal, down
        s[FIELD_TURN] = 0.0
        return FIRST, error, window
    s[FIELD_TURN] += window * s[MOTION]
    replaced = _weigh_candidate(s, horizontal, down, window)
    _learn_reference(s, horizontal, down, window)
    if replaced:
        s[FIELD_TURN] = 0.0
        return REPLACED, error, window
    along = (east * sweep[0] + north * sweep[1]) / horizontal
    _learn_delay(s, horizontal - s[FIELD_H], along, window)
    _learn_delay(s, down - s[FIELD_V], -sweep[2], window)
    return USUAL, error, window


@inlined
def _learn_delay(s, residual, per_second, window):
    """Kalman update of the delay: ``residual`` of one part of the field, which changes by ``per_second`` of delay."""
    noise = s[FIELD_H] ** 2 * _DELAY_PSD / (window * s[FIELD_TRUST])
    gain = s[MAG_DELAY_VAR] * per_second / (per_second * per_second * s[MAG_DELAY_VAR] + noise)
    delay = s[MAG_DELAY] + gain * residual
    s[MAG_DELAY_VAR] -= gain * per_second * s[MAG_DELAY_VAR]
    s[MAG_DELAY] = min(max(delay, -_MOST_DELAY), _MOST_DELAY)


@kernel
def _distance(s, h, v, other_h, other_v):
    return ((h - other_h) ** 2 + (v - other_v) ** 2) / s[FIELD_H] ** 2


@kernel
def _weigh_candidate(s, horizontal, down, window):
    """Update the candidate from the field of the last seconds; True when it replaces the reference."""
    gain = min(1.0, window / s[ANOMALY_TAU])
    s[NEW_ANOMALY] += gain * (_distance(s, horizontal, down, s[NEW_H], s[NEW_V]) - s[NEW_ANOMALY])
    s[NEW_AGE] = s[NEW_AGE] + window if s[NEW_ANOMALY] < s[NEW_LIMIT] else 0.0
    slow = min(1.0, window / min(s[NEW_TAU], max(s[NEW_AGE], window)))
    s[NEW_H] += slow * (horizontal - s[NEW_H])
    s[NEW_V] += slow * (down - s[NEW_V])
    differs = _distance(s, s[NEW_H], s[NEW_V], s[FIELD_H], s[FIELD_V]) > s[NEW_LIMIT]
    if not (differs and s[NEW_ANOMALY] < s[NEW_LIMIT]):
        s[NEW_SUPPORT] = max(s[NEW_SUPPORT] - window, 0.0)
        return False
    if s[MOTION] > _TURNING:
        s[NEW_SUPPORT] += window
    if s[NEW_SUPPORT] < min(max(s[FIELD_SUPPORT], _MIN_SUPPORT), s[NEW_AFTER]):
        return False
    s[FIELD_H], s[FIELD_V], s[FIELD_SUPPORT], s[NEW_SUPPORT] = s[NEW_H], s[NEW_V], s[NEW_SUPPORT], 0.0
    s[FIELD_ANOMALY] = s[NEW_ANOMALY]
    s[FIELD_CHANGES] += 1.0
    return True


@kernel
def _learn_reference(s, horizontal, down, window):
    distance = _distance(s, horizontal, down, s[FIELD_H], s[FIELD_V])
    s[FIELD_ANOMALY] += min(1.0, window / s[ANOMALY_TAU]) * (distance - s[FIELD_ANOMALY])
    s[FIELD_TRUST] = 1.0 / (1.0 + s[ANOMALY_GAIN] * s[FIELD_ANOMALY])
    gain = s[FIELD_TRUST] * window / min(s[FIELD_SUPPORT] + window, s[FIELD_TAU])
    s[FIELD_H] += gain * (horizontal - s[FIELD_H])
    s[FIELD_V] += gain * (down - s[FIELD_V])
    s[FIELD_SUPPORT] += s[FIELD_TRUST] * window
