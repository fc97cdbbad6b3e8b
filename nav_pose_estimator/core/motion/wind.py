"""Estimation of the wind from the residuals of a predicted air velocity.

    r = C' w + n        r: residual resolved in b, w: wind East and North, n: noise of the prediction             (1)

The noise n differs by axis: the IMU of a fixed wing determines its forward speed poorly, but its sideslip is next to
zero. So each body axis is weighted by its own variance; otherwise the noisiest one would dominate. The change of the
wind about its mean is a first-order Gauss-Markov process on each level axis.
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
_LAG = round(10.0 / PERIOD)  # epochs: residuals that are still correlated after this lag are wind
_SMALLEST, _LARGEST = 0.03, 0.9  # bounds of the wind's variance as a fraction of the residual's mean square
_FEW = 0.3  # that fraction where a flight is too short to show it
_STEADY = 0.05  # least noise variance of a one-second mean as a fraction of the wind's variance
_PASSES = 2  # of the least squares: with equal weights first, then with those of the residuals


def axis_weights(variances: Array) -> Array:
    """Weights (3,) of the body axes, inversely proportional to their residual ``variances`` (3,); at most one."""
    return np.asarray((variances.min() + 1e-6) / (variances + 1e-6))


def wind_spread(C: Array, residual: Array, weigh: Weigh = axis_weights) -> float:
    """Variance [m^2/s^2] of the wind's change on each axis, from residuals (N, 3) in b and attitudes C (N, 3, 3).

    It is the covariance of the residuals, resolved in n, with those ten seconds later.
    """
    weights = weigh(np.square(residual).mean(axis=0))
    along = np.einsum("nij,nj->ni", C, weights * residual)[:, :2]
    by_wind = np.einsum("nij,j,nkj->nik", C, weights, C)[:, :2, :2]  # response of ``along`` to unit wind
    scale = float(np.square(by_wind).sum(axis=(1, 2)).mean())
    square = float(np.square(along).sum(axis=1).mean()) / scale
    if len(along) <= 3 * _LAG:
        return _FEW * square
    alike = float(np.einsum("ni,ni->n", along[_LAG:], along[:-_LAG]).mean())
    expected = float(np.einsum("nij,nij->n", by_wind[_LAG:], by_wind[:-_LAG]).mean())
    return min(max(alike / expected, _SMALLEST * square), _LARGEST * square)


def mean_wind(
    C: Array, body_velocity: Array, z: Array, ridge: Array, wind_ridge: float, weigh: Weigh = axis_weights
) -> Array:
    """Mean wind w (2,) [m/s] of ``body_velocity`` (N, 3) = z b + C' w by weighted least squares over b and w jointly.

    ``z`` (N, K): inputs of the linear law, whose penalty is ``ridge`` (K, K). The law is eliminated axis by axis: the
    part of the wind's directions that its inputs explain is projected out.
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
    """Predict the change of the wind (2,) and its covariance (2, 2) over ``seconds`` without an observation."""
    decay = math.exp(-seconds / WIND_TIME)
    return decay * wind, decay**2 * cov + (1.0 - decay**2) * spread * np.eye(2)


def mean_wind_cov(C: Array, z: Array, ridge: Array, noise: Array, unknown: float) -> Array:
    """Covariance (2, 2) [m^2/s^2] of the estimate of ``mean_wind``, whose prior variance is ``unknown``.

    ``noise`` (3,): variance of a one-second mean of each axis. Without turns the wind is not observable beside the
    coefficients of the law: it is then as uncertain as these, whatever the number of epochs.
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
    """Track the change of the wind through residuals (N, 3) in b with a Kalman filter.

    ``noise`` (3,): variance of a one-second mean. ``wind`` (2,) and ``cov`` (2, 2) are the initial state; returns both
    at the end, and the wind predicted ahead of each residual, (N, 2).
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
        for axis in range(3):  # the noise is independent: sequential scalar updates
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
