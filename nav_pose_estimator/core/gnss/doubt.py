"""Test of the filter's consistency with GNSS, and the factor by which an overconfident covariance has to grow.

A single rejected velocity is the receiver's fault. If half of the velocities are rejected, or positions differ by
several standard deviations for seconds, the filter is overconfident, and each rejection keeps it so. Its covariance is
then multiplied by the variance of unit weight of its last innovations until they pass again (fading memory, Fagin
1964). An error of the filter has the same direction in consecutive innovations; errors with changing directions are
noise of the receiver and do not count. Pure Python, without a clock.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

_COUNT = 10  # last velocities that are evaluated
_REFUSED = 0.5  # fraction of rejected ones at which a doubt begins
_STALE = 12.0  # s: older velocities are dropped
OFF = 4.0
"""Mahalanobis distance of a position above which it contributes to a doubt."""
_OFF_TIME = 2.0  # s
_OFF_COUNT = 5  # ... and fixes at least: noise has the same direction that often in one case of 81
_SAME_DIRECTION = 0.5  # cosine of the angle between two innovations
_PERIOD = 1.0  # s between two enlargements of the covariance
_MOST_ENLARGEMENTS = 4  # enlargements per doubt; if these do not help, the covariance is not the cause
_LARGEST_FACTOR = 9.0  # largest factor on the covariance at a time
_REPORTED_AFTER = 8.0  # s after its end for which a doubt is still reported
HOPELESS = 6.0
"""s of doubt about velocity and position together after which the filter has to be restarted."""
_ENDED = 0.2  # fraction of rejected velocities below which a doubt ends


@dataclass(eq=False, slots=True)
class Doubt:
    """The test. It receives the outcome of each velocity and position while GNSS aids the filter."""

    reason: str = field(default="", init=False)
    """Why the filter is in doubt, a clause; empty while it is not."""
    # t [s], refusal, NIS per row
    _velocities: deque[tuple[float, float, float]] = field(default_factory=lambda: deque(maxlen=_COUNT), init=False)
    _off_since: float = field(default=math.inf, init=False)
    _off: float = field(default=0.0, init=False)
    _off_count: int = field(default=0, init=False)
    _position_innovation: tuple[float, ...] = field(default=(), init=False)  # the last innovation of each
    _velocity_innovation: tuple[float, ...] = field(default=(), init=False)
    _last_enlargement: float = field(default=-math.inf, init=False)
    _enlargements: int = field(default=0, init=False)
    _both_since: float = field(default=math.inf, init=False)
    _last: tuple[float, str] = field(default=(-math.inf, ""), init=False)  # when [s] and why it was in doubt

    def lately(self, t: float) -> str:
        """``reason``, also for some seconds after its end: an enlarged covariance agrees with GNSS, right or wrong."""
        if self.reason or t - self._last[0] > _REPORTED_AFTER:
            return self.reason
        return f"until {max(t - self._last[0], 0.0):.0f} s ago {self._last[1]}"

    def velocity(self, t: float, refusal: float, nis: float, innovation: Sequence[float]) -> None:
        """Add a velocity at ``t`` [s]: ``refusal`` 1 rejected, 0.5 inflated, 0 used; its ``nis`` per row.

        ``innovation`` (3,) or (2,) [m/s] gives the direction of its error.
        """
        before, self._velocity_innovation = self._velocity_innovation, tuple(innovation)
        recent = self._velocities
        while recent and t - recent[0][0] >= _STALE:
            recent.popleft()
        counted = refusal if refusal and _is_same_direction(before, innovation) else 0.0
        recent.append((t, counted, nis))

    def position(self, t: float, deviations: float, innovation: Sequence[float]) -> float:
        """Add a position at ``t`` [s] with Mahalanobis distance ``deviations`` and horizontal ``innovation`` (2,) [m].

        Returns the factor by which the covariance has to be multiplied.
        """
        self._note_off(t, deviations, innovation)
        refused = self._refused()
        if refused >= _REFUSED:
            self.reason = f"it refuses {100.0 * refused:.0f} % of the GNSS velocities"
        elif t - self._off_since >= _OFF_TIME and self._off_count >= _OFF_COUNT:
            self.reason = f"GNSS positions have been {deviations:.0f} sigma off for {t - self._off_since:.0f} s"
        elif refused <= _ENDED and deviations <= OFF:
            self.reason, self._enlargements, self._both_since = "", 0, math.inf
        if self.reason:
            self._last = t, self.reason
        if refused >= _REFUSED and deviations > OFF:
            self._both_since = min(self._both_since, t)
        if not self.reason or self._enlargements >= _MOST_ENLARGEMENTS or t - self._last_enlargement < _PERIOD:
            return 1.0
        self._last_enlargement, self._enlargements = t, self._enlargements + 1
        weight = max(self._velocity_nis(), self._off**2 / 3.0, 1.0)
        return min(weight, _LARGEST_FACTOR)

    @property
    def is_calm(self) -> bool:
        """Whether no doubt is near: positions within ``OFF`` and velocities that are taken cannot bring one about."""
        return not self.reason and sum([one[1] for one in self._velocities]) < _REFUSED * _COUNT

    def agrees(self) -> None:
        """Same as ``position`` for a distance within ``OFF`` while ``is_calm``: no factor."""
        self._off_since, self._off, self._off_count = math.inf, 0.0, 0

    @property
    def nis(self) -> float:
        """Mean NIS per row of the last velocities; without any, that of the last position where it is large."""
        return self._velocity_nis() if self._velocities else max(self._off**2 / 2.0, 1.0)

    def largest_nis(self, since: float) -> float:
        """Largest NIS per row of the velocities after ``since`` [s]; infinite without any."""
        return max([one[2] for one in self._velocities if one[0] > since], default=math.inf)

    def is_hopeless(self, t: float) -> bool:
        """Whether velocities and positions have contradicted the filter for so long that it has to restart."""
        return t - self._both_since > HOPELESS

    def _note_off(self, t: float, deviations: float, innovation: Sequence[float]) -> None:
        """Update the time since which positions have been off in the same direction."""
        before, self._position_innovation = self._position_innovation, tuple(innovation)
        if deviations <= OFF:
            self.agrees()
            return
        if not _is_same_direction(before, innovation):
            self._off_since, self._off_count, self._both_since = t, 0, math.inf
        self._off_since, self._off = min(self._off_since, t), deviations
        self._off_count += 1

    def _velocity_nis(self) -> float:
        """Mean NIS per row of the last velocities; 1 without any."""
        nis = [one[2] for one in self._velocities if math.isfinite(one[2])]
        return sum(nis) / len(nis) if nis else 1.0

    def _refused(self) -> float:
        if len(self._velocities) < _COUNT:
            return 0.0
        return sum(one[1] for one in self._velocities) / _COUNT


def _is_same_direction(before: Sequence[float], now: Sequence[float]) -> bool:
    """Whether two innovations have the same direction; True without an earlier one."""
    if not before or len(before) != len(now):
        return True
    along = sum([a * b for a, b in zip(before, now, strict=True)])
    return along > _SAME_DIRECTION * math.hypot(*before) * math.hypot(*now)
