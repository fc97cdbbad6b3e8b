"""When something last bounded the navigator's drift: what sensors, modes and start-up must know of each other."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

AID_HOLDS = 3.0  # s: how long an aid counts as bounding the drift
_PERIODS = 2.2  # of a slow receiver pass before it counts as lost


@dataclass
class Aiding:
    """Engine times [s] of validity, minus infinity before the first time."""

    patience: float  # s without a used fix after which GNSS counts as lost, of a receiver that is quick enough
    fix_period: float = 0.0  # s between the fixes of the receiver, as far as it is known
    fix_used: float = -math.inf  # the last fix that corrected the filter
    height_used: float = -math.inf  # the last fix that corrected the height
    fix_offered: float = -math.inf  # ... that was good enough to be considered
    drift_bounded: float = -math.inf  # by something other than GNSS
    bounded_by: dict[str, float] = field(default_factory=dict)  # by whom, and when last

    @property
    def lost_after(self) -> float:
        """Seconds without a used fix after which GNSS counts as lost: a slow receiver is not lost between its fixes."""
        return max(self.patience, _PERIODS * self.fix_period)

    def is_quick(self, period: float) -> bool:
        """Whether ``lost_after`` of a receiver that fixes every ``period`` [s] is ``patience``."""
        return _PERIODS * period <= self.patience

    def gnss_is_good(self, t: float) -> bool:
        """Whether a fix has been used within ``lost_after`` before ``t``."""
        return t - self.fix_used <= self.lost_after

    def height_is_good(self, t: float) -> bool:
        """Whether a fix has corrected the height within ``lost_after`` before ``t``."""
        return t - self.height_used <= self.lost_after

    def use_fix(self, t: float, with_height: bool = True) -> None:
        """A fix valid at ``t`` has corrected the filter."""
        self.fix_used = max(self.fix_used, t)
        if with_height:
            self.height_used = max(self.height_used, t)

    def bound_drift(self, t: float, name: str) -> None:
        """Observations of the kind ``name``, which are not GNSS's, have bounded the drift at ``t``."""
        self.drift_bounded = max(self.drift_bounded, t)
        self.bounded_by[name] = max(self.bounded_by.get(name, t), t)

    def holding(self, t: float) -> list[str]:
        """The kinds of observations that keep the drift within bounds at ``t``."""
        return [name for name, last in self.bounded_by.items() if t - last < AID_HOLDS]
