"""A filter that GNSS keeps contradicting: when to doubt it, and by how much its covariance is then too small.

One refused velocity is the receiver's fault. Half of them refused, or positions several deviations off for seconds, are
the filter's: it is surer of itself than it is right, and each refusal keeps it so. Its covariance is then multiplied by
the variance of unit weight of its last innovations until they pass again (fading memory, Fagin 1964). Pure Python,
without a clock.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

_COUNT = 10  # velocities that are looked at
_REFUSED = 0.5  # share of them
_STALE = 12.0  # s: older ones say nothing
OFF = 4.0
"""Deviations of a position from which on it casts doubt."""
_OFF_TIME = 2.0  # s
_PERIOD = 1.0  # s between two widenings
_WIDENED = 4  # times in one doubt: what that does not mend is no matter of the covariance
_LARGEST_FACTOR = 9.0  # of the covariance at a time
_LINGERS = 8.0  # s
HOPELESS = 6.0
"""Seconds of doubt about velocity and position alike."""
_EASED = 0.2  # share of refusals below which the doubt ends


@dataclass(eq=False)
class Doubt:
    """Tell it what became of each velocity and how far off each position was, while GNSS aids the filter."""

    reason: str = field(default="", init=False)
    """Why the filter is in doubt, a clause; empty while it is not."""
    _velocities: tuple[tuple[float, float, float], ...] = field(default=(), init=False)  # t, refusal 0..1, NIS per row
    _off_since: float = field(default=math.inf, init=False)
    _off: float = field(default=0.0, init=False)
    _widened: float = field(default=-math.inf, init=False)
    _times: int = field(default=0, init=False)
    _both_since: float = field(default=math.inf, init=False)
    _last: tuple[float, str] = field(default=(-math.inf, ""), init=False)  # when [s] and why it was in doubt

    def lately(self, t: float) -> str:
        """``reason``, also for some seconds after it: a widened filter agrees with GNSS, right or wrong."""
        if self.reason or t - self._last[0] > _LINGERS:
            return self.reason
        return f"until {max(t - self._last[0], 0.0):.0f} s ago {self._last[1]}"

    def velocity(self, t: float, refusal: float, nis: float) -> None:
        """A velocity at ``t`` [s]: ``refusal`` 1 left out, 0.5 with more noise, 0 taken; its ``nis`` per row."""
        recent = tuple(one for one in self._velocities if t - one[0] < _STALE)
        self._velocities = (*recent, (t, refusal, nis))[-_COUNT:]

    def position(self, t: float, deviations: float) -> float:
        """A position at ``t`` [s] as far off (Mahalanobis distance); the factor that the covariance is to grow by."""
        self._off_since, self._off = (min(self._off_since, t), deviations) if deviations > OFF else (math.inf, 0.0)
        refused = self._refused()
        if refused >= _REFUSED:
            self.reason = f"it refuses {100.0 * refused:.0f} % of the GNSS velocities"
        elif t - self._off_since >= _OFF_TIME:
            self.reason = f"GNSS positions have been {deviations:.0f} sigma off for {t - self._off_since:.0f} s"
        elif refused <= _EASED and deviations <= OFF:
            self.reason, self._times, self._both_since = "", 0, math.inf
        if self.reason:
            self._last = t, self.reason
        if refused >= _REFUSED and deviations > OFF:
            self._both_since = min(self._both_since, t)
        if not self.reason or self._times >= _WIDENED or t - self._widened < _PERIOD:
            return 1.0
        self._widened, self._times = t, self._times + 1
        weight = max(self._velocity_nis(), self._off**2 / 3.0, 1.0)
        return min(weight, _LARGEST_FACTOR)

    @property
    def is_calm(self) -> bool:
        """Whether no doubt is near: positions within ``OFF`` and velocities that are taken cannot bring one about."""
        return not self.reason and sum(one[1] for one in self._velocities) < _REFUSED * _COUNT

    def agrees(self) -> None:
        """``position`` within ``OFF`` where doubt ``is_calm``: it widens nothing."""
        self._off_since, self._off = math.inf, 0.0

    @property
    def nis(self) -> float:
        """Mean per row of the last velocities; without any, that of the last position where it is far off."""
        return self._velocity_nis() if self._velocities else max(self._off**2 / 2.0, 1.0)

    def is_hopeless(self, t: float) -> bool:
        """Whether velocities and positions have contradicted the filter for so long that widening mends nothing."""
        return t - self._both_since > HOPELESS

    def _velocity_nis(self) -> float:
        """Mean per row of the last velocities; 1 without any."""
        nis = [one[2] for one in self._velocities if math.isfinite(one[2])]
        return sum(nis) / len(nis) if nis else 1.0

    def _refused(self) -> float:
        if len(self._velocities) < _COUNT:
            return 0.0
        return sum(one[1] for one in self._velocities) / _COUNT
