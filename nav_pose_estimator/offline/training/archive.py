"""Normal equations of flights, each without its own wind, as sums from which a flight can be subtracted again."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.motion import epochs as me
from nav_pose_estimator.core.motion.air_velocity import learn_air_velocity, wind_along
from nav_pose_estimator.core.motion.airframe import Archive
from nav_pose_estimator.core.motion.prior import MotionPrior, PriorLaw, regressors

Array = NDArray[np.float64]
_NO_NOISE = np.ones(3)


@dataclass(frozen=True)
class NormalEquations:
    """Sums of ``core.motion.prior`` eq. (1) over ``seconds``: ``gram`` (n + 1, n + 1), ``moment`` (n + 1, 3)."""

    gram: Array
    moment: Array
    seconds: float

    @classmethod
    def of(cls, epochs: Array, target: Array) -> NormalEquations:
        """Normal equations of epochs (N, COLUMNS or more) and ``target`` (N, 3) [m/s], the air velocity in b."""
        z = regressors(epochs)
        return cls(me.PERIOD * (z.T @ z), me.PERIOD * (z.T @ target), len(z) * me.PERIOD)

    @classmethod
    def from_archive(cls, archive: Archive) -> NormalEquations:
        """Normal equations from their mean in an airframe file."""
        return cls(archive.seconds * archive.gram, archive.seconds * archive.moment, archive.seconds)

    def __add__(self, other: NormalEquations) -> NormalEquations:
        return NormalEquations(self.gram + other.gram, self.moment + other.moment, self.seconds + other.seconds)

    def __sub__(self, other: NormalEquations) -> NormalEquations:
        return NormalEquations(self.gram - other.gram, self.moment - other.moment, self.seconds - other.seconds)

    def archive(self, noise: Array = _NO_NOISE, wind_spread: float = 1.0) -> Archive:
        """Per second; the last of z is one, and so is its mean square."""
        gram = self.gram / self.seconds
        gram[-1, -1] = 1.0
        return Archive(0.5 * (gram + gram.T), self.moment / self.seconds, noise, wind_spread, self.seconds)

    def law(self) -> PriorLaw:
        """The law that they determine by themselves."""
        archive = self.archive()
        prior = MotionPrior(archive.gram, archive.moment, archive.noise, archive.wind_spread)
        return PriorLaw(prior.coefficients, archive.gram)


def air_velocity(epochs: Array) -> Array:
    """Body velocity (N, 3) [m/s] minus the wind, which is estimated by a linear law of the flight itself."""
    wind = wind_along(learn_air_velocity(epochs), epochs)
    in_body = np.einsum("nij,ni->nj", me.attitude(epochs)[:, :2], wind)
    return np.asarray(epochs[:, me.BODY_VELOCITY : me.VELOCITY] - in_body)
