"""Random processes of the simulation, and independent random generators by name."""

from zlib import crc32

import numpy as np
from scipy.signal import lfilter


def stream(seed: int, name: str) -> np.random.Generator:
    """Random generator that depends only on ``seed`` and ``name``, so that a new sensor does not affect the others."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(crc32(name.encode()),)))


def gauss_markov(
    rng: np.random.Generator, count: int, dt: float, sd: float | np.ndarray, tau: float, axes: int = 3
) -> np.ndarray:
    """Stationary first-order Gauss-Markov process (count, axes), standard deviation ``sd``, time constant ``tau`` [s].

    Its autocorrelation is sd^2 exp(-|t| / tau) for any step ``dt`` [s] (Gelb, Applied Optimal Estimation, chapter 3).
    """
    white = rng.standard_normal((count, axes))
    decay = np.exp(-dt / tau)
    white[1:] *= np.sqrt(-np.expm1(-2.0 * dt / tau))
    return lfilter([1.0], [1.0, -decay], white, axis=0) * sd


def random_walk(rng: np.random.Generator, count: int, dt: float, density: float, axes: int = 3) -> np.ndarray:
    """Random walk (count, axes) from zero; ``density`` in units per square root of a second."""
    steps = rng.standard_normal((count, axes)) * (density * np.sqrt(dt))
    steps[:1] = 0.0
    return np.cumsum(steps, axis=0)


def white_noise(rng: np.random.Generator, count: int, dt: float, density: float, axes: int = 3) -> np.ndarray:
    """Means (count, axes) of white noise over intervals of ``dt`` [s].

    ``density`` in units per square root of a hertz: the integral over a time t has the variance density^2 t.
    """
    return rng.standard_normal((count, axes)) * (density / np.sqrt(dt))
