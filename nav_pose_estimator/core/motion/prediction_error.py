"""Uncertainty of a predicted air velocity, and the error of the navigator's velocity by it (``air_velocity``)."""

import numpy as np

from nav_pose_estimator.core.motion.epochs import ATTITUDE, BODY_VELOCITY, VELOCITY
from nav_pose_estimator.core.numerics.jit import kernel

LASTING = 20.0
"""s: correlation time of the error that a wrong coefficient makes, which is not white noise."""
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

    ``air_velocity`` (3,) in b and its variances ``noise`` (3,); ``wind`` (2,) and its variance ``wind_spread``.
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
