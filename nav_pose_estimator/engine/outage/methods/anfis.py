"""The neuro-fuzzy network alone: it predicts the velocity through the air from specific force, rate and attitude."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from nav_pose_estimator.core.motion import epochs as me
from nav_pose_estimator.core.motion.air_velocity import AirVelocityModel, learn_air_velocity
from nav_pose_estimator.core.motion.prediction_error import velocity_error
from nav_pose_estimator.core.motion.prior import MotionPrior
from nav_pose_estimator.engine.outage.methods.air_velocity_guide import AirVelocityGuide
from nav_pose_estimator.engine.outage.methods.method import (
    Array,
    Flight,
    Guide,
    OutageMethod,
    RehearsalScores,
    TrainingJob,
    TrainingPlan,
    TrainingResult,
    newest_time,
)

NETWORK = "network"  # name of this way in rehearsals and diagnostics
_WARM_UP_EPOCHS = 120  # epochs of noise that compile the kernels
_SEARCH_EVERY = 4  # trainings between two searches over all numbers of rules
_EXPLAINS = 0.9  # largest squared error of a usable model, as a fraction of the target's mean square


@dataclass(frozen=True)
class NetworkTraining:
    """Train the network on ``epochs`` (N, COLUMNS) of aided flight with each number in ``rules``.

    While the ``prior`` has weight, the law is linear.
    """

    epochs: Array
    rules: tuple[int, ...]
    prior: MotionPrior | None = None

    @property
    def until(self) -> float:
        """Time [s] of the newest data."""
        return newest_time(self.epochs)

    def run(self) -> TrainingResult:
        """Train. Takes milliseconds with one rule, longer with more."""
        return TrainingResult(learn_air_velocity(self.epochs, self.rules, prior=self.prior), self.until)


class Anfis(OutageMethod):
    """Base of all methods that predict the velocity through the air."""

    name = "anfis"
    summary = "the network alone"
    trains = True

    def warm_up(self) -> None:
        """Train on noise, follow it and predict."""
        epochs = np.random.default_rng(0).normal(size=(_WARM_UP_EPOCHS, me.COLUMNS))
        epochs[:, me.TIME] = np.arange(_WARM_UP_EPOCHS) * me.PERIOD
        epochs[:, me.ATTITUDE : me.BODY_VELOCITY] = np.eye(3).ravel()
        model = NetworkTraining(epochs, (1,)).run().model.follow(epochs[-1])
        air_velocity, doubt = model.predict(epochs[-1])
        velocity_error(epochs[-1], air_velocity, doubt * model.noise, model.wind, model.wind_spread)

    def job(self, epochs: Array, plan: TrainingPlan) -> TrainingJob:
        """Train with the numbers of rules to try."""
        return NetworkTraining(epochs, self.rules(plan), self.beforehand.prior)

    def rules(self, plan: TrainingPlan) -> tuple[int, ...]:
        """Numbers of rules to try: all of them in every fourth training, else one rule and the number in use."""
        if plan.rules == 1:
            return (1,)
        if plan.trainings % _SEARCH_EVERY == 0:
            return tuple(range(1, plan.rules + 1))
        return (1,) if plan.model is None or plan.model.rules == 1 else (1, plan.model.rules)

    def refusal(self, model: AirVelocityModel) -> str:
        """Refuse a model that explains next to nothing of the motion."""
        left = model.errors[model.rules] / max(model.target_square, 1e-12)
        # the non-holonomic constraint of a ground vehicle is useful, however poor the prediction of its speed is
        if left > _EXPLAINS and not model.is_guided:
            return f"the network explains only {100.0 * (1.0 - left):.0f} % of the motion"
        return ""

    def scores(self, model: AirVelocityModel) -> dict[str, float]:
        """Number of rules; RMS of the target and of the cross-validated error [m/s]; noise of each axis [m/s]."""
        scores = {"learner.rules": float(model.rules), "learner.target_rms": model.target_square**0.5}
        for rules, error in model.errors.items():
            scores[f"learner.error_rms.{rules}"] = error**0.5
        return scores | {f"learner.noise.{axis}": float(v**0.5) for axis, v in zip("xyz", model.noise, strict=True)}

    def load(self, arrays: Mapping[str, Array]) -> AirVelocityModel:
        """The model of ``AirVelocityModel.state``."""
        return AirVelocityModel.from_state(arrays)

    def ways(self, flight: Flight) -> dict[str, Guide]:
        """The network, as soon as there is one."""
        return {} if flight.model is None else {NETWORK: AirVelocityGuide(flight.model, flight.drift_variance)}

    def choose(self, flight: Flight, scores: RehearsalScores) -> Guide | None:
        """The network regardless of rehearsals, as the user asked; without a model, predictions of another process."""
        return AirVelocityGuide(flight.model, flight.drift_variance)

    def model_alone(self, flight: Flight) -> Guide | None:
        """The network, without regimes."""
        return None if flight.model is None else AirVelocityGuide(flight.model)
