"""The interface of outage methods, between ``learner.method`` and its users.

A method is one file in this folder and one line in ``registry``. It holds no state: what it learns is kept by
the learner, so that a snapshot of the estimator is complete and a replay learns what the node learned. What was known
before the flight is no state: ``beforehand`` stays as it is.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.motion import epochs as me
from nav_pose_estimator.core.motion.airframe import Beforehand
from nav_pose_estimator.core.motion.regimes import Decisions
from nav_pose_estimator.core.motion.usual import UsualMotion
from nav_pose_estimator.engine.outage.methods.usual_file import load_usual_motion
from nav_pose_estimator.engine.samples import Sample, VelocityError
from nav_pose_estimator.engine.solutions import NavBlock, NavSolution

Array = NDArray[np.float64]
_ENOUGH, _ENOUGH_BEFOREHAND = 20.0, 4.0  # s of flight below which nothing can be told; with knowledge from before
Model = Any
"""What a method's training gives: a frozen dataclass that only the method looks into. The learner calls its
``follow(epoch)`` for the model brought up to date by one more epoch of aided flight, and ``state()`` for its arrays."""


@dataclass(frozen=True)
class Flight:
    """What a flight has shown so far. ``epochs`` (N, COLUMNS + K) of its aided part in order of time, N > 0.

    ``usual``: how vehicles move of which nothing else is known. By rehearsals: ``drift_variance``, squared errors of
    coasting as a fraction of the variance that the filter states; ``decisions`` between regimes; ``spread`` [m^2/s],
    which the stated position of each way lacks, ``hover_spread`` where the vehicle hovered.
    """

    epochs: Array
    model: Model | None = None
    drift_variance: float = 1.0
    decisions: Decisions = field(default_factory=Decisions)
    spread: Mapping[str, float] = field(default_factory=dict)
    hover_spread: Mapping[str, float] = field(default_factory=dict)
    usual: UsualMotion = field(default_factory=load_usual_motion)


@dataclass(frozen=True)
class Advice:
    """What half a second of an outage gives: ``samples`` for the navigator, and the error seen in its velocity."""

    samples: tuple[Sample, ...] = ()
    velocity_error: VelocityError | None = None


class Guide(Protocol):
    """What is known when GNSS is lost: a frozen dataclass, made from data before the loss."""

    def advise(self, stamp_ns: int, recent: Array, external: VelocityError | None = None) -> Advice:
        """Called at the end of every epoch; ``recent`` (up to the method's ``history``, COLUMNS + K) ends with it.

        ``external`` is the newest prediction of another process, for a guide that has no model of its own.
        """
        ...


class TrainingJob(Protocol):
    """A training. It travels to another process: picklable, and of a module that can be imported there."""

    @property
    def until(self) -> float:
        """Time [s] of the newest data."""
        ...

    def run(self) -> TrainingResult:
        """Train; takes what time it needs."""
        ...


@dataclass(frozen=True)
class TrainingResult:
    """A trained model and the time [s] of its newest data."""

    model: Model
    until: float


@dataclass(frozen=True)
class TrainingPlan:
    """How to train: the largest number of rules to try, how many trainings went before, the model in use."""

    rules: int = 1
    trainings: int = 0
    model: Model | None = None


class RehearsalScores(Protocol):
    """What ``rehearsals`` say about the ways through an outage."""

    def is_worse(self, name: str, rival: str, ratio: float) -> bool: ...


@dataclass(frozen=True)
class RehearsalRules:
    """How rehearsals count.

    ``stated``: how many rehearsals the covariance stated by the filter is worth; ``enough``: how many in which sigma
    lacked nothing are averaged with those of the flight."""

    kept: int = 6  # rehearsals that count, the newest ones
    least: int = 3  # with fewer, chance decides
    stated: float = 1.0
    enough: float = 2.0
    smallest_variance: float = 0.05  # fraction of what the filter states; more than stated is for innovations to say


class Method:
    """What every method has: the ``name`` that a user writes, and ``summary``, half a sentence on what it goes by."""

    name: str
    summary: str
    is_classical = False
    """Whether it is one of the rivals that a learned method has to beat."""


class Extrapolation(Method):
    """Extrapolates the last aided state without a filter: a yardstick of the benchmark."""

    def velocity(self, last: Array) -> Array:
        """Velocity (3,) throughout the outage, from that at the loss of GNSS [m/s]."""
        raise NotImplementedError


class OutageMethod(Method):
    """A value of ``learner.method``. This base class learns nothing and leaves the filter alone."""

    helps = True
    """False where there is nothing to ask in an outage."""
    trains = False
    """Whether ``job`` has work to do."""
    history = me.ACTIVITY_EPOCHS
    """Number of epochs that a guide gets to see."""
    rehearsal = RehearsalRules()
    beforehand = Beforehand()

    def knowing(self, beforehand: Beforehand) -> Self:
        """The method of a flight that begins with this knowledge. ``UserError`` where the method needs more."""
        twin = copy.copy(self)
        twin.beforehand = beforehand
        return twin

    def after(self, epochs: Array) -> Self:
        """The method with what the flight of ``epochs`` (N, COLUMNS or more) leaves of ``beforehand``."""
        left = self.beforehand.by_flight(epochs)
        return self if left is self.beforehand else OutageMethod.knowing(self, left)

    @property
    def least_flight(self) -> float:
        """Seconds of flight from which on there may be something to go by in an outage."""
        return _ENOUGH_BEFOREHAND if self.beforehand.is_class_known else _ENOUGH

    @property
    def least_training(self) -> float:
        """Seconds of flight from which on a training is possible."""
        return _ENOUGH if self.beforehand.prior is None else _ENOUGH_BEFOREHAND

    def warm_up(self) -> None:
        """Call once what training and model compile."""

    def columns(self, output: NavBlock | NavSolution, rows: Array) -> Array:
        """What to add to the COLUMNS of an epoch: (K,), K fixed.

        ``output`` ended it; ``rows`` (N, OUT_COLUMNS) are those of the epoch and of the one before it, if that was
        consecutive.
        """
        return np.empty(0)

    def job(self, epochs: Array, plan: TrainingPlan) -> TrainingJob:
        """A training on aided epochs (N, COLUMNS + K)."""
        raise NotImplementedError

    def refusal(self, model: Model) -> str:
        """Why a trained model is not to be flown with, in one clause; empty where it is."""
        return ""

    def scores(self, model: Model) -> dict[str, float]:
        """What diagnostics show of a model."""
        return {}

    def load(self, arrays: Mapping[str, Array]) -> Model:
        """The model of ``model.state()``. ``UserError`` for damaged arrays, ``KeyError`` where one is missing."""
        raise NotImplementedError

    def ways(self, flight: Flight) -> dict[str, Guide]:
        """The ways through an outage that rehearsals shall compare with coasting and with each other, by name."""
        return {}

    def choose(self, flight: Flight, scores: RehearsalScores) -> Guide | None:
        """What to go by in an outage that begins now; None to coast."""
        return None

    def model_alone(self, flight: Flight) -> Guide | None:
        """What ``anfis_node`` sends to a navigator, which weighs it with the rest; None without a model."""
        return None


def newest_time(epochs: Array) -> float:
    """Time [s] at which epochs (N, COLUMNS) end."""
    return float(epochs[-1, me.TIME])
