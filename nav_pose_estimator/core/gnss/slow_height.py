"""How well a height is known at least: errors of GNSS heights last for a minute, and no filter averages them away."""

import math

from nav_pose_estimator.core.numerics.jit import kernel

_OF_A_FIX = 0.5  # of the deviation of a height is an error that lasts
_AVERAGED = 4.0  # s over which fixes that contradict the navigator's height count together
_LONGEST_STEP = 1.0  # s that one fix may stand for


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
        self.mean, self.last = mean_after(self.mean, self.last, t, off), t

    def least_sd(self, vertical_sd: float) -> float:
        """The deviation [m] of the navigator's height while fixes with ``vertical_sd`` [m] correct it."""
        return max(lasting_sd(vertical_sd), abs(self.mean))


def lasting_sd(vertical_sd: float) -> float:
    """What of the deviation ``vertical_sd`` [m] of a height lasts [m]."""
    return _OF_A_FIX * vertical_sd


@kernel
def mean_after(mean, last, t, off):
    """Sliding ``mean`` [m] of the time ``last`` [s] after a fix at ``t`` that lies ``off`` [m] above the navigator."""
    share = min(max(t - last, 0.0), _LONGEST_STEP) / _AVERAGED
    return mean + share * (off - mean)
