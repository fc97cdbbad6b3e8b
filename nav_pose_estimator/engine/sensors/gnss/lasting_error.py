"""Model of GNSS errors as a time-correlated part, for which the filter has states, and white noise.

The size of an error is known from the receiver's statement and the floors of the parameters; its correlation is
identified in flight (``ErrorShares``). For positions the correlated part has the whole deviation, and its correlation
time is identified; the white noise is small. For velocities the correlation time is fixed, and the deviation is
identified. A stated variance beyond that of the states counts as white noise until the states have followed.
"""

from __future__ import annotations

import math

import numpy as np

from nav_pose_estimator.core.filter.blocks import GaussMarkov
from nav_pose_estimator.core.filter.noise_identification import NoiseIdentification
from nav_pose_estimator.core.numerics.jit import kernel
from nav_pose_estimator.engine.parameters.gnss import GnssParameters

_POSITION_TAU, _VELOCITY_TAU = 60.0, 1.0  # s: initial correlation times
_FOLLOWING = 10.0  # s: time constant with which the states' variance follows the stated one
_LASTING_VELOCITY = 0.6  # initial correlated part of a velocity's standard deviation, relative to the parameter
_WHITE_POSITION, _WHITE_VELOCITY = 0.133, 0.4  # initial white noise, relative to the parameters' standard deviations


class LastingPosition:
    """Variance of the correlated position error; it follows the stated variance slowly, as the states can."""

    def __init__(self, gnss: GnssParameters) -> None:
        self.variance = position_sd(gnss) ** 2
        """(3,) [m^2]"""
        self._stated = np.diag(self.variance)  # never written to

    def receive(self, stated: np.ndarray) -> None:
        """Note the covariance ``stated`` (3, 3) [m^2] of a fix, which is not below the floors."""
        self._stated = stated

    def second(self) -> None:
        """Follow the stated variance; called once a second, so that all data of a second see the same value."""
        self.variance = self.variance + (self._stated.diagonal() - self.variance) / _FOLLOWING


def position_sd(gnss: GnssParameters) -> np.ndarray:
    """Standard deviation (3,) [m] of the correlated position error."""
    return np.array([gnss.position_sd, gnss.position_sd, gnss.vertical_sd])


def velocity_sd(gnss: GnssParameters, lasting: float = 1.0) -> np.ndarray:
    """Standard deviation (3,) [m/s] of the correlated velocity error, with the identified factor ``lasting``."""
    return math.sqrt(lasting) * _LASTING_VELOCITY * _whole_velocity_sd(gnss)


def _whole_velocity_sd(gnss: GnssParameters) -> np.ndarray:
    return np.array([gnss.velocity_sd, gnss.velocity_sd, gnss.velocity_vertical_sd])


def whole_variance(R: np.ndarray, lasting: LastingPosition | None) -> np.ndarray:
    """Total variance (m,) [m^2] of a fix on each axis: noise ``R`` (m, m) plus the correlated part."""
    own = R.diagonal()
    return own if lasting is None else own + lasting.variance[: len(own)]


def first_cov(gnss: GnssParameters) -> np.ndarray:
    """Initial covariance (6, 6) of the states: positions [m], velocities [m/s]."""
    return np.diag(np.square([*position_sd(gnss), *velocity_sd(gnss)]))


def process(gnss: GnssParameters, position_variance: np.ndarray, identified: NoiseIdentification) -> GaussMarkov:
    """Process model of the six states with the identified factors ``identified``: driving noise 2 sd^2 / tau."""
    tau = np.array([_POSITION_TAU / identified.position.lasting] * 3 + [_VELOCITY_TAU] * 3)
    sd = np.array([*np.sqrt(position_variance), *velocity_sd(gnss, identified.velocity.lasting)])
    return GaussMarkov(walk=tuple((sd * np.sqrt(2.0 / tau)).tolist()), tau=tuple(tau.tolist()))


def white_position(R: np.ndarray, shared: float, lasting: np.ndarray, identified: NoiseIdentification) -> np.ndarray:
    """White noise (3, 3) [m^2] of a position of covariance ``R``, with correlated variance ``lasting`` (3,) [m^2].

    A variance beyond that of the states is inflated by ``shared``, since it is correlated without a state. The factor
    ``gnss_variance`` identified in flight is included.
    """
    white = np.empty((3, 3))
    white_noise(R, _WHITE_POSITION**2 * identified.position.white, shared, lasting, identified.gnss_variance, white)
    return white


def white_velocity(R: np.ndarray, variance: np.ndarray, identified: NoiseIdentification) -> np.ndarray:
    """``white_position`` for a velocity [(m/s)^2], with the ``variance`` (3,) of the parameters as ``lasting``."""
    white = np.empty((3, 3))
    white_noise(R, _WHITE_VELOCITY**2 * identified.velocity.white, 1.0, variance, identified.gnss_variance, white)
    return white


@kernel
def raise_to(floor, R):
    """Raise the variances of ``R`` (3, 3) to those of ``floor`` (3, 3)."""
    for i in range(3):
        R[i, i] = max(R[i, i], floor[i, i])


@kernel
def white_noise(R, share, beyond, lasting, factor, white):
    """``factor`` times the sum of ``share`` R (3, 3) and of ``beyond`` times its variances above ``lasting`` (3,).

    It is written to ``white`` (3, 3): to return an array to Python would take longer than the arithmetic.
    """
    for i in range(3):
        for k in range(3):
            excess = beyond * max(R[i, i] - lasting[i], 0.0) if i == k else 0.0
            white[i, k] = factor * (share * R[i, k] + excess)


def figures(gnss: GnssParameters, position_variance: np.ndarray, identified: NoiseIdentification) -> dict[str, float]:
    """Status: identified deviations, correlation times and white noise per horizontal axis [m, s, m/s]."""
    position, velocity, position_sd = identified.position, identified.velocity, math.sqrt(position_variance[0])
    return {
        "gnss.error.position_sd": position_sd,
        "gnss.error.position_tau": _POSITION_TAU / position.lasting,
        "gnss.error.position_white_sd": math.sqrt(position.white) * _WHITE_POSITION * position_sd,
        "gnss.error.velocity_sd": float(velocity_sd(gnss, velocity.lasting)[0]),
        "gnss.error.velocity_tau": _VELOCITY_TAU,
        "gnss.error.velocity_white_sd": math.sqrt(velocity.white) * _WHITE_VELOCITY * gnss.velocity_sd,
    }
