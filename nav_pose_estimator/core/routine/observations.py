"""Kernels of routine observations: each kind is tested and applied, and its result reported, in compiled code.

The tests are those of the sensors (``engine.sensors``), with the same numbers. Where one fails, the kernel leaves the
filter unchanged, and the sensor decides. So these kernels only ever decide that an observation is routine.
"""

import math

import numpy as np

from nav_pose_estimator.core.filter import bias_noise, measurements
from nav_pose_estimator.core.filter.kalman import ACCEPTED, gated_correct, innovation
from nav_pose_estimator.core.filter.layout import ALT, DPOS, LAT, PHI, QUAT
from nav_pose_estimator.core.filter.strapdown import note_gnss
from nav_pose_estimator.core.gnss import slow_height
from nav_pose_estimator.core.numerics.jit import inlined, kernel
from nav_pose_estimator.core.routine import table

_SURE = 1.0 - 1e-6  # margin of a bound that the sensor computes in another order, for rounding


@kernel
def act(nav, P, constants, event, settings, result):
    """Apply the observation of one ``event`` to a filter that is at its time, with ``P`` up to date.

    Returns False, with nothing changed, where it is not routine; else ``result`` (RESULT_COLUMNS,) is filled.
    """
    kind = int(event[table.EVENT_KIND])
    for i in range(3):
        result[table.RESULT_BEFORE + i] = nav[LAT + i]
    if kind == table.HEIGHT:
        done = _height(nav, P, event, settings, result)
    elif kind == table.HEADING:
        done = _heading(nav, P, event, settings, result)
    elif kind == table.UNUSUAL or kind == table.NOTHING:
        done = kind == table.NOTHING
    else:
        done = _gnss(nav, P, constants, event, settings, result)
    for i in range(3):
        result[table.RESULT_AFTER + i] = nav[LAT + i]
    return done


@kernel
def _gnss(nav, P, constants, event, settings, result):
    """A GNSS velocity or position that agrees with a filter aided by GNSS, or one that a replay applies again."""
    kind, t, m = int(event[table.EVENT_KIND]), event[table.EVENT_T], int(event[table.EVENT_ROWS])
    is_new = kind == table.VELOCITY or kind == table.POSITION
    if is_new and not t - settings[table.FIX_USED] <= settings[table.LOST_AFTER]:
        return False
    value, lever = event[table.EVENT_VALUE : table.EVENT_NOISE], settings[table.LEVER : table.DOUBTFUL]
    is_velocity = kind == table.VELOCITY or kind == table.SAME_VELOCITY
    if is_velocity:
        z, H = measurements.gnss_velocity(nav, len(P), value, lever)
        measurements.see_gnss_error(z, H, nav, constants, measurements.VELOCITY)
        for i in range(3):
            result[table.RESULT_INNOVATION + i] = z[i]
    else:
        z, H = measurements.gnss_position(nav, len(P), value[0], value[1], value[2], lever)
        measurements.see_gnss_error(z, H, nav, constants, measurements.POSITION)
    if kind == table.POSITION and not _is_usual(t, z, H, P, event, settings, result):
        return False
    if kind != table.NO_GNSS:
        soft = settings[table.SOFT + m - 1]
        hard = soft if is_new else settings[table.HARD + m - 1]  # a new observation is routine only if ACCEPTED
        status, nis = gated_correct(nav, P, constants, z[:m], H[:m], _noise(event, m), soft, hard)
        if is_new and status != ACCEPTED:
            return False
        result[table.RESULT_NIS] = nis
    if kind == table.VELOCITY:
        z, H = measurements.gnss_velocity(nav, len(P), value, lever)
        measurements.see_gnss_error(z, H, nav, constants, measurements.VELOCITY)
        for i in range(3):
            result[table.RESULT_Z + i] = z[i]
    elif kind == table.POSITION:
        settings[table.FIX_USED] = max(settings[table.FIX_USED], t)
        settings[table.HEIGHT_USED] = max(settings[table.HEIGHT_USED], t)
        off = -result[table.RESULT_Z + 2]
        settings[table.LAST_HEIGHT_T], settings[table.LAST_HEIGHT] = t, off
        mean = slow_height.mean_after(settings[table.HEIGHT_MEAN], settings[table.HEIGHT_MEAN_T], t, off)
        settings[table.HEIGHT_MEAN_T], settings[table.HEIGHT_MEAN] = t, mean
        result[table.RESULT_LEAST] = max(settings[table.LEAST_HEIGHT_SD], abs(mean))
        _keep_height_vague(P, result[table.RESULT_LEAST])
    elif kind == table.SAME_POSITION:
        _keep_height_vague(P, event[table.EVENT_LEAST])
    if t - settings[table.FIX_USED] <= settings[table.LOST_AFTER]:
        bias_noise.observe(nav, P)
        note_gnss(nav)
    return True


@kernel
def _is_usual(t, z, H, P, event, settings, result):
    """Whether a fix agrees with the filter while fixes are used."""
    if not t - settings[table.FIX_USED] <= settings[table.RETURN_AFTER]:
        return False
    if not math.sqrt(innovation(P, z[:2], H[:2], _noise(event, 2))) <= settings[table.DOUBTFUL]:
        return False
    for i in range(3):
        result[table.RESULT_Z + i] = z[i]
    for i in range(2):
        result[table.RESULT_SD + i] = math.sqrt(P[DPOS + i, DPOS + i])
    R = _noise(event, 3)
    return _is_expected(z, P, R, settings[table.SIGMAS]) and _has_usual_height(t, z, P, R, settings)


@kernel
def _keep_height_vague(P, sd):
    """Floor of the height's standard deviation at ``sd`` [m]."""
    if sd > 0.0:
        P[DPOS + 2, DPOS + 2] = max(P[DPOS + 2, DPOS + 2], sd * sd)


@kernel
def _is_expected(z, P, R, sigmas):
    """Whether a fix is within ``sigmas``, horizontally and vertically, and on each horizontal axis."""
    square = 0.0
    for i in range(2):
        variance = R[i, i] + P[DPOS + i, DPOS + i]
        if not abs(z[i]) <= sigmas * math.sqrt(variance):
            return False
        square += z[i] * z[i] / variance
    vertical = abs(z[2]) / math.sqrt(R[2, 2] + P[DPOS + 2, DPOS + 2])
    return max(math.sqrt(square), vertical) <= _SURE * sigmas


@kernel
def _has_usual_height(t, z, P, R, settings):
    """Whether the height has no step from the last one and is within its bound."""
    off, sigmas = -z[2], settings[table.SIGMAS]
    scatter = 0.5 * sigmas * math.sqrt(R[2, 2])
    is_next = t - settings[table.LAST_HEIGHT_T] < settings[table.HEIGHT_PAUSE]
    if is_next and abs(off - settings[table.LAST_HEIGHT]) > max(scatter, settings[table.HEIGHT_STEP]):
        return False
    return abs(off) <= sigmas * math.sqrt(R[2, 2] + P[DPOS + 2, DPOS + 2])


@kernel
def _height(nav, P, event, settings, result):
    """A barometric height while GNSS is good: it is compared only."""
    t, variance = event[table.EVENT_T], P[DPOS + 2, DPOS + 2]
    for used in (settings[table.FIX_USED], settings[table.HEIGHT_USED]):
        if not t - used <= settings[table.LOST_AFTER]:
            return False
    is_near = abs(event[table.EVENT_VALUE] - nav[ALT]) < settings[table.BARO_APART]
    if not (is_near and variance <= settings[table.VAGUE_VAR]):
        return False
    result[table.RESULT_HEIGHT], result[table.RESULT_VARIANCE] = nav[ALT], variance
    return True


@kernel
def _heading(nav, P, event, settings, result):
    """A magnetic heading while GNSS shows the heading: it is compared only."""
    if not event[table.EVENT_T] - settings[table.FIX_USED] <= settings[table.LOST_AFTER]:
        return False
    if not math.sqrt(P[PHI + 2, PHI + 2]) < settings[table.HEADING_SD]:
        return False
    x, y, z = event[table.EVENT_VALUE], event[table.EVENT_VALUE + 1], event[table.EVENT_VALUE + 2]
    error, _ = measurements.magnetic_heading(nav, len(P), x, y, z, settings[table.DECLINATION])
    result[table.RESULT_ERROR] = error[0]
    for i in range(4):
        result[table.RESULT_QUAT + i] = nav[QUAT + i]
    return True


@inlined
def _noise(event, rows):
    """R (rows, rows) of an event."""
    R = np.empty((rows, rows))
    for i in range(rows):
        for j in range(rows):
            R[i, j] = event[table.EVENT_NOISE + 3 * i + j]
    return R
