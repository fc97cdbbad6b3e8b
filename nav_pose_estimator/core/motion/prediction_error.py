"""Uncertainty of the air velocity that a model predicts (``air_velocity``), and the navigator's velocity beside it."""

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.motion.epochs import ATTITUDE, BODY_VELOCITY, PERIOD, VELOCITY
from nav_pose_estimator.core.motion.usual import SLOW
from nav_pose_estimator.core.numerics.jit import kernel

LASTING = 20.0
"""s: correlation time of the error that a wrong coefficient makes, which is not white noise."""
_MEMORY = 8.0  # s: longest lag at which residuals count as correlated
_UNSEEN_HOVER = 10.0  # s of hovering: weight of the guessed noise in a hover
_STRANGE = 10.0  # factor on the noise of a prediction far from the training data


@kernel
def doubt(novelty, x, cov):
    """Factor (N,) on the noise at inputs ``x`` (N, n): for extrapolation, and for poorly determined coefficients.

    ``novelty`` (N,) as ``Anfis.novelty``; ``cov`` (n + 1, n + 1): covariance of a linear law's coefficients of (x, 1).
    """
    factor, n = np.empty(len(x)), x.shape[1]
    for row in range(len(x)):
        variance = cov[n, n]
        for i in range(n):
            variance += x[row, i] * (cov[i, n] + cov[n, i])
            for j in range(n):
                variance += x[row, i] * cov[i, j] * x[row, j]
        strange = 1.0 + (_STRANGE - 1.0) * min(max(novelty[row] - 1.0, 0.0), 1.0)
        factor[row] = strange * (1.0 + LASTING * variance)
    return factor


@kernel
def velocity_error(epoch, air_velocity, noise, wind, wind_spread):
    """Velocity of an ``epoch`` (COLUMNS or more,) minus the predicted one, (3,) in n [m/s], and its covariance (3, 3).

    ``air_velocity`` (3,) in b [m/s] and its variances ``noise`` (3,) [m^2/s^2]; ``wind`` (2,) [m/s], East and North,
    and the variance ``wind_spread`` [m^2/s^2] of each component.
    """
    C = epoch[ATTITUDE:BODY_VELOCITY].copy().reshape(3, 3)
    error, cov = np.empty(3), np.zeros((3, 3))
    for i in range(3):
        error[i] = epoch[VELOCITY + i]
        for k in range(3):
            error[i] -= C[i, k] * air_velocity[k]
            for j in range(3):
                cov[i, j] += C[i, k] * noise[k] * C[j, k]
    for i in range(2):
        error[i] -= wind[i]
        cov[i, i] += wind_spread
    return error, cov


def low_frequency_density(residual: NDArray[np.float64]) -> NDArray[np.float64]:
    """Variance (3,) [m^2/s^2] of a one-second mean of white noise with the low-frequency density of ``residual``.

    ``residual`` (N, 3) [m/s]: one for each epoch, body axes. Bartlett's estimate of the spectral density at zero; at
    least the density of independent residuals.
    """
    count = len(residual)
    lags = min(round(_MEMORY / PERIOD), count // 4)
    square = np.square(residual).mean(axis=0)
    total = square.copy()
    for lag in range(1, lags + 1):
        total += 2.0 * (1.0 - lag / (lags + 1)) * (residual[lag:] * residual[:-lag]).mean(axis=0)
    return np.maximum(total, square) * PERIOD


def hover_noise(epochs: NDArray[np.float64], unseen: NDArray[np.float64]) -> NDArray[np.float64]:
    """Variance (3,) [m^2/s^2] of the residuals in a hover, shrunk towards a guess that holds without hovering.

    ``unseen`` (N, 3) [m/s]: residuals of ``epochs`` (N, COLUMNS) by cross-validation, body axes.
    """
    square = np.square(epochs[:, VELOCITY : VELOCITY + 2]).sum(axis=1)
    hovers = square < SLOW**2
    seconds = float(hovers.sum()) * PERIOD
    known = 2.0 * np.square(unseen[hovers]).mean(axis=0) if hovers.any() else np.zeros(3)
    guess = 1.0 + 0.5 * float(square[~hovers].mean()) if not hovers.all() else 1.0
    return (_UNSEEN_HOVER * guess + seconds * known) / (_UNSEEN_HOVER + seconds)
