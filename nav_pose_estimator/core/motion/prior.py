"""What flights of the past say of the law of motion, before this flight has said much: a prior that fades.

An archive is the sum of normal equations of ``air_velocity`` eq. (1) with a linear g, each flight's own wind removed,

    G = mean of z z',  M = mean of z (C'(v - w))'        z: inputs in fixed physical scales, and a one           (1)

In flight it counts as s seconds more of flight, so that the coefficients b minimise

    sum |C'v - b'z - C'w|^2 + (s / PERIOD) tr (b - b0)' G (b - b0)        b0 = G^-1 M                            (2)

together with the wind w of today. s begins as so many seconds of flight and fades while the vehicle moves: an archive
of other aircraft that counted for ever would do harm as soon as this flight has shown how it moves.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.motion.epochs import BODY_VELOCITY, PERIOD, VELOCITY, attitude, inputs
from nav_pose_estimator.core.motion.wind import Weigh, mean_wind, mean_wind_cov

Array = NDArray[np.float64]

MOVES = 1.0  # m/s over ground: faster is flight that teaches something
UNKNOWN_WIND = 5.0**2  # m^2/s^2: variance of the wind at the start, while the prior counts in full: a fresh breeze
_CENTRE = np.array((0.0, 0.0, 9.8, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0))
_SCALE = np.array((1.0, 1.0, 1.0, 0.3, 0.3, 0.3, 0.1, 0.1, 0.05))
_ADDED_SCALE = 5.0  # m/s: what a method adds to the inputs are velocities
_RIDGE, _WIND_RIDGE = 1e-3, 1e-2  # as where a flight is alone
_LEAST_RIDGE = 1e-6  # part of a mean square of one
_RARE = 1.32  # 99th percentile of chi-square over its ten degrees of freedom, less one


def regressors(epochs: Array) -> Array:
    """z of eq. (1), (N, 10 + K)."""
    x = inputs(epochs)
    centre, scale = _scaling(x.shape[1])
    return np.column_stack([(x - centre) / scale, np.ones(len(x))])


@dataclass(frozen=True)
class MotionPrior:
    """An archive of n inputs: ``gram`` (n + 1, n + 1) and ``moment`` (n + 1, 3) of eq. (1).

    ``noise`` (3,): variance of a mean over one second that its law leaves on flights that it was not made of, body axes
    [m^2/s^2]. ``wind_spread``: variance of the wind's change [m^2/s^2]; ``is_guided``: the ground guides
    the vehicle, no wind moves it. ``worth`` [s] of flight at the start, and
    ``fades`` [s] of motion until it counts no more.
    """

    gram: Array
    moment: Array
    noise: Array
    wind_spread: float
    is_guided: bool = False
    worth: float = 30.0
    fades: float = 150.0

    def seconds(self, epochs: Array) -> float:
        """s of eq. (2) after the flight of ``epochs`` (N, COLUMNS or more)."""
        speed = np.hypot(epochs[:, VELOCITY], epochs[:, VELOCITY + 1])
        moved = float(np.count_nonzero(speed > MOVES)) * PERIOD
        return self.worth * max(1.0 - moved / self.fades, 0.0)

    @property
    def coefficients(self) -> Array:
        """b0 (n + 1, 3) of eq. (2)."""
        return np.linalg.solve(self.gram + _LEAST_RIDGE * np.eye(len(self.gram)), self.moment)

    def fit(self, epochs: Array, seconds: float, windless: bool, weigh: Weigh) -> "tuple[PriorLaw, Array]":
        """Eq. (2) over the flight's epochs (N, COLUMNS or more): the law and the mean wind (2,)."""
        z, C, ridge = regressors(epochs), attitude(epochs), self._ridge(len(epochs), seconds)
        left = epochs[:, BODY_VELOCITY:VELOCITY] - z @ self.coefficients
        wind = np.zeros(2) if windless else mean_wind(C, left, z, ridge, _WIND_RIDGE, weigh)
        left = left - np.einsum("nij,i->nj", C[:, :2], wind)
        gram = z.T @ z
        coefficients = self.coefficients + np.linalg.solve(gram + ridge, z.T @ left)
        weight = seconds / PERIOD
        return PriorLaw(coefficients, (gram + weight * self.gram) / (len(z) + weight)), wind

    def parameter_cov(self, epochs: Array, seconds: float) -> Array:
        """Covariance (n + 1, n + 1) of the coefficients for z, for a noise of one in one second."""
        z = regressors(epochs)
        return np.linalg.inv(PERIOD * (z.T @ z + self._ridge(len(z), seconds)))

    def wind_cov(self, epochs: Array, seconds: float, noise: Array) -> Array:
        """Covariance (2, 2) [m^2/s^2] of the mean wind of eq. (2) where its residuals have the ``noise`` (3,)."""
        z, ridge = regressors(epochs), self._ridge(len(epochs), seconds)
        return mean_wind_cov(attitude(epochs), z, ridge, noise, UNKNOWN_WIND)

    def _ridge(self, count: int, seconds: float) -> Array:
        return np.asarray(seconds / PERIOD * self.gram + _RIDGE * count * np.eye(len(self.gram)))


@dataclass(frozen=True)
class PriorLaw:
    """A linear law: b (n + 1, 3) for z; ``spread`` (n + 1, n + 1): mean of z z' where it comes from."""

    coefficients: Array
    spread: Array
    rules = 1

    def predict(self, x: Array) -> Array:
        """Inputs (N, n) -> air velocity in b (N, 3)."""
        return self._z(x) @ self.coefficients

    def novelty(self, x: Array) -> Array:
        """(N,): 0 where inputs are as usual, 1 where they are as rare as the rarest 1 % of a normal distribution."""
        z = self._z(x)
        inverse = np.linalg.inv(self.spread + _LEAST_RIDGE * np.eye(len(self.spread)))
        distance = np.einsum("ni,ij,nj->n", z, inverse, z) / z.shape[1]
        return np.asarray((distance - 1.0) / _RARE)

    def _z(self, x: Array) -> Array:
        centre, scale = _scaling(x.shape[1])
        return np.column_stack([(x - centre) / scale, np.ones(len(x))])


@dataclass(frozen=True)
class Blend:
    """What a prior adds to the noise that a flight shows: ``noise`` (3,) by a ``share``.

    ``unknown_wind``: variance of the wind at the start beyond that of its change [m^2/s^2]. ``doubt``: factor on the
    noise with which residuals tell of the wind; a law that is not known yet errs in the same way for a while, and what
    it errs would pass for wind.
    """

    unknown_wind: float
    doubt: float
    noise: Array
    share: float

    def of(self, noise: Array) -> Array:
        """``noise`` (3,) of the flight with that of the prior."""
        return noise if self.share == 0.0 else self.share * self.noise + (1.0 - self.share) * noise


ALONE = Blend(0.0, 1.0, np.zeros(3), 0.0)
"""No prior."""


def in_raw_inputs(cov: Array) -> Array:
    """A covariance (n + 1, n + 1) of coefficients for z as that of coefficients for (inputs, 1)."""
    centre, scale = _scaling(len(cov) - 1)
    standardised = np.diag([*(1.0 / scale), 1.0])
    standardised[:-1, -1] = -centre / scale
    return np.asarray(standardised.T @ cov @ standardised)


def _scaling(count: int) -> tuple[Array, Array]:
    added = count - len(_CENTRE)
    return np.append(_CENTRE, np.zeros(added)), np.append(_SCALE, np.full(added, _ADDED_SCALE))
