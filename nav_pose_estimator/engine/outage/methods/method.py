"""The interface of outage methods, which ``learner.method`` selects.

A method is one file in this folder and one line in ``registry``. It is stateless: what it learns is kept by the
learner, so that a snapshot of the estimator is complete and a replay learns what the node learned. Knowledge from
before the flight, ``beforehand``, does not change.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
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
_ENOUGH, _ENOUGH_BEFOREHAND = 20.0, 4.0  # s: least flight without and with prior knowledge
Model = Any
"""The result of a training: a frozen dataclass, opaque to all but its method. The learner calls its ``follow(epoch)``,
which returns the model updated by one more epoch of aided flight, and ``state()``, which returns its named arrays."""


@dataclass(frozen=True)
class Flight:
    """Data of a flight so far. ``epochs`` (N, COLUMNS + K): its aided part in order of time, N > 0.

    ``usual``: population statistics of motion. From rehearsals: ``drift_variance``, squared error of coasting over the
    variance that the filter states; ``decisions`` between regimes; ``spread`` [m^2/s], spectral density that the stated
    position of each way lacks, and ``hover_spread``, the same while hovering.
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
    """The advice for one epoch of an outage: ``samples`` for the navigator.

    ``predict`` computes the navigator's velocity error, which rehearsals do not need; None without a prediction.
    """

    samples: tuple[Sample, ...] = ()
    predict: Callable[[], VelocityError] | None = None

    @property
    def velocity_error(self) -> VelocityError | None:
        """The predicted velocity error of the navigator."""
        return None if self.predict is None else self.predict()


class Guide(Protocol):
    """What aids the navigator in an outage: a frozen dataclass, made from data before the loss of GNSS."""

    def advise(self, stamp_ns: int, recent: Array, external: VelocityError | None = None) -> Advice:
        """Called at the end of each epoch, the last of ``recent`` (at most the method's ``history``, COLUMNS + K).

        ``external``: the newest prediction of another process, for a guide without a model of its own.
        """
        ...


class TrainingJob(Protocol):
    """A training. It may be sent to another process: picklable, of a module that can be imported there."""

    @property
    def until(self) -> float:
        """Time [s] of the newest data."""
        ...

    def run(self) -> TrainingResult:
        """Train; may take long."""
        ...


@dataclass(frozen=True)
class TrainingResult:
    """A trained model and the time [s] of its newest data."""

    model: Model
    until: float


@dataclass(frozen=True)
class TrainingPlan:
    """How to train: the largest number of rules to try, the number of earlier trainings, the model in use."""

    rules: int = 1
    trainings: int = 0
    model: Model | None = None


class RehearsalScores(Protocol):
    """Comparison of the ways through an outage, as ``rehearsals`` provides it."""

    def is_worse(self, name: str, rival: str, ratio: float) -> bool: ...


@dataclass(frozen=True)
class RehearsalRules:
    """How rehearsals are evaluated."""

    kept: int = 6  # number of newest rehearsals that count
    least: int = 3  # least number for a comparison of two ways; with fewer, chance decides
    stated: float = 1.0  # weight, in rehearsals, of the covariance that the filter states
    enough: float = 2.0  # weight, in rehearsals, of the assumption that the stated covariance lacks nothing
    smallest_variance: float = 0.05  # lower bound of ``drift_variance``; it is at most 1, the rest is up to innovations


class Method:
    """Base of all methods: ``name`` as in the parameters, and ``summary``, half a sentence on what it is based on."""

    name: str
    summary: str
    is_classical = False
    """Whether it is one of the baselines that a learned method has to beat."""


class Extrapolation(Method):
    """Extrapolates the last aided state without a filter: a baseline of the benchmark."""

    def velocity(self, last: Array) -> Array:
        """Velocity (3,) [m/s] throughout the outage, from the ``last`` one at the loss of GNSS."""
        raise NotImplementedError


class OutageMethod(Method):
    """A value of ``learner.method``. This base class learns nothing and gives no advice."""

    helps = True
    """Whether it gives advice in an outage."""
    trains = False
    """Whether it has trainings (``job``)."""
    history = me.ACTIVITY_EPOCHS
    """Number of recent epochs that a guide gets."""
    rehearsal = RehearsalRules()
    beforehand = Beforehand()

    def knowing(self, beforehand: Beforehand) -> Self:
        """The method with prior knowledge of the vehicle. Raises ``UserError`` where the method needs more."""
        twin = copy.copy(self)
        twin.beforehand = beforehand
        return twin

    def after(self, epochs: Array) -> Self:
        """The method with the prior knowledge that still holds after ``epochs`` (N, COLUMNS or more)."""
        left = self.beforehand.by_flight(epochs)
        return self if left is self.beforehand else OutageMethod.knowing(self, left)

    @property
    def least_flight(self) -> float:
        """Least flight [s] before an outage in which the method can give advice."""
        return _ENOUGH_BEFOREHAND if self.beforehand.is_class_known else _ENOUGH

    @property
    def least_training(self) -> float:
        """Least flight [s] for a training."""
        return _ENOUGH if self.beforehand.prior is None else _ENOUGH_BEFOREHAND

    def warm_up(self) -> None:
        """Compile the kernels of training and model by calling them once."""

    @property
    def adds_columns(self) -> bool:
        """Whether the method has ``columns`` of its own."""
        return type(self).columns is not OutageMethod.columns

    def columns(self, output: NavBlock | NavSolution, rows: Array) -> Array:
        """Columns (K,), K fixed, that the method adds to an epoch.

        ``output``: the solution that ended it. ``rows`` (N, OUT_COLUMNS): rows of the epoch, after those of the epoch
        before if they are consecutive.
        """
        return np.empty(0)

    def job(self, epochs: Array, plan: TrainingPlan) -> TrainingJob:
        """A training on aided epochs (N, COLUMNS + K)."""
        raise NotImplementedError

    def refusal(self, model: Model) -> str:
        """Why a trained model must not be used, in one clause; empty if it may."""
        return ""

    def scores(self, model: Model) -> dict[str, float]:
        """Values of a model for diagnostics."""
        return {}

    def load(self, arrays: Mapping[str, Array]) -> Model:
        """The model of ``model.state()``. Raises ``UserError`` for damaged arrays, ``KeyError`` for a missing one."""
        raise NotImplementedError

    def ways(self, flight: Flight) -> dict[str, Guide]:
        """Ways through an outage, by name, that rehearsals compare with coasting and with each other."""
        return {}

    def choose(self, flight: Flight, scores: RehearsalScores) -> Guide | None:
        """The guide for an outage that begins now; None to coast."""
        return None

    def model_alone(self, flight: Flight) -> Guide | None:
        """The guide whose prediction ``anfis_node`` sends to a navigator; None without a model."""
        return None


def newest_time(epochs: Array) -> float:
    """Time [s] at which epochs (N, COLUMNS) end."""
    return float(epochs[-1, me.TIME])
