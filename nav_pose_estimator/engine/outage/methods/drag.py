"""Linear rotor drag and wind by least squares in flight: the classical baseline of the network."""

from __future__ import annotations

from dataclasses import dataclass

from nav_pose_estimator.core.motion.air_velocity import learn_drag
from nav_pose_estimator.engine.outage.methods.anfis import Anfis
from nav_pose_estimator.engine.outage.methods.method import (
    Array,
    TrainingJob,
    TrainingPlan,
    TrainingResult,
    newest_time,
)


@dataclass(frozen=True)
class DragTraining:
    """Fit drag coefficients and wind to ``epochs`` (N, COLUMNS) of aided flight."""

    epochs: Array

    @property
    def until(self) -> float:
        """Time [s] of the newest data."""
        return newest_time(self.epochs)

    def run(self) -> TrainingResult:
        """Fit; takes a millisecond."""
        return TrainingResult(learn_drag(self.epochs), self.until)


class Drag(Anfis):
    """As ``anfis``, with a law of physics instead of the network."""

    name = "drag"
    summary = "linear rotor drag and wind, fitted in flight"
    is_classical = True

    def job(self, epochs: Array, plan: TrainingPlan) -> TrainingJob:
        """Fit the law."""
        return DragTraining(epochs)
