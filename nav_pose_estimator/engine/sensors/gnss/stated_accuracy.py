"""Monitors of the accuracy that a receiver states, with events where it is optimistic."""

from __future__ import annotations

import math

import numpy as np

from nav_pose_estimator.core.filter.measurement_noise import NoiseModel
from nav_pose_estimator.core.numerics.jit import kernel
from nav_pose_estimator.core.numerics.order import about_median, in_order
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.observation import Observation
from nav_pose_estimator.engine.solutions import Level

_TOO_LARGE, _FINE = 9.0, 4.0  # variance factors (3 and 2 times the deviation) at which optimism begins and ends
_LASTS = 10.0  # s for which the factor must be too large
_COUNT, _ENOUGH = 25, 8  # differences of which a quantile is taken, and the least number of them
_QUANTILE = 0.25  # that quantile, which is robust even where every third fix is an outlier
_RAYLEIGH = math.sqrt(-2.0 * math.log(1.0 - _QUANTILE)) * math.sqrt(
    2.0
)  # ratio of that quantile to the deviation of one axis
_NORMAL = math.sqrt(6.0) * 0.6745  # median of a second difference of heights over their deviation
_ON, _OFF = 2.5, 1.2  # smallest deviation, relative to the stated one, with which the noise counts; it ends below _OFF
_LEAST, _LEAST_RATE = 0.3, 1.5  # m, m/s
"""Floors of the stated deviation, the second per interval of fixes: velocities are late, and their integral errs."""
_SLOWEST = 0.3  # s: longest interval of fixes at which the vertical acceleration does not matter
_PAUSE = 1.5  # s: longest interval of fixes in a difference
_EVEN = 1.5  # largest ratio of two intervals in a second difference
_LASTING = 3.0  # ratio of such noise to its part that does not average out

# --- the state of a ``Scatter``: index of each quantity, with its size if that is not 1 ------------------------------
_T, _PLACE = 0, 1  # s, (3) m: last fix; its East and North minus the integral of the velocities, and its height
_BEFORE, _HEIGHT_BEFORE = 4, 5  # s, m: interval and height of the fix before it
_FIXES = 6  # fixes without a pause, at most two
_STEPS, _SECOND_DIFFERENCES = 7, 8  # numbers of differences so far
_SIZE = 9


class StatedAccuracy:
    """Monitors the factor that a noise model has estimated on the variance of ``what``."""

    def __init__(self, what: str) -> None:
        self._what = what
        self._since = math.inf  # s: from when on it has been too large
        self._optimistic = False

    def lasting(self, o: Observation, stated: np.ndarray, noise: NoiseModel, journal: Journal) -> np.ndarray:
        """R for the tests of ``o``: ``stated``, or that of ``noise`` where the receiver has been optimistic for long.

        In a short burst of errors it is better to reject fixes than to enlarge their noise.
        """
        self._update(o, noise.factor, journal)
        return noise.expected(stated) if self._optimistic else stated

    def _update(self, o: Observation, factor: float, journal: Journal) -> None:
        """Process the ``factor`` before ``o``; a lasting change gives one event."""
        if factor <= (_FINE if self._optimistic else _TOO_LARGE):
            self._since = math.inf
            if self._optimistic:
                text = f"GNSS {self._what}: errors are about as large as the receiver states again"
                journal.say(o.stamp_ns, "gnss.noise.agrees", Level.INFO, text)
            self._optimistic = False
            return
        self._since = min(self._since, o.t)
        if not self._optimistic and o.t - self._since >= _LASTS:
            self._optimistic = True
            times = math.sqrt(factor)
            text = f"GNSS {self._what}: errors are {times:.1f} times as large as the receiver states"
            journal.say(o.stamp_ns, "gnss.noise.optimistic", Level.WARN, text, factor=factor)


class Scatter:
    """Noise of positions from fix to fix that is not stated, as of reflections or a poor antenna.

    The difference of two positions minus that of the integrated velocities is free of motion, and its median is the
    drift. The lower quartile of what remains gives the deviation of the white noise: 0.4 m at most in sixteen recorded
    flights.
    ``sd`` (horizontal, vertical) [m]: deviations of the noise on each axis, zero unless established.
    """

    def __init__(self, journal: Journal) -> None:
        self._journal = journal
        self.sd = (0.0, 0.0)
        self._state = np.zeros(_SIZE)
        self._steps = np.empty((_COUNT, 2))  # m; the oldest one is replaced, here and below
        self._second_differences = np.empty(_COUNT)  # m, of heights

    @property
    def is_on(self) -> bool:
        """Whether the noise is larger than stated."""
        return self.sd[0] > 0.0

    @property
    def least_sd(self) -> tuple[float, float]:
        """Floors of the standard deviations of the position [m], horizontal and vertical."""
        return self.sd[0] / _LASTING, self.sd[1] / _LASTING

    @property
    def reason(self) -> str:
        """Why the position is less certain than usual, one clause for the user; empty where it is not."""
        return f"GNSS positions scatter by {self.sd[0]:.1f} m from fix to fix, more than stated" if self.is_on else ""

    def fix(self, t: float, place: complex, height: float, stated: float, stamp_ns: int) -> None:
        """Add a fix valid at ``t`` [s].

        ``place`` [m]: position minus integrated velocity, East + i North; ``height`` [m], NaN without; ``stated`` [m]:
        horizontal deviation of a fix.
        """
        was_on = self.is_on
        self.sd = _take(
            self._state, (self._steps, self._second_differences), t, (place.real, place.imag, height), stated, self.sd
        )
        if self.is_on and not was_on:
            text = f"{self.reason}; they are used with that noise"
            self._journal.say(stamp_ns, "gnss.scatters", Level.WARN, text, sd=self.sd[0])
        elif was_on and not self.is_on:
            self._journal.say(stamp_ns, "gnss.scatters.ended", Level.INFO, "GNSS positions scatter as stated again")


class VelocityScatter:
    """Noise of velocities from one to the next that is not stated, as where a driver derives them from positions.

    The navigator's velocity minus the receiver's, before an update, differs from that after the update before it by
    what the IMU has measured meanwhile minus the change of the receiver's velocity: free of motion, except for a
    steady part due to the attitude error. The deviation is 0.05 to 1.0 m/s in thirteen recorded flights, at most 1.6
    times the stated one.
    ``sd`` [m/s]: deviation of the noise on each horizontal axis, zero unless established.
    """

    def __init__(self, journal: Journal) -> None:
        self._journal = journal
        self.sd = 0.0
        self._changes, self._count = np.empty((_COUNT, 2)), 0  # m/s: East, North; the oldest one is replaced
        self._stated = math.nan  # m/s, of the last velocity

    @property
    def is_on(self) -> bool:
        """Whether the noise is larger than stated."""
        return self.sd > 0.0

    @property
    def reason(self) -> str:
        """Why the velocity is less certain than usual, one clause for the user; empty where it is not."""
        return f"GNSS velocities scatter by {self.sd:.1f} m/s, more than stated" if self.is_on else ""

    def change(self, seconds: float, east: float, north: float, stated: float) -> None:
        """Add the change of the misfit [m/s] over ``seconds``; ``stated`` [m/s]: deviation of a velocity."""
        if not 0.0 < seconds <= _PAUSE:
            self._count = 0
            return
        self._changes[self._count % _COUNT] = east, north
        self._count += 1
        self._stated = stated

    def second(self, stamp_ns: int) -> None:
        """Conclude, once a second."""
        was_on = self.is_on
        if self._count < (_COUNT if was_on else _ENOUGH):
            return
        self.sd = float(excessive_sd(self._changes[: self._count], self._stated, was_on))
        if self.is_on and not was_on:
            text = f"{self.reason}; they are used with that noise"
            self._journal.say(stamp_ns, "gnss.velocity.scatters", Level.WARN, text, sd=self.sd)
        elif was_on and not self.is_on:
            text = "GNSS velocities scatter as stated again"
            self._journal.say(stamp_ns, "gnss.velocity.scatters.ended", Level.INFO, text)


@kernel
def _take(state, recent, t, place, stated, sd):
    """``Scatter.fix`` with a ``place`` of three numbers; returns the new ``sd``.

    ``recent``: steps (N, 2) and second differences of heights (N,).
    """
    seconds = t - state[_T]
    if state[_FIXES] > 0.0 and seconds <= 0.0:
        return sd
    if state[_FIXES] > 0.0 and seconds > _PAUSE:
        state[_FIXES] = state[_STEPS] = 0.0
    if state[_FIXES] > 0.0:
        stated = max(stated, _LEAST, _LEAST_RATE * seconds)
        _add_differences(state, recent[0], recent[1], seconds, place)
    state[_BEFORE], state[_HEIGHT_BEFORE] = seconds, state[_PLACE + 2]
    state[_T], state[_FIXES] = t, min(state[_FIXES] + 1.0, 2.0)
    for axis in range(3):
        state[_PLACE + axis] = place[axis]
    return _weighed(state, recent[0], recent[1], stated, sd)


@kernel
def _add_differences(state, steps, second_differences, seconds, place):
    """Add the step from the last fix and, of three fixes at equal intervals, the second difference of heights."""
    row = int(state[_STEPS]) % _COUNT
    steps[row, 0], steps[row, 1] = place[0] - state[_PLACE], place[1] - state[_PLACE + 1]
    state[_STEPS] += 1.0
    if state[_FIXES] < 2.0:
        return
    before, second_difference = state[_BEFORE], abs(place[2] - 2.0 * state[_PLACE + 2] + state[_HEIGHT_BEFORE])
    if max(before, seconds) < min(_EVEN * min(before, seconds), _SLOWEST) and math.isfinite(second_difference):
        second_differences[int(state[_SECOND_DIFFERENCES]) % _COUNT] = second_difference
        state[_SECOND_DIFFERENCES] += 1.0


@kernel
def _weighed(state, steps, second_differences, stated, sd):
    """The new ``sd``, for a deviation ``stated`` [m]."""
    count, second_count = min(int(state[_STEPS]), _COUNT), min(int(state[_SECOND_DIFFERENCES]), _COUNT)
    if count < _ENOUGH:
        return sd
    horizontal = excessive_sd(steps[:count], stated, sd[0] > 0.0)
    if horizontal == 0.0:
        return 0.0, 0.0
    return horizontal, (
        in_order(second_differences[:second_count])[second_count // 2] / _NORMAL if second_count > 0 else horizontal
    )


@kernel
def excessive_sd(steps, stated, was_on):
    """Deviation of the noise on each axis of measurements that differ by ``steps`` (N, 2) and a steady drift.

    0.0 where it is not clearly larger than ``stated``; ``was_on``: it has been before.
    """
    _, _, apart = about_median(steps)
    sd = apart[int(_QUANTILE * len(steps))] / _RAYLEIGH
    # few differences may be large by chance
    limit = _OFF if was_on else _ON * math.sqrt(_COUNT / len(steps))
    return sd if sd >= limit * stated else 0.0
