"""The network's life in flight: it trains while GNSS is good, is tried on the past, and is used only where it helps.

Training takes a ``TrainingJob``, plain arrays that may travel to another process. A result is taken over five seconds
of flight after its data ended, whoever computed it, so that a replay learns the same at the same time as the node.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from nav_pose_estimator.core.motion import epochs as me
from nav_pose_estimator.core.motion.air_velocity import AirVelocityModel, learn_air_velocity, learn_drag
from nav_pose_estimator.engine.outage.epochs import FlightMemory
from nav_pose_estimator.engine.parameters.learner import LearnerParameters
from nav_pose_estimator.errors import UserError

TAKE_OVER = 5.0  # s between the end of the data and the use of what was learned from them
_LEAST = 20.0  # s of flight
_YOUNG = 0.5  # a young flight is learned from again when it has grown by this part
_LINEAR, _DRAG = "anfis_linear", "drag"
_NETWORK_METHODS = frozenset(("anfis", _LINEAR, _DRAG, "best"))
_SEARCH_EVERY = 4  # trainings
_EXPLAINS = 0.9  # a model must leave less than this part of what it was to learn


@dataclass(frozen=True)
class TrainingJob:
    """Everything that a training needs: ``epochs`` (N, COLUMNS) of aided flight, how many rules to try."""

    epochs: np.ndarray
    rules: tuple[int, ...]
    drag: bool = False

    @property
    def until(self) -> float:
        """Time [s] of the newest data."""
        return float(self.epochs[-1, me.TIME])

    def run(self) -> TrainingResult:
        """Train. Takes milliseconds with one rule, longer with more."""
        model = learn_drag(self.epochs) if self.drag else learn_air_velocity(self.epochs, self.rules)
        return TrainingResult(model, self.until)


@dataclass(frozen=True)
class TrainingResult:
    """A trained model and the time [s] of its newest data."""

    model: AirVelocityModel
    until: float


class OutageLearner:
    """Schedules trainings on the flight's memory and keeps the model that is in use."""

    def __init__(self, parameters: LearnerParameters) -> None:
        self._parameters = parameters
        self.memory = FlightMemory()
        self.model: AirVelocityModel | None = None
        self.reason = "no flight has been seen yet"
        self.trainings = 0
        self._jobs = 0
        self._next = 0.0
        self._result: TrainingResult | None = None

    def copy(self) -> OutageLearner:
        """An independent copy."""
        twin = copy.copy(self)
        twin.memory = self.memory.copy()
        return twin

    def learn(self, one: np.ndarray) -> TrainingJob | None:
        """Take an epoch of aided flight; returns a job when a training is due. Hand its result to ``accept``."""
        now = float(one[me.TIME])
        self.memory.add(one)
        if self.model is not None:
            self.model = self.model.follow(one)
        if self._result is not None and now >= self._result.until + TAKE_OVER:
            self._take_over(self._result)
        waits = (
            0.0 < self._next - now <= self._parameters.period
        )  # a clock that went back does not wait for the old time
        if self._parameters.method not in _NETWORK_METHODS or waits:
            return None
        return self.job(now)

    def job(self, now: float) -> TrainingJob | None:
        """A training on the window up to now; ``None``, with a reason, when there is too little flight in it."""
        epochs = self.memory.last(self._parameters.window)
        seconds = len(epochs) * me.PERIOD
        if seconds < _LEAST:
            self.reason = f"only {seconds:.0f} s of flight with GNSS have been seen, {_LEAST:.0f} are needed"
            return None
        self._next = now + min(self._parameters.period, _YOUNG * seconds)
        self._jobs += 1
        return TrainingJob(epochs, self._rules(), self._parameters.method == _DRAG)

    def _rules(self) -> tuple[int, ...]:
        """Numbers of rules to try: all of them now and then, else the one that was chosen and one rule."""
        if self._parameters.method == _LINEAR or self._parameters.rules == 1:
            return (1,)
        if self._jobs % _SEARCH_EVERY == 1:
            return tuple(range(1, self._parameters.rules + 1))
        return (1,) if self.model is None or self.model.rules == 1 else (1, self.model.rules)

    def accept(self, result: TrainingResult) -> None:
        """Keep a result until its time has come."""
        self._result = result

    def _take_over(self, result: TrainingResult) -> None:
        self._result = None
        self.trainings += 1
        model = result.model
        left = model.errors[model.rules] / max(model.target_square, 1e-12)
        # that a vehicle on wheels does not slip is worth knowing, however little it says of the speed ahead
        if left > _EXPLAINS and not model.is_guided:
            self.reason = f"the network explains only {100.0 * (1.0 - left):.0f} % of the motion"
            self.model = None
            return
        self.reason = ""
        for one in self.memory.last(2.0 * TAKE_OVER):
            if one[me.TIME] > result.until:
                model = model.follow(one)
        self.model = model

    def scores(self) -> dict[str, float]:
        """What diagnostics show of the learning."""
        scores = {"learner.flight_s": self.memory.seconds, "learner.trainings": float(self.trainings)}
        if self.model is not None:
            scores["learner.rules"] = float(self.model.rules)
            scores["learner.target_rms"] = self.model.target_square**0.5
            for rules, error in self.model.errors.items():
                scores[f"learner.error_rms.{rules}"] = error**0.5
            scores |= {f"learner.noise.{axis}": float(v**0.5) for axis, v in zip("xyz", self.model.noise, strict=True)}
        return scores

    def state(self) -> dict[str, np.ndarray]:
        """The model as named arrays. ``UserError`` without one."""
        if self.model is None:
            raise UserError(f"there is no model yet: {self.reason}")
        return self.model.state()

    def load(self, state: Mapping[str, np.ndarray]) -> None:
        """Begin with a saved model; the next training replaces it. ``UserError`` when parts are missing."""
        try:
            self.model = AirVelocityModel.from_state(state)
        except KeyError as error:
            raise UserError(f"this is not a model of the outage learning: {error} is missing") from None
        self.reason = ""
