"""Proper scores of a stated sigma, which are best for an estimator that is both accurate and consistent.

The navigator's stated horizontal error is interpreted as an isotropic normal distribution about its own position:
``sigma``, the root of the summed variances East and North, stands for a variance of sigma^2 / 2 on each axis. Then the
error's magnitude r has the distribution function 1 - exp(-r^2 / sigma^2). All functions take arrays (N,) in metres and
return (N,).

Source: T. Gneiting and A. Raftery, "Strictly proper scoring rules, prediction, and estimation", Journal of the American
Statistical Association 102(477), 2007, sections 4.1 (logarithmic score) and 4.3 (energy score).
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

HONEST_RATIO = float(np.sqrt(np.log(2.0)))
"""Median of error / sigma of a consistent estimator: 0.83."""


def log_score(error: Array, sigma: Array) -> Array:
    """Negative logarithm of the stated density at the true position [log m^2]; smaller is better."""
    return np.log(np.pi * sigma**2) + (error / sigma) ** 2


def energy_score(error: Array, sigma: Array) -> Array:
    """E|X - y| - E|X - X'| / 2 [m] with X, X' as stated and y true; smaller is better. For sigma = 0 it is the error.

    E|X - y| is the mean of a Rice distribution, E|X - X'| that of a Rayleigh distribution.
    """
    from scipy.special import ive

    deviation = sigma / np.sqrt(2.0)
    half = 0.5 * (error / sigma) ** 2
    # Laguerre function L_1/2(-2 half) = exp(-half) ((1 + 2 half) I0(half) + 2 half I1(half)); ive holds exp(-half)
    laguerre = (1.0 + 2.0 * half) * ive(0, half) + 2.0 * half * ive(1, half)
    return deviation * np.sqrt(0.5 * np.pi) * laguerre - 0.5 * deviation * np.sqrt(np.pi)


def probability(error: Array, sigma: Array) -> Array:
    """Stated probability of an error up to the actual one; uniform on 0 to 1 for a consistent sigma."""
    return -np.expm1(-((error / sigma) ** 2))
