"""Follows the solution of a navigator: learns from epochs of aided flight, asks a guide about those of an outage."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from nav_pose_estimator.core.motion import epochs as me
from nav_pose_estimator.core.numerics.snapshot import snapshot
from nav_pose_estimator.engine.outage.epochs import EpochCollector, FinishedEpoch
from nav_pose_estimator.engine.outage.learner import OutageLearner
from nav_pose_estimator.engine.outage.methods.method import Flight, Guide, TrainingJob, TrainingResult
from nav_pose_estimator.engine.outage.methods.usual_file import load_usual_motion
from nav_pose_estimator.engine.parameters.learner import LearnerParameters
from nav_pose_estimator.engine.samples import Sample, VelocityError
from nav_pose_estimator.engine.solutions import NavBlock, NavSolution, PredictedDrift

Train = Callable[[TrainingJob], None]
Choose = Callable[[], Guide | None]


class OutageHelp(NamedTuple):
    """The result of one epoch of an outage: ``samples`` for the navigator, and the drift that a model predicts."""

    samples: tuple[Sample, ...] = ()
    drift: PredictedDrift | None = None


@dataclass
class PilotState:
    """The mutable state of a pilot, except its learner.

    ``position_error`` (3,) [m], ENU: the predicted velocity error, integrated since the loss of GNSS.
    """

    collector: EpochCollector
    guide: Guide | None = None
    position_error: np.ndarray = field(default_factory=lambda: np.zeros(3))


class OutagePilot:
    """Follows the solutions of one navigator, of this process or of another."""

    def __init__(
        self, parameters: LearnerParameters, train: Train | None = None, learner: OutageLearner | None = None
    ) -> None:
        """``train`` runs a training job and hands its result to ``accept``; by default jobs run here, at once."""
        self._parameters, self._elsewhere = parameters, train
        self.learner = learner or OutageLearner(parameters)
        self.state = PilotState(EpochCollector(self.learner.method))

    def copy(self) -> OutagePilot:
        """An independent copy."""
        twin = OutagePilot(self._parameters, self._elsewhere, self.learner.copy())
        twin.state = snapshot(self.state)
        return twin

    def reset(self) -> None:
        """Forget the flight; the model stays until the next training replaces it."""
        self.learner = OutageLearner(self._parameters, self.learner.state.model, self.learner.method)
        self.state = PilotState(EpochCollector(self.learner.method))

    def collect(self, output: NavBlock | NavSolution) -> FinishedEpoch | None:
        """Take a piece of the solution; returns the epoch that it completes, which goes to ``learn``."""
        return self.state.collector.feed(output)

    def learn(self, finished: FinishedEpoch) -> None:
        """Learn from an epoch of good aided flight; such an epoch also ends an outage."""
        if not finished.is_good:
            return
        self.state.guide = None
        job = self.learner.learn(finished.values)
        if job is None:
            return
        if self._elsewhere is None:
            self.accept(job.run())
        else:
            self._elsewhere(job)

    def accept(self, result: TrainingResult) -> None:
        """Take the result of a training."""
        self.learner.accept(result)

    def flight(self, least: float = me.PERIOD) -> Flight | None:
        """The data of the flight so far; None before ``least`` [s] of it."""
        epochs = self.learner.state.memory.last(self._parameters.window)
        if len(epochs) * me.PERIOD < least:
            return None
        return Flight(epochs, self.learner.state.model, usual=load_usual_motion(self._parameters.prior))

    def advise(self, stamp_ns: int, choose: Choose, external: VelocityError | None = None) -> OutageHelp:
        """Evidence for the navigator, to be called at the end of each epoch without GNSS.

        ``choose`` is called when an outage begins, and again until it returns a guide.
        """
        state = self.state
        if state.guide is None:
            state.guide, state.position_error = choose(), np.zeros(3)
        if state.guide is None:
            return OutageHelp()
        advice = state.guide.advise(stamp_ns, state.collector.recent, external)
        error = advice.velocity_error
        if error is None:
            return OutageHelp(advice.samples)
        state.position_error = state.position_error + me.PERIOD * np.array(error.dv_n)
        east, north, up = state.position_error.tolist()
        return OutageHelp(advice.samples, PredictedDrift(stamp_ns, error.dv_n, error.cov, (east, north, up)))
