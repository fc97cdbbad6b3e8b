"""Record of the aiding: times at which GNSS and other aids last bounded the navigator's drift."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

AID_HOLDS = 3.0
"""s for which an aid counts as bounding the drift after its last use."""
_PERIODS = 2.2  # periods of a slow receiver without a used fix after which it counts as lost


@dataclass(slots=True)
class Aiding:
    """Times are engine times of validity [s], minus infinity before the first one."""

    patience: float  # s without a used fix after which GNSS counts as lost, for a receiver of sufficient rate
    fix_period: float = 0.0  # s between the fixes of the receiver, as far as it is known
    fix_used: float = -math.inf  # time of the last fix that corrected the filter
    height_used: float = -math.inf  # time of the last fix that corrected the height
    fix_offered: float = -math.inf  # time of the last fix that passed the quality gate
    drift_bounded: float = -math.inf  # time at which an aid other than GNSS last bounded the drift
    bounded_by: dict[str, float] = field(default_factory=dict)  # the same by kind of observation

    @property
    def lost_after(self) -> float:
        """s without a used fix after which GNSS counts as lost; longer for a receiver with a low rate."""
        slow = _PERIODS * self.fix_period
        return slow if slow > self.patience else self.patience

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
        """An observation of the kind ``name`` other than GNSS has bounded the drift at ``t``."""
        self.drift_bounded = max(self.drift_bounded, t)
        self.bounded_by[name] = max(self.bounded_by.get(name, t), t)

    def holding(self, t: float) -> list[str]:
        """The kinds of observations that bound the drift at ``t``."""
        return [name for name, last in self.bounded_by.items() if t - last < AID_HOLDS]
