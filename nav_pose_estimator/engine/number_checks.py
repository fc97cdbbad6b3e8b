"""Checks of input values. The ROS boundary validates its messages, but callers from Python may not."""

import math
from collections.abc import Sequence

import numpy as np

_LARGEST = 1e12  # a larger variance is a placeholder such as 1.8e308
_INTEGER_DEGREES = 1e5  # deg: larger values are probably degrees times 1e7
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


def why_impossible(lat: float, lon: float, alt: float) -> str:
    """Why ``is_position`` is false, one clause for the user with the likely cause."""
    is_on_earth = is_position(lat, lon, 0.0)
    lat, lon = math.degrees(lat), math.degrees(lon)
    if not (math.isfinite(lat) and math.isfinite(lon)):
        return "latitude or longitude is NaN or infinite, as some drivers send it without a fix"
    if is_on_earth:
        return f"a height of {alt:.4g} m is not a place on Earth: is it in mm?"
    largest = max(abs(lat), abs(lon))
    if largest > _INTEGER_DEGREES:
        return f"a latitude or longitude of {largest:.4g} deg is not a place on Earth: is it in degrees times 1e7?"
    if abs(lat) <= 180.0 and abs(lon) <= 90.0:
        return f"a latitude of {lat:.4f} deg is not a place on Earth: are latitude and longitude exchanged?"
    nmea = max(abs(lat) % 100.0, abs(lon) % 100.0) < 60.0  # the last two digits before the point are minutes
    return f"{lat:.4f}, {lon:.4f} deg is not a place on Earth" + (": is it in NMEA's ddmm.mm?" if nmea else "")


def is_within(values: Sequence[float], bound: float) -> bool:
    """Whether all ``values`` are finite numbers of magnitude at most ``bound``."""
    for value in values:  # noqa: SIM110 - a generator takes three times as long
        if not abs(value) <= bound:  # true for NaN
            return False
    return True
