"""The wind in what a prediction of the air velocity leaves unexplained.

    r = C' w + n        r: residual resolved in b, w: wind East and North, n: what the prediction does not know    (1)

The noise n differs by axis: a fixed wing's speed ahead is hard to tell from its IMU, its sideslip is next to zero. So
every axis counts by its own variance, or the axis that knows least would decide about the wind. The change of the wind
about its mean is a first-order Gauss-Markov process on each level axis.
"""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.motion.epochs import PERIOD
from nav_pose_estimator.core.numerics.jit import kernel

Array = NDArray[np.float64]
Weigh = Callable[[Array], Array]

WIND_TIME = 40.0  # s: correlation time of the wind's change
_LAG = round(10.0 / PERIOD)  # epochs: what is still alike after that is wind
_SMALLEST, _LARGEST = 0.03, 0.9  # parts of the residual's square that the wind may be
_STEADY = 0.05  # part of the spread that a second's noise is taken to be at the least
_PASSES = 2  # of the least squares: equal weights first, then those of what is left


def axis_weights(variances: Array) -> Array:
    """Weights (3,) of the body axes from their residual variances (3,), one for the best of them."""
    return np.asarray((variances.min() + 1e-6) / (variances + 1e-6))


def wind_spread(C: Array, residual: Array, weigh: Weigh = axis_weights) -> float:
    """Variance [m^2/s^2] of the wind's change on each axis, from residuals (N, 3) in b and attitudes (N, 3, 3).

    The part of the residuals that is alike ten seconds later and points the same way in n, whatever the attitude.
    """
    weights = weigh(np.square(residual).mean(axis=0))
    along = np.einsum("nij,nj->ni", C, weights * residual)[:, :2]
    by_wind = np.einsum("nij,j,nkj->nik", C, weights, C)[:, :2, :2]  # what a wind of one does to ``along``
    scale = float(np.square(by_wind).sum(axis=(1, 2)).mean())
    square = float(np.square(along).sum(axis=1).mean()) / scale
    if len(along) <= 3 * _LAG:
        return 0.3 * square
    alike = float(np.einsum("ni,ni->n", along[_LAG:], along[:-_LAG]).mean())
    expected = float(np.einsum("nij,nij->n", by_wind[_LAG:], by_wind[:-_LAG]).mean())
    return min(max(alike / expected, _SMALLEST * square), _LARGEST * square)


def mean_wind(
    C: Array, body_velocity: Array, z: Array, ridge: Array, wind_ridge: float, weigh: Weigh = axis_weights
) -> Array:
    """The wind (2,) [m/s] of ``body_velocity`` (N, 3) = z b + C' w by weighted least squares over b and w together.

    ``z`` (N, K) are the inputs of a linear law with a penalty ``ridge`` (K, K); what it can explain of the wind's
    directions is projected out, axis by axis.
    """
    directions = C[:, :2].transpose(0, 2, 1)  # (N, 3, 2): East and North resolved in b
    gram = z.T @ z + ridge
    columns = np.concatenate([directions, body_velocity[:, :, None]], axis=2)
    left = [columns[:, axis] - z @ np.linalg.solve(gram, z.T @ columns[:, axis]) for axis in range(3)]
    wind, weights = np.zeros(2), np.ones(3)
    for _ in range(_PASSES):
        normal, right = wind_ridge * len(z) * np.eye(2), np.zeros(2)
        for axis in range(3):
            normal += weights[axis] * columns[:, axis, :2].T @ left[axis][:, :2]
            right += weights[axis] * columns[:, axis, :2].T @ left[axis][:, 2]
        wind = np.linalg.solve(normal, right)
        weights = weigh(np.array([np.square(one[:, 2] - one[:, :2] @ wind).mean() for one in left]))
    return wind


def unseen(wind: Array, cov: Array, spread: float, seconds: float) -> tuple[Array, Array]:
    """Change of the wind (2,) and its covariance (2, 2) after ``seconds`` without a residual."""
    decay = math.exp(-seconds / WIND_TIME)
    return decay * wind, decay**2 * cov + (1.0 - decay**2) * spread * np.eye(2)


def mean_wind_cov(C: Array, z: Array, ridge: Array, noise: Array, unknown: float) -> Array:
    """Covariance (2, 2) [m^2/s^2] of what ``mean_wind`` finds, of variance ``unknown`` before, and of the law with it.

    ``noise`` (3,): variance of a mean over 1 s of each axis. Without turns the law explains the wind away: it is as
    uncertain as the law then, whatever the number of epochs.
    """
    gram, information = z.T @ z + ridge, np.eye(2) / unknown
    for axis in range(3):
        direction = C[:, :2, axis]
        left = direction - z @ np.linalg.solve(gram, z.T @ direction)
        information += PERIOD / noise[axis] * direction.T @ left
    return np.asarray(np.linalg.inv(information))


def track(
    C: Array, residual: Array, noise: Array, spread: float, wind: Array, cov: Array
) -> tuple[Array, Array, Array]:
    """Follow the change of the wind through residuals (N, 3) in b; ``noise`` (3,) is the variance of a mean over 1 s.

    ``wind`` (2,) and ``cov`` (2, 2) at the beginning; returns both at the end, and what was expected of the wind before
    each residual, (N, 2).
    """
    R = np.maximum(noise, _STEADY * spread) / PERIOD
    wind, cov, expected = wind.copy(), cov.copy(), np.empty((len(residual), 2))
    _track(np.ascontiguousarray(C), np.ascontiguousarray(residual), R, spread, wind, cov, expected)
    return wind, cov, expected


@kernel
def _track(C, residual, R, spread, wind, cov, expected):
    decay = math.exp(-PERIOD / WIND_TIME)
    for n in range(residual.shape[0]):
        for i in range(2):
            wind[i] *= decay
            expected[n, i] = wind[i]
            for k in range(2):
                cov[i, k] *= decay * decay
            cov[i, i] += (1.0 - decay * decay) * spread
        for axis in range(3):  # independent noise: one axis after the other
            h0, h1 = C[n, 0, axis], C[n, 1, axis]
            g0, g1 = cov[0, 0] * h0 + cov[0, 1] * h1, cov[0, 1] * h0 + cov[1, 1] * h1
            s = h0 * g0 + h1 * g1 + R[axis]
            innovation = residual[n, axis] - h0 * wind[0] - h1 * wind[1]
            wind[0] += g0 / s * innovation
            wind[1] += g1 / s * innovation
            cov[0, 0] -= g0 * g0 / s
            cov[1, 1] -= g1 * g1 / s
            cov[0, 1] -= g0 * g1 / s
            cov[1, 0] = cov[0, 1]
