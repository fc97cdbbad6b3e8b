"""``best`` with a network trained on other flights, whose output is an additional input of the law learned in flight.

The network of ``core.learning.conv_lstm`` predicts the velocity through the air from the last second. Its prediction
joins the inputs of the law, so that the flight decides what it is worth: first by cross-validation, then in rehearsals.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Self

from nav_pose_estimator.core.motion import epochs as me
from nav_pose_estimator.core.motion.air_velocity import AirVelocityModel, learn_air_velocity
from nav_pose_estimator.core.motion.airframe import Beforehand, TrainedNetwork
from nav_pose_estimator.core.motion.prior import MotionPrior
from nav_pose_estimator.core.motion.windows import window
from nav_pose_estimator.engine.outage.methods.air_velocity_guide import AirVelocityGuide
from nav_pose_estimator.engine.outage.methods.anfis import NETWORK
from nav_pose_estimator.engine.outage.methods.best import Best
from nav_pose_estimator.engine.outage.methods.method import (
    Advice,
    Array,
    Flight,
    Guide,
    Model,
    RehearsalScores,
    TrainingJob,
    TrainingPlan,
    TrainingResult,
    newest_time,
)
from nav_pose_estimator.engine.samples import VelocityError
from nav_pose_estimator.engine.solutions import NavBlock, NavSolution
from nav_pose_estimator.errors import UserError

PRETRAINED = "pretrained"  # name of this way in rehearsals and diagnostics
_OUTPUTS = 3


@dataclass(frozen=True)
class PairModel:
    """The law learned without the network's output (``plain``) and with it (``stacked``); a file holds the first."""

    plain: AirVelocityModel
    stacked: AirVelocityModel | None = None

    @property
    def rules(self) -> int:
        """Number of rules of ``plain``."""
        return self.plain.rules

    @property
    def gain(self) -> float:
        """Cross-validated squared error of ``plain`` over that of ``stacked``; zero without the latter."""
        if self.stacked is None:
            return 0.0
        return self.plain.errors[self.plain.rules] / max(self.stacked.errors[self.stacked.rules], 1e-12)

    def follow(self, epoch: Array) -> PairModel:
        """Both, with the wind updated by one more aided epoch."""
        stacked = None if self.stacked is None else self.stacked.follow(epoch)
        return PairModel(self.plain.follow(epoch[: me.COLUMNS]), stacked)

    def state(self) -> dict[str, Array]:
        """Named arrays for a file."""
        return self.plain.state()


@dataclass(frozen=True)
class PairTraining:
    """Train on ``epochs`` (N, COLUMNS + 3) with and without their last three columns, each with its own prior."""

    epochs: Array
    rules: tuple[int, ...]
    prior: MotionPrior | None
    stacked_prior: MotionPrior | None

    @property
    def until(self) -> float:
        """Time [s] of the newest data."""
        return newest_time(self.epochs)

    def run(self) -> TrainingResult:
        """Train both; takes milliseconds."""
        plain = learn_air_velocity(self.epochs[:, : me.COLUMNS], self.rules, prior=self.prior)
        return TrainingResult(PairModel(plain, learn_air_velocity(self.epochs, prior=self.stacked_prior)), self.until)


@dataclass(frozen=True)
class WithoutNetwork:
    """Adapts a guide to epochs that have the network's output, which it does not use."""

    guide: Guide

    def __getattr__(self, name: str) -> object:
        """Any other attribute of the guide."""
        return getattr(object.__getattribute__(self, "guide"), name)

    def advise(self, stamp_ns: int, recent: Array, external: VelocityError | None = None) -> Advice:
        """The advice of the guide."""
        return self.guide.advise(stamp_ns, recent[:, : me.COLUMNS], external)


class CnnLstm(Best):
    """``best`` with one more way, judged by the same rehearsals."""

    name = "cnn_lstm"
    summary = "as best, with what a network of learner.airframe, trained on other flights, adds where it has helped"

    network: TrainedNetwork

    def knowing(self, beforehand: Beforehand) -> Self:
        """The method with the network of the airframe file. Raises ``UserError`` where there is none."""
        if beforehand.airframe is None or beforehand.airframe.network is None:
            raise UserError(
                f"the method {self.name} flies with a trained network: name a file of train --network in "
                "learner.airframe"
            )
        twin = super().knowing(beforehand)
        twin.network = self.flown(beforehand.airframe.network)
        return twin

    def flown(self, network: TrainedNetwork) -> TrainedNetwork:
        """The network to use, given that of the file: the same."""
        return network

    def columns(self, output: NavBlock | NavSolution, rows: Array) -> Array:
        """Air velocity in b (3,) [m/s] predicted by the network."""
        return self.network.velocity(window(rows))

    def job(self, epochs: Array, plan: TrainingPlan) -> TrainingJob:
        """Train with and without the network's output."""
        stacked = self.beforehand.prior_of(self.network.archive)
        return PairTraining(epochs, self.rules(plan), self.beforehand.prior, stacked)

    def refusal(self, model: Model) -> str:
        """Refuse a model by its law without the network's output."""
        return super().refusal(model.plain)

    def scores(self, model: Model) -> dict[str, float]:
        """Scores of the law without the network's output, and the ``gain`` of the network."""
        return super().scores(model.plain) | {"learner.network_gain": model.gain}

    def load(self, arrays: Mapping[str, Array]) -> Model:
        """The law that an earlier flight learned without the network's output."""
        return PairModel(AirVelocityModel.from_state(arrays))

    def ways(self, flight: Flight) -> dict[str, Guide]:
        """The ways of ``best``, and the regimes with the law that uses the network's output."""
        plain = replace(flight, epochs=flight.epochs[:, : me.COLUMNS], model=None)
        ways: dict[str, Guide] = {name: WithoutNetwork(guide) for name, guide in super().ways(plain).items()}
        if flight.model is not None:
            ways[NETWORK] = WithoutNetwork(self.with_regimes(plain, flight.model.plain, NETWORK))
            if flight.model.stacked is not None:
                ways[PRETRAINED] = self.with_regimes(flight, flight.model.stacked, PRETRAINED)
        return ways

    def choose(self, flight: Flight, scores: RehearsalScores) -> Guide | None:
        """With the network's output where it improved the cross-validated error and was not worse in rehearsals."""
        has_helped = flight.model is not None and flight.model.gain > 1.0
        use = PRETRAINED if has_helped and not scores.is_worse(PRETRAINED, NETWORK, 1.0) else NETWORK
        return self.chosen(self.ways(flight), use, scores)

    def model_alone(self, flight: Flight) -> Guide | None:
        """The law with the network's output where that is better, without regimes."""
        if flight.model is None:
            return None
        if flight.model.gain > 1.0:
            return AirVelocityGuide(flight.model.stacked)
        return WithoutNetwork(AirVelocityGuide(flight.model.plain))


class Untrained(CnnLstm):
    """The control of ``cnn_lstm``: a network of random weights shows which gain is not due to training."""

    name = "cnn_untrained"
    summary = "control of cnn_lstm: the same with a network of random weights"

    def flown(self, network: TrainedNetwork) -> TrainedNetwork:
        """A network of the same shape and scales with random weights."""
        return network.untrained
