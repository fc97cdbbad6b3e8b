"""The outage aid of a navigator in the same process: learning, rehearsals and evidence for the filter."""

from __future__ import annotations

from dataclasses import dataclass, replace

from nav_pose_estimator.core.motion.vehicle_class import BOAT, FIXED_WING, MULTIROTOR, WHEELS
from nav_pose_estimator.core.numerics.snapshot import snapshot
from nav_pose_estimator.engine.navigator.modes import DENIED
from nav_pose_estimator.engine.navigator.sins import SinsEngine
from nav_pose_estimator.engine.number_checks import is_covariance, is_within
from nav_pose_estimator.engine.outage.epochs import last_stamp
from nav_pose_estimator.engine.outage.learner import OutageLearner
from nav_pose_estimator.engine.outage.methods.method import Flight, Guide, TrainingResult
from nav_pose_estimator.engine.outage.methods.usual_file import load_usual_motion
from nav_pose_estimator.engine.outage.pilot import OutageHelp, OutagePilot, Train
from nav_pose_estimator.engine.outage.rehearsals import Elsewhere, Rehearsals
from nav_pose_estimator.engine.parameters.learner import LearnerParameters
from nav_pose_estimator.engine.samples import Sample, VelocityError
from nav_pose_estimator.engine.solutions import NavBlock, NavSolution

_CLASSES = {MULTIROTOR: "a multirotor", FIXED_WING: "a fixed wing", WHEELS: "a vehicle on wheels", BOAT: "a boat"}
_LARGEST_SPEED = 1e3  # m/s: a larger velocity error from another process is not used
_REHEARSE_AFTER = 20.0  # s of flight before the first rehearsal: an earlier one is not representative


@dataclass
class AidState:
    """The mutable state of an ``OutageAid``, except its pilot and its rehearsals."""

    external: VelocityError | None = None
    """The last prediction of a network in another process."""
    class_told: bool = False
    """Whether the warning about the vehicle's class has been given."""
    rests: bool = False
    """True: no rehearsal begins, and the running one is aborted."""


class OutageAid:
    """Learns while GNSS is good, rehearses outages, and gives the navigator evidence when GNSS is lost."""

    def __init__(
        self,
        parameters: LearnerParameters,
        train: Train | None = None,
        rehearse: Elsewhere | None = None,
        pilot: OutagePilot | None = None,
    ) -> None:
        """``train`` runs a training job and hands its result to ``accept``; by default jobs run here, at once.

        ``rehearse`` flies rehearsals in another process. Raises ``UserError`` for an unusable file of the parameters.
        """
        load_usual_motion(parameters.prior)  # an unusable file is refused before the flight
        self._parameters, self._train, self._rehearse = parameters, train, rehearse
        self._pilot = pilot or OutagePilot(parameters, train)
        self.rehearsals = Rehearsals(self.learner.method.rehearsal, self._rehearse)
        self.state = AidState()

    def reset(self) -> None:
        """Forget the flight; the model stays until the next training replaces it."""
        self._pilot.reset()
        self.rehearsals = Rehearsals(self.learner.method.rehearsal, self._rehearse)
        self.state.external = None

    def copy(self) -> OutageAid:
        """An independent copy."""
        twin = OutageAid(self._parameters, self._train, self._rehearse, self._pilot.copy())
        twin.rehearsals = self.rehearsals.copy()
        twin.state = snapshot(self.state)
        return twin

    @property
    def learner(self) -> OutageLearner:
        """The learner, which holds the model."""
        return self._pilot.learner

    @property
    def guide(self) -> Guide | None:
        """The guide of the present outage; None outside an outage, and while coasting."""
        return self._pilot.state.guide

    def accept(self, result: TrainingResult) -> None:
        """Take the result of a training."""
        self._pilot.accept(result)

    def predicted(self, error: VelocityError) -> None:
        """Take a prediction of a network in another process; an implausible one is not used."""
        if is_within(error.dv_n, _LARGEST_SPEED) and is_covariance(error.cov, 3):
            self.state.external = error

    def hear(self, sample: Sample) -> None:
        """Take each sample that the navigator gets; the rehearsals need all of them."""
        self.rehearsals.feed(sample)

    def step(self, output: NavBlock | NavSolution, sins: SinsEngine) -> OutageHelp:
        """Take a piece of the solution of ``sins``; returns evidence for it in an outage. Called with every piece."""
        finished = self._pilot.collect(output)
        if finished is None:
            return OutageHelp()
        stamp = last_stamp(output)
        if self.state.rests:
            self.rehearsals.break_off()
        elif self.rehearsals.is_due(stamp, sins) and (flight := self._flight(_REHEARSE_AFTER)) is not None:
            self.rehearsals.start(stamp, sins, self._pilot.state.collector, self.learner.method.ways(flight))
        self._pilot.learn(finished)
        if output.mode not in DENIED:
            return OutageHelp()
        return self._pilot.advise(stamp, self.choose, self.state.external)

    def wrong_class(self) -> str:
        """A warning, given once, where the flight shows another class than file or parameter state; else empty."""
        shown, known = self.learner.state.shown_class, self.learner.method.beforehand.vehicle_class
        if not shown or self.state.class_told:
            return ""
        self.state.class_told = True
        source = f"learner.airframe ({self._parameters.airframe})" if self._parameters.airframe else ""
        return (
            f"the vehicle moves like {_CLASSES[shown]}, but {source or 'learner.vehicle_class'} is for "
            f"{_CLASSES[known]}: this prior knowledge is misleading in an outage"
        )

    def choose(self) -> Guide | None:
        """The guide for an outage that begins now; None to coast."""
        flight = self._flight(self.learner.method.least_flight)
        return None if flight is None else self.learner.method.choose(flight, self.rehearsals)

    def _flight(self, least: float) -> Flight | None:
        flight, shown = self._pilot.flight(least), self.rehearsals
        if flight is None:
            return None
        return replace(
            flight,
            drift_variance=shown.drift_variance,
            decisions=shown.decisions,
            spread=shown.spread(),
            hover_spread=shown.spread(hovering=True),
        )

    def status(self) -> dict[str, float]:
        """Values for diagnostics."""
        return self.learner.scores() | self.rehearsals.scores()
