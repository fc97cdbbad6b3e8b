"""When something last bounded the navigator's drift: what sensors, modes and start-up must know of each other."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass
class Aiding:
    """Engine times [s] of validity, minus infinity before the first time."""

    lost_after: float  # s without a used fix after which GNSS counts as lost
    fix_used: float = -math.inf  # the last fix that corrected the filter
    fix_offered: float = -math.inf  # ... that was good enough to be considered
    drift_bounded: float = -math.inf  # by something other than GNSS

    def gnss_is_good(self, t: float) -> bool:
        """Whether a fix has been used within ``lost_after`` before ``t``."""
        return t - self.fix_used <= self.lost_after

    def use_fix(self, t: float) -> None:
        """A fix valid at ``t`` has corrected the filter."""
        self.fix_used = max(self.fix_used, t)

    def bound_drift(self, t: float) -> None:
        """Something other than GNSS has bounded the drift at ``t``."""
        self.drift_bounded = max(self.drift_bounded, t)
