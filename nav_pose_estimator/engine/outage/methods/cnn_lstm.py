"""A network trained on other flights beside what this one teaches: its output is one more thing to go by.

What the network of ``core.learning.conv_lstm`` says of the last second joins the inputs of the law that is learned in
flight, so that the flight decides what it is worth: on blocks of time not trained on first, then in rehearsals.
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

PRETRAINED = "pretrained"  # the way's name in rehearsals and on diagnostics
_OUTPUTS = 3


@dataclass(frozen=True)
class PairModel:
    """What the flight teaches without the network's output (``plain``) and with it; a file holds the first alone."""

    plain: AirVelocityModel
    stacked: AirVelocityModel | None = None

    @property
    def rules(self) -> int:
        """Number of rules without the network."""
        return self.plain.rules

    @property
    def gain(self) -> float:
        """Squared error on blocks not trained on, without the network's output over with it."""
        if self.stacked is None:
            return 0.0
        return self.plain.errors[self.plain.rules] / max(self.stacked.errors[self.stacked.rules], 1e-12)

    def follow(self, epoch: Array) -> PairModel:
        """Both brought on by one more aided epoch."""
        stacked = None if self.stacked is None else self.stacked.follow(epoch)
        return PairModel(self.plain.follow(epoch[: me.COLUMNS]), stacked)

    def state(self) -> dict[str, Array]:
        """Named arrays for a file."""
        return self.plain.state()


@dataclass(frozen=True)
class PairTraining:
    """Train with ``epochs`` (N, COLUMNS + 3) and without their last columns, each with its own prior."""

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
    """A guide that goes by the epochs as they are without the network's output."""

    guide: Guide

    def __getattr__(self, name: str) -> object:
        """What else the guide knows."""
        return getattr(object.__getattribute__(self, "guide"), name)

    def advise(self, stamp_ns: int, recent: Array, external: VelocityError | None = None) -> Advice:
        """What the guide says."""
        return self.guide.advise(stamp_ns, recent[:, : me.COLUMNS], external)


class CnnLstm(Best):
    """``best`` with one way more; no regret by the same rehearsals."""

    name = "cnn_lstm"
    summary = "as best, with what a network of learner.airframe, trained on other flights, adds where it has helped"

    network: TrainedNetwork

    def knowing(self, beforehand: Beforehand) -> Self:
        """``UserError`` where no file has a network."""
        if beforehand.airframe is None or beforehand.airframe.network is None:
            raise UserError(
                f"the method {self.name} flies with a trained network: name a file of train --network in "
                "learner.airframe"
            )
        twin = super().knowing(beforehand)
        twin.network = self.flown(beforehand.airframe.network)
        return twin

    def flown(self, network: TrainedNetwork) -> TrainedNetwork:
        """What is flown of the file's network: all of it."""
        return network

    def columns(self, output: NavBlock | NavSolution, rows: Array) -> Array:
        """Air velocity in b (3,) [m/s] as the network has it."""
        return self.network.velocity(window(rows))

    def job(self, epochs: Array, plan: TrainingPlan) -> TrainingJob:
        """Train with and without the network's output."""
        stacked = self.beforehand.prior_of(self.network.archive)
        return PairTraining(epochs, self.rules(plan), self.beforehand.prior, stacked)

    def refusal(self, model: Model) -> str:
        """As for a law without the network."""
        return super().refusal(model.plain)

    def scores(self, model: Model) -> dict[str, float]:
        """Those of the law without the network, and ``learner.network_gain``: squared error without over with it."""
        return super().scores(model.plain) | {"learner.network_gain": model.gain}

    def load(self, arrays: Mapping[str, Array]) -> Model:
        """What an earlier flight taught without the network."""
        return PairModel(AirVelocityModel.from_state(arrays))

    def ways(self, flight: Flight) -> dict[str, Guide]:
        """Those of ``best``, and the law with the network's output."""
        plain = replace(flight, epochs=flight.epochs[:, : me.COLUMNS], model=None)
        ways: dict[str, Guide] = {name: WithoutNetwork(guide) for name, guide in super().ways(plain).items()}
        if flight.model is not None:
            ways[NETWORK] = WithoutNetwork(self.with_regimes(plain, flight.model.plain, NETWORK))
            if flight.model.stacked is not None:
                ways[PRETRAINED] = self.with_regimes(flight, flight.model.stacked, PRETRAINED)
        return ways

    def choose(self, flight: Flight, scores: RehearsalScores) -> Guide | None:
        """With the network where it has helped on blocks not trained on and has not been worse in rehearsals."""
        has_helped = flight.model is not None and flight.model.gain > 1.0
        use = PRETRAINED if has_helped and not scores.is_worse(PRETRAINED, NETWORK, 1.0) else NETWORK
        return self.chosen(self.ways(flight), use, scores)

    def model_alone(self, flight: Flight) -> Guide | None:
        """The law with the network where it is better, without regimes."""
        if flight.model is None:
            return None
        if flight.model.gain > 1.0:
            return AirVelocityGuide(flight.model.stacked)
        return WithoutNetwork(AirVelocityGuide(flight.model.plain))


class Untrained(CnnLstm):
    """The control: what helps as much without training was not learned."""

    name = "cnn_untrained"
    summary = "control of cnn_lstm: the same with a network of random weights"

    def flown(self, network: TrainedNetwork) -> TrainedNetwork:
        """Its shape and scales."""
        return network.untrained
