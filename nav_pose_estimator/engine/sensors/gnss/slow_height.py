"""How well a height is known at least: errors of GNSS heights last for a minute, and no filter averages them away."""

from __future__ import annotations

import math

from nav_pose_estimator.core.gnss import slow_height


class SlowHeight:
    """The mean by which fixes lie above the navigator.

    White errors leave it near zero. A mean that stays says that the vertical velocity, or the accelerometer, drags the
    navigator away from heights that it takes for noisier than they are.
    """

    def __init__(self) -> None:
        self.mean = 0.0  # m
        self.last = -math.inf  # s

    def note(self, t: float, off: float) -> None:
        """A height at ``t`` [s] lies ``off`` [m] above the navigator's."""
        self.mean, self.last = slow_height.mean_after(self.mean, self.last, t, off), t

    def least_sd(self, vertical_sd: float) -> float:
        """The deviation [m] of the navigator's height while fixes with ``vertical_sd`` [m] correct it."""
        return max(slow_height.least_sd(vertical_sd), abs(self.mean))
