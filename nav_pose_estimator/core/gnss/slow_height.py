"""Floor of the height's standard deviation: GNSS height errors last for a minute and do not average out."""

import math

from nav_pose_estimator.core.numerics.jit import kernel

_OF_A_FIX = 0.5  # correlated part of a height's standard deviation
_AVERAGED = 4.0  # s over which innovations of the height are averaged
_LONGEST_STEP = 1.0  # s: longest interval that one fix may stand for


class SlowHeight:
    """Running mean of the height of fixes above the navigator.

    White noise leaves it near zero. A lasting mean shows that the vertical velocity or the accelerometer pulls the
    navigator away from heights whose noise it overestimates.
    """

    def __init__(self) -> None:
        self.mean = 0.0  # m
        self.last = -math.inf  # s

    def note(self, t: float, off: float) -> None:
        """Add a height at ``t`` [s] that is ``off`` [m] above the navigator's."""
        self.mean, self.last = mean_after(self.mean, self.last, t, off), t

    def least_sd(self, vertical_sd: float) -> float:
        """Floor [m] of the deviation of the navigator's height while fixes of ``vertical_sd`` [m] correct it."""
        return max(lasting_sd(vertical_sd), abs(self.mean))


def lasting_sd(vertical_sd: float) -> float:
    """Correlated part [m] of a height's standard deviation ``vertical_sd`` [m]."""
    return _OF_A_FIX * vertical_sd


@kernel
def mean_after(mean, last, t, off):
    """Running ``mean`` [m], last updated at ``last`` [s], after a fix at ``t`` [s] ``off`` [m] above the navigator."""
    share = min(max(t - last, 0.0), _LONGEST_STEP) / _AVERAGED
    return mean + share * (off - mean)
