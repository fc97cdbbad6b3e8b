"""Identification of the gyroscope bias's driving noise in flight, from the filter's own corrections of the bias.

Over a window W, the change of the bias estimate has the variance ``E = q W + P(t) - P(t + W)``: driving noise plus the
decrease of the bias variance. (The innovations of an optimal filter are white, so its corrections add up like a random
walk.) The ratio of the squared change to ``E`` averages one when the driving noise ``q`` is right. It is larger when
the bias wanders more than modelled (temperature, vibration), and smaller for a better gyroscope. Windows of 30 s show
this clearly, because unmodelled effects accumulate in one direction.

Innovations that are larger than expected for other reasons (manoeuvres, a poor receiver) already show in windows of 3
s. They are no evidence of a wandering bias, so the long ratio is divided by the mean short one where that exceeds one.

Where the bias moves even less than the smallest noise predicts, the measurement noise is overstated (a receiver much
better than the floor that is set for all receivers), and with it the whole covariance. The mean ratio of the long
windows gives the factor (``overstatement``). A common factor does not change the gains, so it only matters once GNSS is
lost.

The noise follows a stochastic approximation, ``ln q += gain (ratio - 1)``, within bounds. All memory lies in ``nav``,
so that a checkpoint of the filter includes it and a replay repeats it exactly.

Sources: R. Mehra, IEEE Trans. Automatic Control 17(5), 1972 (covariance matching); K. Myers and B. Tapley, IEEE Trans.
Automatic Control 21(4), 1976 (noise from the corrections of the state).
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.filter.layout import (
    D_GYRO_BIAS,
    GYRO_BIAS,
    GYRO_BIAS_PSD,
    GYRO_WANDER,
    TIME,
    WANDER_COUNT,
    WANDER_FLOOR,
    WANDER_LEVEL,
    WANDER_MARKS,
    WANDER_MEAN,
    WANDER_SHORT_COUNT,
    WANDER_TIME,
)
from nav_pose_estimator.core.numerics.jit import kernel

SMALLEST, LARGEST = 1.0 / 16.0, 4.0
"""Bounds of the driving noise's density, relative to the parameter: 1/4 to 2 times its standard deviation."""

_SHORT, _LONG = 3.0, 30.0  # s: lengths of the windows
_MARKS = 4  # windows open at a time: a short one and three long ones, which begin 10 s apart
_MARK_SIZE = 8  # of an open window: start time (negative: none), bias (3), its variance (3), driving noise since then
_GAIN = 0.2  # of the stochastic approximation, per long window
_LONGEST_STEP = 2.0  # s without an observation after which all windows are dropped: they must not span an outage
_LARGEST_RATIO = 4.0  # limit of the ratio of a long window, against outliers
_LARGEST_SHORT_RATIO = 9.0  # limit of the ratio of a short window
_SHORT_MEMORY = 20.0  # short windows over which their ratio is averaged
_LONG_MEMORY = 5.0  # long windows over which their ratio is averaged
_BENEFIT = 2.0  # safety factor on that mean, which comes from a handful of overlapping windows
_SMALLEST_FACTOR = 0.25  # of the covariance, half the standard deviation: one state is no evidence for more
_INFORMED = 0.2  # a window counts if the observations removed at least this fraction of its driving noise


class Wander(NamedTuple):
    """Identified gyroscope: driving noise relative to the parameter, and the running means over windows."""

    factor: float = 1.0
    level: float = 1.0
    short_windows: float = 0.0
    mean: float = 1.0


def learned(nav: NDArray[np.float64]) -> Wander:
    """The result stored in ``nav`` (NAV_SIZE,), to be passed on to a later filter."""
    floor = float(nav[WANDER_FLOOR])
    if not floor > 0.0:
        return Wander()
    factor = SMALLEST * (1.0 + float(nav[GYRO_WANDER]) / floor)
    return Wander(factor, float(nav[WANDER_LEVEL]), float(nav[WANDER_SHORT_COUNT]), float(nav[WANDER_MEAN]))


def go_on(nav: NDArray[np.float64], wander: Wander) -> None:
    """After ``begin``: continue in ``nav`` (NAV_SIZE,) from a result that was ``learned`` before."""
    if nav[WANDER_FLOOR] > 0.0:
        nav[GYRO_WANDER] = nav[WANDER_FLOOR] * (wander.factor / SMALLEST - 1.0)
        nav[WANDER_LEVEL], nav[WANDER_SHORT_COUNT] = wander.level, wander.short_windows
        nav[WANDER_MEAN] = wander.mean


@kernel
def begin(nav, constants):
    """Start the identification at the parameter's density; ``constants`` hold the smallest one."""
    nav[WANDER_FLOOR] = constants[GYRO_BIAS_PSD]
    nav[GYRO_WANDER] = constants[GYRO_BIAS_PSD] * (1.0 / SMALLEST - 1.0)
    nav[WANDER_LEVEL] = nav[WANDER_MEAN] = 1.0
    nav[WANDER_SHORT_COUNT] = nav[WANDER_COUNT] = 0.0
    nav[WANDER_TIME] = nav[TIME]
    _forget_windows(nav)


@kernel
def observe(nav, P):
    """Process the bias after a GNSS update; ``nav[GYRO_WANDER]`` is adapted when a long window ends.

    Does nothing before ``begin``.
    """
    if not nav[WANDER_FLOOR] > 0.0:
        return
    now = nav[TIME]
    psd = nav[WANDER_FLOOR] + nav[GYRO_WANDER]
    step = now - nav[WANDER_TIME]
    nav[WANDER_TIME] = now
    if step > _LONGEST_STEP:
        _forget_windows(nav)
    for k in range(_MARKS):
        mark = WANDER_MARKS + k * _MARK_SIZE
        if nav[mark] >= 0.0:
            nav[mark + 7] += psd * step
            if now - nav[mark] >= (_SHORT if k == 0 else _LONG):
                _close(nav, k, _ratio(nav, P, mark))
                nav[mark] = -1.0
        if nav[mark] < 0.0 and _may_open(nav, k):
            nav[mark] = now
            nav[mark + 7] = 0.0
            for i in range(3):
                nav[mark + 1 + i] = nav[GYRO_BIAS + i]
                nav[mark + 4 + i] = P[D_GYRO_BIAS + i, D_GYRO_BIAS + i]


@kernel
def overstatement(nav):
    """Factor, at most 1, by which the covariance is overstated; 1 before the first long window.

    It applies to a covariance that observations have shaped; before the first long window, the initial one still
    counts.
    """
    if not nav[WANDER_FLOOR] > 0.0 or nav[WANDER_COUNT] < 1.0:
        return 1.0
    return min(max(_BENEFIT * nav[WANDER_MEAN], _SMALLEST_FACTOR), 1.0)


@kernel
def _forget_windows(nav):
    for k in range(_MARKS):
        nav[WANDER_MARKS + k * _MARK_SIZE] = -1.0


@kernel
def _may_open(nav, k):
    """Whether window ``k`` may open: the short one at once, the long ones a third of their length apart."""
    if k == 0:
        return True
    for other in range(1, _MARKS):
        begun = nav[WANDER_MARKS + other * _MARK_SIZE]
        if other != k and begun >= 0.0 and nav[TIME] - begun < _LONG / (_MARKS - 1) - 0.01:
            return False
    return True


@kernel
def _ratio(nav, P, mark):
    """Squared change of the bias over a window relative to its expectation; negative where too little was observed."""
    moved, expected = 0.0, 0.0
    for i in range(3):
        change = nav[GYRO_BIAS + i] - nav[mark + 1 + i]
        moved += change * change
        expected += nav[mark + 7] + nav[mark + 4 + i] - P[D_GYRO_BIAS + i, D_GYRO_BIAS + i]
    return moved / expected if expected > 3.0 * _INFORMED * nav[mark + 7] else -1.0


@kernel
def _close(nav, k, ratio):
    """Update the means, and the driving noise for a long window, by the ``ratio`` of window ``k``."""
    if ratio < 0.0:
        return
    if k == 0:
        nav[WANDER_SHORT_COUNT] += 1.0
        share = 1.0 / min(nav[WANDER_SHORT_COUNT] + 3.0, _SHORT_MEMORY)
        nav[WANDER_LEVEL] += share * (min(ratio, _LARGEST_SHORT_RATIO) - nav[WANDER_LEVEL])
        return
    nav[WANDER_COUNT] += 1.0
    nav[WANDER_MEAN] += (min(ratio, _LARGEST_RATIO) - nav[WANDER_MEAN]) / min(nav[WANDER_COUNT] + 1.0, _LONG_MEMORY)
    ratio = min(ratio / max(nav[WANDER_LEVEL], 1.0), _LARGEST_RATIO)
    smallest = nav[WANDER_FLOOR]
    psd = (smallest + nav[GYRO_WANDER]) * math.exp(_GAIN * (ratio - 1.0))
    nav[GYRO_WANDER] = min(max(psd - smallest, 0.0), smallest * (LARGEST / SMALLEST - 1.0))
