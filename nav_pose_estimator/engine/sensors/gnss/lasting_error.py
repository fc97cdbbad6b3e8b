"""A receiver's error as two parts: one that lasts, which the filter has states for, and white noise.

What is known of an error is its size, by what the receiver states and the floors of the parameters; how fast it changes
is what the flight shows. The lasting part of a position has the whole deviation: its noise is small, and identified
(``ErrorShares``) is how fast it moves, that is its correlation time. Of a velocity the time is set and the deviation is
identified. What a receiver states beyond the states' variance counts as noise, until they have followed.
"""

from __future__ import annotations

import math

import numpy as np

from nav_pose_estimator.core.filter.blocks import Wander
from nav_pose_estimator.core.filter.noise_identification import NoiseIdentification
from nav_pose_estimator.engine.parameters.gnss import GnssParameters

_POSITION_TAU, _VELOCITY_TAU = 60.0, 1.0  # s: where it begins
_FOLLOWING = 10.0  # s: in the meantime what is stated beyond counts as noise, which then outweighs the states' delay
_LASTING_VELOCITY = 0.6  # of the deviation that is set
_WHITE_POSITION, _WHITE_VELOCITY = 0.133, 0.4  # of the deviation that is set: where it begins


class LastingPosition:
    """The variance of what lasts of the error of positions: it follows what the receiver states, as the states can."""

    def __init__(self, gnss: GnssParameters) -> None:
        self.variance = position_sd(gnss) ** 2
        """(3,) [m^2]"""
        self._stated = self.variance

    def receive(self, stated: np.ndarray) -> None:
        """A fix of covariance ``stated`` (3, 3) [m^2], which is not below the floors."""
        self._stated = stated.diagonal().copy()

    def second(self) -> None:
        """Once a second while fixes are used: so all that arrives within it finds the same."""
        self.variance = self.variance + (self._stated - self.variance) / _FOLLOWING


def position_sd(gnss: GnssParameters) -> np.ndarray:
    """Deviation (3,) [m] of what lasts of the error of positions."""
    return np.array([gnss.position_sd, gnss.position_sd, gnss.vertical_sd])


def velocity_sd(gnss: GnssParameters, lasting: float = 1.0) -> np.ndarray:
    """Deviation (3,) [m/s] of what lasts of the error of velocities, by the factor that the flight has shown."""
    return math.sqrt(lasting) * _LASTING_VELOCITY * _whole_velocity_sd(gnss)


def _whole_velocity_sd(gnss: GnssParameters) -> np.ndarray:
    return np.array([gnss.velocity_sd, gnss.velocity_sd, gnss.velocity_vertical_sd])


def whole_variance(R: np.ndarray, lasting: LastingPosition | None) -> np.ndarray:
    """Variance (m,) [m^2] of a fix with noise ``R`` (m, m) on each of its axes, with what lasts of its error."""
    own = R.diagonal()
    return own if lasting is None else own + lasting.variance[: len(own)]


def first_cov(gnss: GnssParameters) -> np.ndarray:
    """Covariance (6, 6) of the states where nothing is known: positions [m], velocities [m/s]."""
    return np.diag(np.square([*position_sd(gnss), *velocity_sd(gnss)]))


def wander(gnss: GnssParameters, position_variance: np.ndarray, shown: NoiseIdentification) -> Wander:
    """How the six states change, with what the flight has ``shown``: driving noise 2 sd^2 / tau."""
    tau = np.array([_POSITION_TAU / shown.position.lasting] * 3 + [_VELOCITY_TAU] * 3)
    sd = np.array([*np.sqrt(position_variance), *velocity_sd(gnss, shown.velocity.lasting)])
    return Wander(walk=tuple((sd * np.sqrt(2.0 / tau)).tolist()), tau=tuple(tau.tolist()))


def white_position(R: np.ndarray, shared: float, lasting: np.ndarray, shown: NoiseIdentification) -> np.ndarray:
    """Noise (3, 3) [m^2] of a position of covariance ``R`` beside what lasts, of variance ``lasting`` (3,) [m^2].

    What exceeds that is inflated by ``shared``: fixes share that error, and no state knows of it.
    """
    excess = shared * np.maximum(R.diagonal() - lasting, 0.0)
    return _WHITE_POSITION**2 * shown.position.white * R + np.diag(excess)


def white_velocity(R: np.ndarray, gnss: GnssParameters, shown: NoiseIdentification) -> np.ndarray:
    """The same [(m/s)^2] of a velocity."""
    excess = np.maximum(R.diagonal() - _whole_velocity_sd(gnss) ** 2, 0.0)
    return _WHITE_VELOCITY**2 * shown.velocity.white * R + np.diag(excess)


def figures(gnss: GnssParameters, position_variance: np.ndarray, shown: NoiseIdentification) -> dict[str, float]:
    """Deviations, correlation times and white noise on each horizontal axis [m, s, m/s], as the flight has shown."""
    position, velocity, position_sd = shown.position, shown.velocity, math.sqrt(position_variance[0])
    return {
        "gnss.error.position_sd": position_sd,
        "gnss.error.position_tau": _POSITION_TAU / position.lasting,
        "gnss.error.position_white_sd": math.sqrt(position.white) * _WHITE_POSITION * position_sd,
        "gnss.error.velocity_sd": float(velocity_sd(gnss, velocity.lasting)[0]),
        "gnss.error.velocity_tau": _VELOCITY_TAU,
        "gnss.error.velocity_white_sd": math.sqrt(velocity.white) * _WHITE_VELOCITY * gnss.velocity_sd,
    }
