"""Sorting of the few numbers of which a check takes a quantile: a call of numpy would cost several times as much."""

from nav_pose_estimator.core.numerics.jit import kernel


@kernel
def sort(values):
    """Sort ``values`` (N,) in place, by insertion."""
    for i in range(1, len(values)):
        value, k = values[i], i
        while k > 0 and values[k - 1] > value:
            values[k] = values[k - 1]
            k -= 1
        values[k] = value
