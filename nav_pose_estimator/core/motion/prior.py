"""A fading prior for the law of motion: the normal equations of past flights.

An archive holds the normal equations of ``air_velocity`` eq. (1) with a linear g, each flight's own wind removed,

    G = mean of z z',  M = mean of z (C'(v - w))'        z: inputs in fixed physical scales, and a one           (1)

In flight it has the weight of s additional seconds of flight, so that the coefficients b minimise

    sum |C'v - b'z - C'w|^2 + (s / PERIOD) tr (b - b0)' G (b - b0)        b0 = G^-1 M                            (2)

jointly with the wind w of this flight. The weight s decreases linearly to zero while the vehicle moves: once the flight
itself has shown how the vehicle moves, a permanent prior from other aircraft would bias the law.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.motion.epochs import BODY_VELOCITY, PERIOD, VELOCITY, attitude, inputs
from nav_pose_estimator.core.motion.wind import Weigh, mean_wind, mean_wind_cov

Array = NDArray[np.float64]

MOVES = 1.0  # m/s over ground: only faster motion reduces the weight of the prior
UNKNOWN_WIND = 5.0**2  # m^2/s^2: variance of the wind at the start, at full weight of the prior: a fresh breeze
_CENTRE = np.array((0.0, 0.0, 9.8, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0))
_SCALE = np.array((1.0, 1.0, 1.0, 0.3, 0.3, 0.3, 0.1, 0.1, 0.05))
_ADDED_SCALE = 5.0  # m/s: scale of the inputs that a method adds, which are velocities
_RIDGE, _WIND_RIDGE = 1e-3, 1e-2  # ridge penalties as in ``air_velocity``
_LEAST_RIDGE = 1e-6  # regularisation of ``gram``, whose inputs have mean squares near one
_RARE = 1.32  # 99th percentile of chi-square with ten degrees of freedom, over ten, minus one


def regressors(epochs: Array) -> Array:
    """z of eq. (1), (N, 10 + K), of epochs (N, COLUMNS + K): scaled inputs and a one."""
    x = inputs(epochs)
    centre, scale = _scaling(x.shape[1])
    return np.column_stack([(x - centre) / scale, np.ones(len(x))])


@dataclass(frozen=True)
class MotionPrior:
    """An archive of n inputs with its weight: ``gram`` G (n + 1, n + 1) and ``moment`` M (n + 1, 3) of eq. (1).

    ``noise`` (3,): cross-validated variance of the residual's one-second mean, body axes [m^2/s^2]. ``wind_spread``:
    variance of the wind's change [m^2/s^2]. ``is_guided``: a ground vehicle, which no wind moves. ``worth`` [s]: the
    weight s of eq. (2) at the start; ``fades`` [s]: motion after which it is zero.
    """

    gram: Array
    moment: Array
    noise: Array
    wind_spread: float
    is_guided: bool = False
    worth: float = 30.0
    fades: float = 150.0

    def seconds(self, epochs: Array) -> float:
        """The weight s [s] of eq. (2) after the flight of ``epochs`` (N, COLUMNS or more)."""
        speed = np.hypot(epochs[:, VELOCITY], epochs[:, VELOCITY + 1])
        moved = float(np.count_nonzero(speed > MOVES)) * PERIOD
        return self.worth * max(1.0 - moved / self.fades, 0.0)

    @property
    def coefficients(self) -> Array:
        """Coefficients b0 (n + 1, 3) of eq. (2)."""
        return np.linalg.solve(self.gram + _LEAST_RIDGE * np.eye(len(self.gram)), self.moment)

    def fit(self, epochs: Array, seconds: float, windless: bool, weigh: Weigh) -> "tuple[PriorLaw, Array]":
        """Minimise eq. (2) over epochs (N, COLUMNS or more); returns the law and the mean wind (2,) [m/s]."""
        z, C, ridge = regressors(epochs), attitude(epochs), self._ridge(len(epochs), seconds)
        left = epochs[:, BODY_VELOCITY:VELOCITY] - z @ self.coefficients
        wind = np.zeros(2) if windless else mean_wind(C, left, z, ridge, _WIND_RIDGE, weigh)
        left = left - np.einsum("nij,i->nj", C[:, :2], wind)
        gram = z.T @ z
        coefficients = self.coefficients + np.linalg.solve(gram + ridge, z.T @ left)
        weight = seconds / PERIOD
        return PriorLaw(coefficients, (gram + weight * self.gram) / (len(z) + weight)), wind

    def parameter_cov(self, epochs: Array, seconds: float) -> Array:
        """Covariance (n + 1, n + 1) of the coefficients for z, for unit noise of a one-second mean."""
        z = regressors(epochs)
        return np.linalg.inv(PERIOD * (z.T @ z + self._ridge(len(z), seconds)))

    def wind_cov(self, epochs: Array, seconds: float, noise: Array) -> Array:
        """Covariance (2, 2) [m^2/s^2] of the mean wind of eq. (2) for residuals of ``noise`` (3,) [m^2/s^2]."""
        z, ridge = regressors(epochs), self._ridge(len(epochs), seconds)
        return mean_wind_cov(attitude(epochs), z, ridge, noise, UNKNOWN_WIND)

    def _ridge(self, count: int, seconds: float) -> Array:
        return np.asarray(seconds / PERIOD * self.gram + _RIDGE * count * np.eye(len(self.gram)))


@dataclass(frozen=True)
class PriorLaw:
    """A linear law: coefficients b (n + 1, 3) for z; ``spread`` (n + 1, n + 1): mean of z z' of its training data."""

    coefficients: Array
    spread: Array
    rules = 1

    def predict(self, x: Array) -> Array:
        """Inputs (N, n) -> air velocity in b (N, 3)."""
        return self._z(x) @ self.coefficients

    def novelty(self, x: Array) -> Array:
        """Novelty (N,) of inputs (N, n) by Mahalanobis distance: 0 as in training, 1 at its 99th percentile."""
        z = self._z(x)
        inverse = np.linalg.inv(self.spread + _LEAST_RIDGE * np.eye(len(self.spread)))
        distance = np.einsum("ni,ij,nj->n", z, inverse, z) / z.shape[1]
        return np.asarray((distance - 1.0) / _RARE)

    def _z(self, x: Array) -> Array:
        centre, scale = _scaling(x.shape[1])
        return np.column_stack([(x - centre) / scale, np.ones(len(x))])


@dataclass(frozen=True)
class Blend:
    """Share of a prior in the noise statistics of a flight: ``noise`` (3,) [m^2/s^2] of the prior, with weight
    ``share``.

    ``unknown_wind``: variance of the wind at the start beyond that of its change [m^2/s^2]. ``doubt``: factor on the
    residuals' noise when the wind is tracked: the errors of poorly known coefficients are correlated over time and
    would otherwise be taken for wind.
    """

    unknown_wind: float
    doubt: float
    noise: Array
    share: float

    def of(self, noise: Array) -> Array:
        """Weighted mean (3,) of the ``noise`` of the flight and that of the prior."""
        return noise if self.share == 0.0 else self.share * self.noise + (1.0 - self.share) * noise


ALONE = Blend(0.0, 1.0, np.zeros(3), 0.0)
"""The blend without a prior."""


def in_raw_inputs(cov: Array) -> Array:
    """Transform a covariance (n + 1, n + 1) of coefficients for z into that of coefficients for (inputs, 1)."""
    centre, scale = _scaling(len(cov) - 1)
    standardised = np.diag([*(1.0 / scale), 1.0])
    standardised[:-1, -1] = -centre / scale
    return np.asarray(standardised.T @ cov @ standardised)


def _scaling(count: int) -> tuple[Array, Array]:
    added = count - len(_CENTRE)
    return np.append(_CENTRE, np.zeros(added)), np.append(_SCALE, np.full(added, _ADDED_SCALE))
