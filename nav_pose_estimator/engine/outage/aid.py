"""Everything that helps the navigator through an outage, behind one call per solution."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from nav_pose_estimator.core.motion import epochs as me
from nav_pose_estimator.core.motion.air_velocity import AirVelocityModel
from nav_pose_estimator.engine.navigator.modes import DENIED
from nav_pose_estimator.engine.navigator.sins import SinsEngine
from nav_pose_estimator.engine.number_checks import is_covariance, is_within
from nav_pose_estimator.engine.outage.epochs import EpochCollector, last_stamp
from nav_pose_estimator.engine.outage.habits import BEST, MotionKnowledge, vector3
from nav_pose_estimator.engine.outage.learner import OutageLearner, TrainingJob, TrainingResult
from nav_pose_estimator.engine.outage.rehearsals import COAST, VirtualOutages
from nav_pose_estimator.engine.parameters.learner import LearnerParameters
from nav_pose_estimator.engine.samples import MotionEvidence, Sample, VelocityError
from nav_pose_estimator.engine.solutions import NavBlock, NavSolution, PredictedDrift

_LARGEST_SPEED = 1e3  # m/s
_ENOUGH = 20.0  # s of flight below which nothing is known of the motion
_NETWORK, _REGIMES = "network", "regimes"
_DRAW = 1.1  # errors this much larger than the simpler way's are still a draw
_CLEARLY = 3.0  # coasting grows with the cube of time: a draw with it at 30 s is a win at 60 s

Train = Callable[[TrainingJob], None]


class OutageAid:
    """Learns while GNSS is good, rehearses outages, and speaks up when GNSS is lost."""

    def __init__(self, parameters: LearnerParameters, train: Train | None = None) -> None:
        """``train`` carries out a job and hands its result to ``accept``; by default here and now."""
        self._parameters = parameters
        self._elsewhere = train
        self.learner = OutageLearner(parameters)
        self.reset()

    def reset(self) -> None:
        """Forget the flight; the model stays, the next training replaces it."""
        model = self.learner.model
        self.learner = OutageLearner(self._parameters)
        self.learner.model = model
        self.rehearsals = VirtualOutages()
        self._collector = EpochCollector()
        self._knowledge: MotionKnowledge | None = None
        self._external: VelocityError | None = None
        self._position_error = np.zeros(3)

    def copy(self) -> OutageAid:
        """An independent copy."""
        twin = OutageAid(self._parameters, self._elsewhere)
        twin.learner, twin.rehearsals = self.learner.copy(), self.rehearsals.copy()
        twin._collector = self._collector.copy()
        twin._knowledge, twin._external = self._knowledge, self._external
        twin._position_error = self._position_error.copy()
        return twin

    def _train(self, job: TrainingJob) -> None:
        if self._elsewhere is None:
            self.accept(job.run())
        else:
            self._elsewhere(job)

    def accept(self, result: TrainingResult) -> None:
        """Take the result of a training."""
        self.learner.accept(result)

    def predicted(self, error: VelocityError) -> None:
        """A prediction of a network in another process; one that is no number is not used."""
        if is_within(error.dv_n, _LARGEST_SPEED) and is_covariance(error.cov, 3):
            self._external = error

    def hear(self, sample: Sample) -> None:
        """Every sample that the navigator gets: the rehearsals live on it."""
        self.rehearsals.feed(sample)

    def step(
        self, output: NavBlock | NavSolution, sins: SinsEngine
    ) -> tuple[MotionEvidence | None, PredictedDrift | None]:
        """Called with every piece of the solution; returns what it says of the motion in an outage."""
        finished = self._collector.feed(output)
        if finished is None:
            return None, None
        stamp = last_stamp(output)
        if self.rehearsals.is_due(stamp, sins) and (ways := self._ways()):
            self.rehearsals.start(stamp, sins, self._collector, ways)
        one, good = finished
        if good:
            self._knowledge = None
            job = self.learner.learn(one)
            if job is not None:
                self._train(job)
        return self._in_outage(stamp) if output.mode in DENIED else (None, None)

    def _in_outage(self, stamp_ns: int) -> tuple[MotionEvidence | None, PredictedDrift | None]:
        if self._knowledge is None:
            self._knowledge = self._choose()
            self._position_error = np.zeros(3)
        if self._knowledge is None:
            return None, None
        evidence, error = self._knowledge.evidence(stamp_ns, np.array(self._collector.recent), self._external)
        if error is None:
            return evidence, None
        self._position_error = self._position_error + me.PERIOD * np.array(error.dv_n)
        return evidence, PredictedDrift(stamp_ns, error.dv_n, error.cov, vector3(self._position_error))

    def _choose(self) -> MotionKnowledge | None:
        """What to go by in this outage: for ``best`` what did best in the rehearsals, else what was asked for."""
        ways = self._ways()
        if self._parameters.method != BEST:
            return ways.get(_NETWORK) or ways.get(_REGIMES)
        rehearsals = self.rehearsals
        best = _REGIMES
        if _NETWORK in ways and not rehearsals.is_worse(_NETWORK, _REGIMES, _DRAW):
            best = _NETWORK
        return None if rehearsals.is_worse(best, COAST, _CLEARLY) else ways.get(best)

    def _ways(self) -> dict[str, MotionKnowledge]:
        """The ways to be helped that there are by now."""
        method, model = self._parameters.method, self.learner.model
        epochs = self.learner.memory.last(self._parameters.window)
        if method == COAST or len(epochs) * me.PERIOD < _ENOUGH:
            return {}
        drift = self.rehearsals.drift_variance
        ways = {_REGIMES: MotionKnowledge.of(method, epochs, None, drift)}
        if model is not None:
            ways[_NETWORK] = MotionKnowledge.of(method, epochs, model, drift)
        return ways

    @property
    def model(self) -> AirVelocityModel | None:
        """The trained network in use."""
        return self.learner.model

    def status(self) -> dict[str, float]:
        """Numbers for diagnostics."""
        values = self.learner.scores()
        for name in (COAST, _REGIMES, _NETWORK):
            rms = self.rehearsals.rms(name)
            if rms is not None:
                values[f"rehearsal.rms_30_s.{name}"] = rms
        count, drift = float(self.rehearsals.rehearsals), self.rehearsals.drift_variance
        return values | {"rehearsal.count": count, "rehearsal.drift_variance": drift}
