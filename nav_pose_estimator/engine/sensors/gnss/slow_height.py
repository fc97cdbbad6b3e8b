"""How well a height is known at least: errors of GNSS heights last for a minute, and no filter averages them away."""

from __future__ import annotations

import math

_OF_A_FIX = 0.5  # of the deviation of a height is an error that lasts
_AVERAGED = 4.0  # s over which fixes that contradict the navigator's height count together
_LONGEST_STEP = 1.0  # s that one fix may stand for


class SlowHeight:
    """The mean by which fixes lie above the navigator.

    White errors leave it near zero. A mean that stays says that the vertical velocity, or the accelerometer, drags the
    navigator away from heights that it takes for noisier than they are.
    """

    def __init__(self) -> None:
        self._mean = 0.0  # m
        self._last = -math.inf  # s

    def note(self, t: float, off: float) -> None:
        """A height at ``t`` [s] lies ``off`` [m] above the navigator's."""
        share = min(max(t - self._last, 0.0), _LONGEST_STEP) / _AVERAGED
        self._mean, self._last = self._mean + share * (off - self._mean), t

    def least_sd(self, vertical_sd: float) -> float:
        """The deviation [m] of the navigator's height while fixes with ``vertical_sd`` [m] correct it."""
        return max(_OF_A_FIX * vertical_sd, abs(self._mean))
