"""A prior on the velocity: zero mean, with the mean square speed of the last half minute of aided flight."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nav_pose_estimator.core.motion import epochs as me
from nav_pose_estimator.engine.outage.methods.air_velocity_guide import TRAVEL, motion_evidence
from nav_pose_estimator.engine.outage.methods.method import (
    Advice,
    Array,
    Flight,
    Guide,
    OutageMethod,
    RehearsalScores,
)
from nav_pose_estimator.engine.samples import Hypothesis, VelocityError

_RECENT = 30.0  # s of aided flight over which the mean square speed is taken
_SLOWEST = 0.05  # m/s: least standard deviation of a velocity component


@dataclass(frozen=True)
class UsualSpeed:
    """Guide with a prior on the speed. ``square``: mean square horizontal speed [m^2/s^2] before the outage."""

    square: float
    drift_variance: float = 1.0

    def advise(self, stamp_ns: int, recent: Array, external: VelocityError | None = None) -> Advice:
        """The same prior at every epoch."""
        usual = Hypothesis(TRAVEL, 1.0, max(0.5 * self.square, _SLOWEST**2), None)
        return Advice((motion_evidence(stamp_ns, recent[-1], (usual,), self.drift_variance),))


class VelocityPrior(OutageMethod):
    """A zero-mean prior on the velocity, with the recent mean square speed as its variance."""

    name = "velocity_prior"
    summary = "zero mean velocity with the mean square of the last 30 s"
    is_classical = True

    def ways(self, flight: Flight) -> dict[str, Guide]:
        """The prior on the speed."""
        return {self.name: _usual_speed(flight)}

    def choose(self, flight: Flight, scores: RehearsalScores) -> Guide | None:
        """The prior on the speed, regardless of rehearsals."""
        return _usual_speed(flight)


def _usual_speed(flight: Flight) -> UsualSpeed:
    time = flight.epochs[:, me.TIME]
    recent = flight.epochs[time > time[-1] - _RECENT, me.VELOCITY : me.VELOCITY + 2]
    return UsualSpeed(float(np.square(recent).sum(axis=1).mean()), flight.drift_variance)
