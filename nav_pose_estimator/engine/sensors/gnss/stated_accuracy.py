"""Monitors of the accuracy that a receiver states, with events where it is optimistic."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from nav_pose_estimator.core.filter.measurement_noise import NoiseModel
from nav_pose_estimator.core.numerics.jit import kernel
from nav_pose_estimator.core.numerics.order import about_median
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.observation import Observation
from nav_pose_estimator.engine.solutions import Level

_TOO_LARGE, _FINE = 9.0, 4.0  # variance factors (3 and 2 times the deviation) at which optimism begins and ends
_LASTS = 10.0  # s for which the factor must be too large
_COUNT, _ENOUGH = 25, 8  # differences of which a quantile is taken, and the least number of them
_QUIET = 0.25  # that quantile: where every third fix is an outlier, it is of the sound ones
_RAYLEIGH = math.sqrt(-2.0 * math.log(1.0 - _QUIET)) * math.sqrt(2.0)  # it over the deviation of one axis
_NORMAL = math.sqrt(6.0) * 0.6745  # median of a second difference of heights over their deviation
_ON, _OFF = 2.5, 1.2  # smallest deviation, relative to the stated one, with which the noise counts; it ends below _OFF
_LEAST, _LEAST_RATE = 0.3, 1.5  # m, m/s
"""Floors of the stated deviation, the second per interval of fixes: velocities are late, and their integral errs."""
_SLOWEST = 0.3  # s: longest interval of fixes at which the vertical acceleration does not matter
_PAUSE = 1.5  # s: longest interval of fixes in a difference
_EVEN = 1.5  # largest ratio of two intervals in a second difference
_LASTING = 3.0  # part of such noise that does not average out: one over this


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

    The difference of two positions less that of the integrated velocities is free of motion, and its median is their
    drift. The lower quartile of what remains gives the deviation of the white noise: 0.4 m at most in sixteen recorded
    flights.
    ``sd`` (horizontal, vertical) [m]: deviations of the noise on each axis, zero unless established.
    """

    def __init__(self, journal: Journal) -> None:
        self._journal = journal
        self.sd = (0.0, 0.0)
        self._last: list[tuple[float, complex, float]] = []  # s, m, m: the last two fixes
        self._steps, self._count = np.empty((_COUNT, 2)), 0  # m: East, North; the oldest one is replaced
        self._vertical: deque[float] = deque(maxlen=_COUNT)

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

        ``place`` [m]: position less integrated velocity, East + i North; ``height`` [m], NaN without; ``stated`` [m]:
        horizontal deviation of a fix.
        """
        if self._last and t <= self._last[-1][0]:
            return
        if self._last and t > self._last[-1][0] + _PAUSE:
            self._last.clear()
            self._count = 0
        if self._last:
            step = place - self._last[-1][1]
            stated = max(stated, _LEAST, _LEAST_RATE * (t - self._last[-1][0]))
            self._steps[self._count % _COUNT] = step.real, step.imag
            self._count += 1
        if len(self._last) == 2:
            (t0, _, low), (t1, _, middle) = self._last
            before, now, bend = t1 - t0, t - t1, abs(height - 2.0 * middle + low)
            if max(before, now) < min(_EVEN * min(before, now), _SLOWEST) and math.isfinite(bend):
                self._vertical.append(bend)
        self._last = [*self._last[-1:], (t, place, height)]
        self._weigh(stated, stamp_ns)

    def _weigh(self, stated: float, stamp_ns: int) -> None:
        if self._count < _ENOUGH:
            return
        steps, was_on = self._steps[: self._count], self.is_on
        horizontal = float(scatter_sd(steps))
        # few differences may be large by chance
        limit = _OFF if was_on else _ON * math.sqrt(_COUNT / len(steps))
        if horizontal < limit * stated:
            self.sd = (0.0, 0.0)
        else:
            vertical = sorted(self._vertical)[len(self._vertical) // 2] / _NORMAL if self._vertical else horizontal
            self.sd = horizontal, vertical
        if self.is_on and not was_on:
            text = f"{self.reason}; they are used with that noise"
            self._journal.say(stamp_ns, "gnss.scatters", Level.WARN, text, sd=horizontal)
        elif was_on and not self.is_on:
            self._journal.say(stamp_ns, "gnss.scatters.ended", Level.INFO, "GNSS positions scatter as stated again")


class VelocityScatter:
    """Noise of velocities from one to the next that is not stated, as where a driver derives them from positions.

    The navigator's velocity minus the receiver's, before an update, differs from that after the update before it by
    what the IMU has measured meanwhile less the change of the receiver's velocity: free of motion, but for a steady
    part due to the attitude. The deviation is 0.05 to 1.0 m/s in thirteen recorded flights, at most 1.6 times the
    stated one.
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
        changes = self._changes[: self._count]
        sd = float(scatter_sd(changes))
        # few differences may be large by chance
        limit = _OFF if was_on else _ON * math.sqrt(_COUNT / len(changes))
        self.sd = sd if sd >= limit * self._stated else 0.0
        if self.is_on and not was_on:
            text = f"GNSS velocities scatter by {sd:.1f} m/s, more than stated; they are used with that noise"
            self._journal.say(stamp_ns, "gnss.velocity.scatters", Level.WARN, text, sd=sd)
        elif was_on and not self.is_on:
            text = "GNSS velocities scatter as stated again"
            self._journal.say(stamp_ns, "gnss.velocity.scatters.ended", Level.INFO, text)


@kernel
def scatter_sd(steps):
    """Deviation of the noise on each axis of measurements that differ by ``steps`` (N, 2) and a steady drift."""
    _, _, apart = about_median(steps)
    return apart[int(_QUIET * len(steps))] / _RAYLEIGH
