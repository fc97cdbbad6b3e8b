"""Schedules the trainings of an outage method and keeps the model in use.

A training is a ``TrainingJob``: plain data that may be sent to another process. Its result takes effect five seconds of
flight after the end of its data, wherever it was computed, so that a replay learns the same at the same time as the
node.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from nav_pose_estimator.core.motion import epochs as me
from nav_pose_estimator.core.motion.airframe import Beforehand
from nav_pose_estimator.core.motion.vehicle_class import UNKNOWN, class_probabilities, likely_class
from nav_pose_estimator.core.numerics.snapshot import snapshot
from nav_pose_estimator.engine.outage.airframe_file import load_airframe
from nav_pose_estimator.engine.outage.epochs import FlightMemory
from nav_pose_estimator.engine.outage.methods.method import (
    Model,
    OutageMethod,
    TrainingJob,
    TrainingPlan,
    TrainingResult,
    newest_time,
)
from nav_pose_estimator.engine.outage.methods.registry import estimators
from nav_pose_estimator.engine.parameters.learner import LearnerParameters
from nav_pose_estimator.errors import UserError

TAKE_OVER = 5.0  # s between the end of the training data and the use of the model
_LOOK = 20.0  # s between two classifications of the vehicle
_YOUNG = 0.5  # early in a flight, the next training is due when the flight has grown by this fraction


@dataclass
class LearnerState:
    """The mutable state of a learner."""

    memory: FlightMemory = field(default_factory=FlightMemory)
    model: Model | None = None
    reason: str = "no flight has been seen yet"  # why there is no model in use
    trainings: int = 0  # number of results that took effect
    begun: int = 0  # number of trainings begun
    next_s: float = 0.0  # time of the next training [s]
    result: TrainingResult | None = None  # a finished training that has not taken effect yet
    look_s: float = 0.0  # time of the next classification of the vehicle [s]
    # probabilities of the vehicle's class, for diagnostics
    class_figures: dict[str, float] = field(default_factory=dict)
    shown_class: str = ""  # class shown by the flight, where it contradicts the one known beforehand


class OutageLearner:
    """Schedules trainings on the flight's memory and keeps the model that is in use."""

    def __init__(
        self, parameters: LearnerParameters, model: Model | None = None, method: OutageMethod | None = None
    ) -> None:
        """``model``: from an earlier flight, until the next training replaces it. ``method``: that of the parameters,
        where it exists already; else it is made, which reads the airframe file. Raises ``UserError`` for a bad file."""
        self._parameters = parameters
        self.method = method or estimators()[parameters.method].knowing(_beforehand(parameters))
        self.state = LearnerState(model=model)
        if not self.method.trains:
            self.state.reason = f"the method {self.method.name} learns no model"

    def copy(self) -> OutageLearner:
        """An independent copy."""
        twin = OutageLearner(self._parameters, method=self.method)
        twin.state = snapshot(self.state)
        return twin

    def warm_up(self) -> None:
        """Compile (or load) the kernels of a model before its first use, which may be in the middle of an outage."""
        self.method.warm_up()

    def learn(self, epoch: np.ndarray) -> TrainingJob | None:
        """Take an epoch of aided flight; returns a job when a training is due. Its result goes to ``accept``."""
        state, now = self.state, float(epoch[me.TIME])
        state.memory.add(epoch)
        if state.model is not None:
            state.model = state.model.follow(epoch)
        if not 0.0 < state.look_s - now <= _LOOK:
            state.look_s = now + _LOOK
            self._look_at_class()
        if state.result is not None and now >= state.result.until + TAKE_OVER:
            self._take_over(state.result)
        # after a clock has gone back, the old due time does not delay the training
        waits = 0.0 < state.next_s - now <= self._parameters.period
        return None if waits or not self.method.trains else self.job()

    def _look_at_class(self) -> None:
        state, known = self.state, self.method.beforehand.vehicle_class
        probability = class_probabilities(state.memory.last(self._parameters.window))
        state.class_figures = {f"learner.class.{name}": p for name, p in probability.items()}
        shown = likely_class(probability)
        state.shown_class = shown if UNKNOWN not in (known, shown) and shown != known else ""

    def job(self) -> TrainingJob | None:
        """A training on the window up to the newest epoch; ``None``, with a ``reason``, when impossible."""
        if not self.method.trains:
            return None
        state = self.state
        epochs = state.memory.last(self._parameters.window)
        method = self.method.after(epochs)
        epochs = method.beforehand.flown(epochs)
        seconds = len(epochs) * me.PERIOD
        if seconds < method.least_training:
            needed = f"{method.least_training:.0f} are needed"
            state.reason = f"only {seconds:.0f} s of flight with GNSS have been seen, {needed}"
            return None
        job = method.job(epochs, TrainingPlan(self._parameters.rules, state.begun, state.model))
        state.next_s = newest_time(epochs) + min(self._parameters.period, _YOUNG * seconds)
        state.begun += 1
        return job

    def accept(self, result: TrainingResult) -> None:
        """Keep a result until its time has come."""
        self.state.result = result

    def _take_over(self, result: TrainingResult) -> None:
        state, model = self.state, result.model
        state.result = None
        state.trainings += 1
        state.reason = self.method.refusal(model)
        if state.reason:
            state.model = None
            return
        for epoch in state.memory.last(2.0 * TAKE_OVER):
            if epoch[me.TIME] > result.until:
                model = model.follow(epoch)
        state.model = model

    def scores(self) -> dict[str, float]:
        """Values for diagnostics."""
        state = self.state
        scores = {
            "learner.flight_s": state.memory.seconds,
            "learner.trainings": float(state.trainings),
        } | state.class_figures
        return scores if state.model is None else scores | self.method.scores(state.model)

    def arrays(self) -> dict[str, np.ndarray]:
        """The model as named arrays. Raises ``UserError`` when there is none."""
        if self.state.model is None:
            raise UserError(f"there is no model yet: {self.state.reason}")
        return self.state.model.state()

    def load(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Begin with a saved model, until the next training replaces it. Raises ``UserError`` for an unusable one."""
        if not self.method.trains:
            raise UserError(f"the method {self.method.name} uses no model")
        try:
            self.state.model = self.method.load(arrays)
        except KeyError as error:
            raise UserError(f"this is not an outage model: {error} is missing") from None
        self.state.reason = ""


def _beforehand(parameters: LearnerParameters) -> Beforehand:
    """Prior knowledge from the parameters and the airframe file that they name."""
    vehicle_class = parameters.vehicle_class
    if not parameters.airframe:
        return Beforehand(vehicle_class)
    airframe = load_airframe(parameters.airframe)
    if vehicle_class not in (UNKNOWN, airframe.vehicle_class):
        raise UserError(
            f"learner.vehicle_class is {vehicle_class}, but {parameters.airframe} is of a {airframe.vehicle_class}: "
            "leave the parameter out, or choose another file"
        )
    return Beforehand(airframe.vehicle_class, airframe, parameters.airframe_seconds, parameters.airframe_fades)
