"""The learner behind topics: the engine of anfis_node. Odometry in, predicted errors of the navigator out."""

from collections.abc import Callable
from typing import Any

import numpy as np

from nav_pose_estimator.core.motion.epochs import PERIOD
from nav_pose_estimator.engine.navigator.modes import DENIED
from nav_pose_estimator.engine.outage.epochs import EpochCollector
from nav_pose_estimator.engine.outage.habits import MotionKnowledge
from nav_pose_estimator.engine.outage.learner import OutageLearner
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import ImuSample
from nav_pose_estimator.engine.solutions import Event, Level, Mode, NavSolution, PredictedDrift, Status
from nav_pose_estimator.ros.navigator_watch import NavigatorWatch, OdometrySample

_NETWORK_ALONE = "anfis"  # the navigator weighs the prediction against what else it knows of the motion


class OutageModel:
    """Learns from the solutions that another node publishes, and predicts in its outages."""

    def __init__(self, parameters: Parameters, train: Callable[[Any], None]) -> None:
        """``train`` takes training jobs; their results come back through ``accept``."""
        self._parameters, self._train = parameters, train
        self.watch = NavigatorWatch(parameters)
        self.learner = OutageLearner(parameters.learner)
        self._begin()

    def _begin(self) -> None:
        self._collector = EpochCollector()
        self._knowledge: MotionKnowledge | None = None
        self._position_error = np.zeros(3)

    def feed(self, sample: ImuSample | OdometrySample) -> list[PredictedDrift | Event]:
        """What follows from one sample."""
        if isinstance(sample, ImuSample):
            return list(self.watch.imu(sample))
        solution = self.watch.odometry(sample)
        finished = None if solution is None else self._collector.feed(solution)
        if solution is None or finished is None:
            return []
        one, is_good = finished
        if is_good:
            job = self.learner.learn(one)
            if job is not None:
                self._train(job)
        if solution.mode not in DENIED:
            self._knowledge = None
            return []
        return self._predict(solution)

    def _predict(self, solution: NavSolution) -> list[PredictedDrift | Event]:
        """What the network says at the end of an epoch without GNSS."""
        if self._knowledge is None:
            epochs = self.learner.memory.last(self._parameters.learner.window)
            if self.learner.model is None or not len(epochs):
                return [Event(solution.stamp_ns, "outage.no_model")]
            self._knowledge = MotionKnowledge.of(_NETWORK_ALONE, epochs, self.learner.model)
            self._position_error = np.zeros(3)
        _, error = self._knowledge.evidence(solution.stamp_ns, np.array(self._collector.recent))
        if error is None:
            return []
        self._position_error = self._position_error + PERIOD * np.array(error.dv_n)
        east, north, up = self._position_error.tolist()
        return [PredictedDrift(solution.stamp_ns, error.dv_n, error.cov, (east, north, up))]

    def accept(self, result: Any) -> None:
        """Take the result of a training."""
        self.learner.accept(result)

    @property
    def mode(self) -> Mode:
        """WAITING_IMU without a navigator, ALIGNING while there is no model, AIDED with one."""
        if self.watch.waiting_for:
            return Mode.WAITING_IMU
        return Mode.ALIGNING if self.learner.model is None else Mode.AIDED

    def status(self) -> Status:
        """Why the model is not used (``waiting_for``) and its scores (``values``)."""
        missing, reason = self.watch.waiting_for, self.learner.reason if self.learner.model is None else ""
        return Status(
            stamp_ns=0,
            mode=self.mode,
            waiting_for=f"waiting for {missing}" if missing else reason,
            seconds_coasting=0.0,
            horizontal_sd=np.nan,
            horizontal_sd_in_30_s=np.nan,
            gnss_refusal="",
            satellites=None,
            counters={},
            values=self.learner.scores(),
        )

    def reset(self, stamp_ns: int, reason: str) -> list[Event]:
        """Forget the flight; the model stays, the next training replaces it."""
        model = self.learner.model
        self.watch.reset()
        self.learner = OutageLearner(self._parameters.learner)
        self.learner.model = model
        self._begin()
        return [Event(stamp_ns, "outage.reset", Level.WARN, f"the learner starts again: {reason}")]

    def warm_up(self) -> None:
        """The network is compiled in the training process first, and found on disk here."""

    def set_parameters(self, parameters: Parameters) -> None:
        """Nothing of the learner can change in flight."""
