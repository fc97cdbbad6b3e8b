"""Quantiles of a few points: a call of numpy would cost several times as much."""

import math

import numpy as np

from nav_pose_estimator.core.numerics.jit import kernel

MAD_TO_SD = 1.4826
"""Standard deviation of a normal distribution over the median of its absolute deviations."""


@kernel
def about_median(points):
    """Medians x and y of ``points`` (N, 2), and their distances from (x, y) in increasing order (N,)."""
    count = len(points)
    xs, ys, apart = np.empty(count), np.empty(count), np.empty(count)
    for i in range(count):
        xs[i], ys[i] = points[i, 0], points[i, 1]
    _sort(xs)
    _sort(ys)
    x, y = median(xs), median(ys)
    for i in range(count):
        apart[i] = math.hypot(points[i, 0] - x, points[i, 1] - y)
    _sort(apart)
    return x, y, apart


@kernel
def median(values):
    """Median of ``values`` (N,) in increasing order."""
    return 0.5 * (values[(len(values) - 1) // 2] + values[len(values) // 2])


@kernel
def in_order(values):
    """A copy of ``values`` (N,) in increasing order."""
    ordered = values.copy()
    _sort(ordered)
    return ordered


@kernel
def _sort(values):
    """Sort ``values`` (N,) in place, by insertion."""
    for i in range(1, len(values)):
        value, k = values[i], i
        while k > 0 and values[k - 1] > value:
            values[k] = values[k - 1]
            k -= 1
        values[k] = value
