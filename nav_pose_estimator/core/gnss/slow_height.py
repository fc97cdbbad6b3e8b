"""Errors of GNSS heights that last for a minute: the numbers behind ``engine.sensors.gnss.slow_height``."""

from nav_pose_estimator.core.numerics.jit import kernel

_OF_A_FIX = 0.5  # of the deviation of a height is an error that lasts
_AVERAGED = 4.0  # s over which fixes that contradict the navigator's height count together
_LONGEST_STEP = 1.0  # s that one fix may stand for


def least_sd(vertical_sd: float) -> float:
    """The least deviation [m] of the navigator's height while fixes with ``vertical_sd`` [m] correct it."""
    return _OF_A_FIX * vertical_sd


@kernel
def mean_after(mean, last, t, off):
    """Sliding ``mean`` [m] of the time ``last`` [s] after a fix at ``t`` that lies ``off`` [m] above the navigator."""
    share = min(max(t - last, 0.0), _LONGEST_STEP) / _AVERAGED
    return mean + share * (off - mean)
