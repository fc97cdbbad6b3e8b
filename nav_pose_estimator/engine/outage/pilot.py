"""One flight and its outage: epochs are collected and learned from, and in an outage a guide is asked about them."""

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
    """What comes out of half a second of an outage: ``samples`` for the navigator, and the drift that a model sees."""

    samples: tuple[Sample, ...] = ()
    drift: PredictedDrift | None = None


@dataclass
class PilotState:
    """What changes of a pilot, except its learner. ``position_error`` (3,): sum since the loss of GNSS [m], ENU."""

    collector: EpochCollector
    guide: Guide | None = None
    position_error: np.ndarray = field(default_factory=lambda: np.zeros(3))


class OutagePilot:
    """Follows the solutions of one navigator, of this process or of another."""

    def __init__(
        self, parameters: LearnerParameters, train: Train | None = None, learner: OutageLearner | None = None
    ) -> None:
        """``train`` carries out a job and hands its result to ``accept``; by default here and now."""
        self._parameters, self._elsewhere = parameters, train
        self.learner = learner or OutageLearner(parameters)
        self.state = PilotState(EpochCollector(self.learner.method))

    def copy(self) -> OutagePilot:
        """An independent copy."""
        twin = OutagePilot(self._parameters, self._elsewhere, self.learner.copy())
        twin.state = snapshot(self.state)
        return twin

    def reset(self) -> None:
        """Forget the flight; the model stays, the next training replaces it."""
        self.learner = OutageLearner(self._parameters, self.learner.state.model, self.learner.method)
        self.state = PilotState(EpochCollector(self.learner.method))

    def collect(self, output: NavBlock | NavSolution) -> FinishedEpoch | None:
        """Take a piece of the solution; returns the epoch that it ends, which goes to ``learn``."""
        return self.state.collector.feed(output)

    def learn(self, finished: FinishedEpoch) -> None:
        """Learn from an epoch if it is good, and then no outage lasts, either."""
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
        """What the flight has shown; None before ``least`` seconds of it."""
        epochs = self.learner.state.memory.last(self._parameters.window)
        if len(epochs) * me.PERIOD < least:
            return None
        return Flight(epochs, self.learner.state.model, usual=load_usual_motion(self._parameters.prior))

    def advise(self, stamp_ns: int, choose: Choose, external: VelocityError | None = None) -> OutageHelp:
        """Called at the end of every epoch without GNSS.

        ``choose`` is asked when an outage begins, and again while it has nothing to offer.
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
