"""Checks of input values. The ROS boundary validates its messages, but callers from Python may not."""

import math
from collections.abc import Sequence

import numpy as np

_LARGEST = 1e12  # a larger variance is a placeholder such as 1.8e308
_TOLERANCE = -1e-9  # smallest relative eigenvalue that passes for semi-definite, because of rounding


def is_covariance(cov: np.ndarray, size: int) -> bool:
    """Whether ``cov`` is a (size, size) symmetric, positive semi-definite matrix of finite numbers."""
    if cov.shape != (size, size):
        return False
    numbers = cov.ravel().tolist()
    variances = numbers[:: size + 1]
    del numbers[:: size + 1]
    if not any(numbers) and all(0.0 <= variance <= _LARGEST for variance in variances):
        return True  # diagonal, as from most drivers
    if not np.isfinite(cov).all() or np.abs(cov).max() > _LARGEST:
        return False
    scale = float(np.abs(cov).max())
    if np.abs(cov - cov.T).max() > 1e-6 * scale:
        return False
    return scale == 0.0 or bool(np.linalg.eigvalsh(cov / scale)[0] > _TOLERANCE)


def is_position(lat: float, lon: float, alt: float) -> bool:
    """Whether latitude, longitude [rad] and height [m] are a position on or near the Earth."""
    return abs(lat) <= math.pi / 2 and abs(lon) <= 2 * math.pi and abs(alt) < 1e5  # false for NaN


def is_within(values: Sequence[float], bound: float) -> bool:
    """Whether all ``values`` are finite numbers of magnitude at most ``bound``."""
    for value in values:  # noqa: SIM110 - a generator takes three times as long
        if not abs(value) <= bound:  # true for NaN
            return False
    return True
