"""When something last bounded the navigator's drift: what sensors, modes and start-up must know of each other."""

from __future__ import annotations

import math
from dataclasses import dataclass

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

    @property
    def lost_after(self) -> float:
        """Seconds without a used fix after which GNSS counts as lost: a slow receiver is not lost between its fixes."""
        return max(self.patience, _PERIODS * self.fix_period)

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

    def bound_drift(self, t: float) -> None:
        """Something other than GNSS has bounded the drift at ``t``."""
        self.drift_bounded = max(self.drift_bounded, t)
