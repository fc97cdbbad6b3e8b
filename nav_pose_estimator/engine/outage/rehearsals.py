"""Rehearsals of outages while GNSS is good: a way through an outage that was worse than coasting is not used.

Every minute, copies of the navigator fly half a minute of live data without GNSS: one coasts, the others are aided,
each in its own way. At the end all are compared with the aided navigator. A rehearsal uses the models as they were at
its beginning, so that its data are held out from training, and only past rehearsals decide about the next outage.

Rehearsals also show the ratio of the drift to the stated covariance, the variance that the stated position of each way
lacks, and how often a travelling vehicle is taken to hover.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

import numpy as np

from nav_pose_estimator.core.earth.ellipsoid import step_enu
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.motion.epochs import PERIOD
from nav_pose_estimator.core.motion.regimes import Decisions
from nav_pose_estimator.core.motion.usual import SLOW
from nav_pose_estimator.core.numerics.snapshot import snapshot
from nav_pose_estimator.engine.navigator.modes import DENIED
from nav_pose_estimator.engine.navigator.sins import SinsEngine
from nav_pose_estimator.engine.navigator.status import horizontal_deviation
from nav_pose_estimator.engine.outage.epochs import EpochCollector, last_stamp
from nav_pose_estimator.engine.outage.methods.air_velocity_guide import HOVER
from nav_pose_estimator.engine.outage.methods.coast import Coast
from nav_pose_estimator.engine.outage.methods.method import Guide, RehearsalRules
from nav_pose_estimator.engine.samples import (
    GnssFix,
    GnssVelocity,
    ImuBlock,
    ImuSample,
    ReturnDecision,
    Sample,
    SatelliteCount,
    SetPose,
    joined,
)
from nav_pose_estimator.engine.solutions import Mode, NavBlock, NavSolution

COAST = Coast.name
_LENGTH_NS = 30_000_000_000
_PERIOD_NS = 60_000_000_000
_LONGEST_WAIT_NS = 2_000_000_000  # four epochs; reached only where no solution of the navigator ends an epoch
_FROM_GNSS = (GnssFix, GnssVelocity, SatelliteCount, SetPose, ReturnDecision)


@dataclass
class Candidate:
    """One way through the outage: a copy of the navigator, and the guide that aids it."""

    sins: SinsEngine
    collector: EpochCollector
    guide: Guide | None

    def spread_psd(self, hovered: bool) -> float:
        """Spectral density [m^2/s] that earlier rehearsals added to its stated position, hovering or travelling."""
        added = getattr(self.guide, "spread_psd", 0.0)
        return float(getattr(self.guide, "hover_spread_psd", added) if hovered else added)

    def copy(self) -> Candidate:
        """An independent copy."""
        return Candidate(self.sins.snapshot(), snapshot(self.collector), self.guide)

    def feed(self, sample: Sample) -> None:
        """Feed a sample to the navigator, and the evidence of the guide after each epoch."""
        for output in self.sins.feed(sample):
            if self.guide is None or not isinstance(output, (NavBlock, NavSolution)):
                continue
            if self.collector.feed(output) is not None:
                for said in self.guide.advise(last_stamp(output), self.collector.recent).samples:
                    self.sins.feed(said)


class Epoch(NamedTuple):
    """Samples that the copies get together, and the aided navigator's ``velocity`` then, East and North [m/s]."""

    samples: list[Sample]
    velocity: tuple[float, float] | None


class Outcome(NamedTuple):
    """The result of a rehearsal: way -> squared horizontal error at its end in ``squares`` [m^2].

    ``surprise``: the squared error of coasting over its stated variance. ``excess`` [m^2]: squared errors minus their
    stated variances. ``decisions`` between the regimes of motion on the way.
    """

    squares: dict[str, float]
    surprise: float
    excess: dict[str, float]
    decisions: Decisions


@dataclass
class Rehearsal:
    """One rehearsal: its candidates, the epochs that they have still to fly, and the decisions so far.

    It begins with the coasting candidate only. The others are copies of it, made when they first fly, so that a
    rehearsal that has not been flown yet is small and can be sent to another process.
    """

    candidates: dict[str, Candidate]
    ways: Mapping[str, Guide]  # ways that have no candidate yet
    collector: EpochCollector  # with which their candidates begin
    epochs: list[Epoch] = field(default_factory=list)
    tally: Decisions = field(default_factory=Decisions)  # decisions of the epochs flown so far

    def copy(self) -> Rehearsal:
        """An independent copy."""
        candidates = {name: candidate.copy() for name, candidate in self.candidates.items()}
        return Rehearsal(candidates, self.ways, snapshot(self.collector), list(self.epochs), self.tally)

    @property
    def has_restarted(self) -> bool:
        """Whether a gap in the IMU data has made a copy restart, which invalidates the rehearsal."""
        copies = [one.sins for one in self.candidates.values()]
        return any(sins.run.unseen or sins.mode not in (*DENIED, Mode.AIDED) for sins in copies)

    def fly(self) -> None:
        """Fly the epochs collected so far, unless a copy restarts."""
        for name, guide in self.ways.items():
            twin = _copy_of(self.candidates[COAST].sins)
            self.candidates[name] = Candidate(twin, snapshot(self.collector), guide)
        self.ways, epochs, self.epochs = {}, self.epochs, []
        for epoch in epochs:
            self.tally = _flown(self.candidates, epoch, self.tally)
            if self.has_restarted:
                return

    def outcome(self, truth: np.ndarray, offset: np.ndarray, known: float) -> Outcome | None:
        """Fly it to its end and evaluate the errors; None where a copy had to restart.

        ``truth``: ``nav`` of the aided navigator at the end. ``offset`` (2,) [m]: its distance from the fixes, East and
        North, as ``Gnss.offset``. ``known`` [m]: its horizontal standard deviation.
        """
        self.fly()
        if self.has_restarted:
            return None
        squares, excess, variances = {}, {}, {}
        for name, candidate in self.candidates.items():
            step = step_enu(truth[at.LAT : at.VEL], candidate.sins.run.settled.nav[at.LAT : at.VEL])
            squares[name] = float(np.square(step[:2] + offset).sum())
            # stated variance of its horizontal position, beyond that of the aided navigator
            variances[name] = horizontal_deviation(candidate.sins.run) ** 2 - known**2
            # the variance that earlier rehearsals added must not hide a deficit of the stated one
            added = 2.0 * candidate.spread_psd(hovered(self.tally)) * _LENGTH_NS * 1e-9
            excess[name] = squares[name] - max(variances[name] - added, 0.0)
        surprise = squares[COAST] / max(variances[COAST], 1.0)
        return Outcome(squares, surprise, excess, self.tally)


Elsewhere = Callable[[Callable[[], Outcome | None]], Callable[[], Outcome | None]]
"""Submits work to another process; the returned function waits for the result."""


@dataclass
class RehearsalState:
    """The waiting samples and the times of the running rehearsal, and the results of the last ones."""

    waiting: list[Sample] = field(default_factory=list)  # samples that the copies get at the end of the epoch
    waiting_since: int = 0  # ns, IMU stamp of the first sample in ``waiting``
    next_ns: int = 0  # ns, beginning of the next rehearsal
    until_ns: int = 0  # ns, end of the running rehearsal
    squares: deque[dict[str, float]] = field(default_factory=deque)  # squared errors at the end, m^2
    surprises: deque[float] = field(default_factory=deque)  # squared error of coasting over its stated variance
    excess: deque[dict[str, float]] = field(default_factory=deque)  # squared errors minus stated variances, m^2
    hover_excess: deque[dict[str, float]] = field(default_factory=deque)  # the same, of those that hovered
    decisions: Decisions = field(default_factory=Decisions)  # sum over all finished rehearsals

    def drop(self) -> None:
        """Discard the samples that wait for the end of the epoch."""
        self.waiting, self.waiting_since = [], 0


class Rehearsals:
    """Runs rehearsals and evaluates each way through an outage."""

    def __init__(self, rules: RehearsalRules | None = None, elsewhere: Elsewhere | None = None) -> None:
        """``elsewhere`` flies each rehearsal as a whole after its end; by default it is flown here, as data arrive."""
        self._rules, self._elsewhere = rules or RehearsalRules(), elsewhere
        self._under_way: list[Callable[[], Outcome | None]] = []
        self.running: Rehearsal | None = None
        kept = self._rules.kept
        self.state = RehearsalState(
            squares=deque(maxlen=kept),
            surprises=deque(maxlen=kept),
            excess=deque(maxlen=kept),
            hover_excess=deque(maxlen=kept),
        )

    def copy(self) -> Rehearsals:
        """An independent copy, running rehearsals included."""
        self._collect()
        twin = Rehearsals(self._rules, self._elsewhere)
        twin.running = None if self.running is None else self.running.copy()
        twin.state = snapshot(self.state)
        return twin

    @property
    def count(self) -> int:
        """Number of finished rehearsals that count."""
        self._collect()
        return len(self.state.squares)

    def rms(self, name: str) -> float | None:
        """RMS error [m] at the end of the rehearsals that ``name`` flew; None without one."""
        self._collect()
        squares = [errors[name] for errors in self.state.squares if name in errors]
        return float(np.sqrt(np.mean(squares))) if squares else None

    def scores(self) -> dict[str, float]:
        """Values for diagnostics: RMS errors [m], number of rehearsals, ``drift_variance``, share of missed motion."""
        self._collect()
        names = dict.fromkeys(name for errors in self.state.squares for name in errors)
        scores = {f"rehearsal.rms_30_s.{name}": rms for name in names if (rms := self.rms(name)) is not None}
        decisions = self.decisions
        if decisions.travelled > 0.0:
            scores["rehearsal.missed"] = decisions.missed / decisions.travelled
        return scores | {"rehearsal.count": float(self.count), "rehearsal.drift_variance": self.drift_variance}

    def is_worse(self, name: str, rival: str, ratio: float) -> bool:
        """Whether the RMS error of ``name`` exceeds ``ratio`` times that of ``rival``, in enough rehearsals of both."""
        self._collect()
        both = [errors for errors in self.state.squares if name in errors and rival in errors]
        return len(both) >= self._rules.least and sum(e[name] for e in both) > ratio**2 * sum(e[rival] for e in both)

    @property
    def drift_variance(self) -> float:
        """Squared error of coasting over the variance that the filter states, at most 1; 1 while unknown.

        A filter that is tuned for a poor receiver states too large an error of its attitude when the receiver is good.
        Without this factor it would then trust the learned motion more than itself.
        """
        self._collect()
        stated, surprises = self._rules.stated, self.state.surprises
        fraction = (stated + sum(surprises)) / (stated + len(surprises))
        return min(max(fraction, self._rules.smallest_variance), 1.0)

    @property
    def decisions(self) -> Decisions:
        """Decisions between regimes, summed over all finished rehearsals."""
        self._collect()
        return self.state.decisions

    def spread(self, hovering: bool = False) -> dict[str, float]:
        """Way -> spectral density [m^2/s] that the stated variance of each horizontal position component lacks.

        ``hovering``: from the rehearsals in which the vehicle hovered.
        """
        self._collect()
        found = self.state.hover_excess if hovering else self.state.excess
        spread = {}
        for name in dict.fromkeys(name for excess in found for name in excess):
            excess = [one[name] for one in found if name in one]
            lacking = max(sum(excess), 0.0) / (self._rules.enough + len(excess))
            spread[name] = 0.5 * lacking / (_LENGTH_NS * 1e-9)
        return spread

    def feed(self, sample: Sample) -> None:
        """Pass a sample to the copies, unless it comes from GNSS."""
        if self.running is None or isinstance(sample, _FROM_GNSS):
            return
        self.state.waiting.append(sample)
        if isinstance(sample, (ImuSample, ImuBlock)):
            stamp = sample.stamp_ns if isinstance(sample, ImuSample) else int(sample.stamps_ns[-1])
            self.state.waiting_since = self.state.waiting_since or stamp
            if not 0 <= stamp - self.state.waiting_since <= _LONGEST_WAIT_NS:
                self._catch_up(self.running)

    def is_due(self, stamp_ns: int, sins: SinsEngine) -> bool:
        """Whether ``start`` is to be called. Called several times a second after ``feed``; evaluates what has ended."""
        running, is_aided = self.running, sins.mode is Mode.AIDED
        if running is None:
            return is_aided and not self.state.next_ns - _PERIOD_NS <= stamp_ns < self.state.next_ns
        truth, run = sins.run.settled.nav, sins.run
        self._catch_up(running, (float(truth[at.VEL]), float(truth[at.VEL + 1])))
        if not is_aided or running.has_restarted:
            self.break_off()
        elif stamp_ns >= self.state.until_ns:
            judge = partial(running.outcome, truth.copy(), run.gnss.offset, horizontal_deviation(run))
            self.break_off()
            self._under_way.append(judge if self._elsewhere is None else self._elsewhere(judge))
            if self._elsewhere is None:
                self._collect()
        return False

    def start(self, stamp_ns: int, sins: SinsEngine, collector: EpochCollector, ways: Mapping[str, Guide]) -> None:
        """Begin a rehearsal of coasting and of every way in ``ways``."""
        self.break_off()
        coasting = Candidate(_copy_of(sins), EpochCollector(), None)
        self.running = Rehearsal({COAST: coasting}, ways, snapshot(collector))
        self.state.until_ns, self.state.next_ns = stamp_ns + _LENGTH_NS, stamp_ns + _PERIOD_NS

    def break_off(self) -> None:
        """Abort the running rehearsal, if any, without a result."""
        self.running = None
        self.state.drop()

    def _collect(self) -> None:
        """Take the results of finished rehearsals; wherever these were flown, they count from the same time on."""
        under_way, self._under_way = self._under_way, []
        for result in under_way:
            outcome = result()
            if outcome is not None:
                self.state.surprises.append(outcome.surprise)
                self.state.squares.append(outcome.squares)
                self.state.excess.append(outcome.excess)
                if hovered(outcome.decisions):
                    self.state.hover_excess.append(outcome.excess)
                self.state.decisions = self.state.decisions + outcome.decisions

    def _catch_up(self, running: Rehearsal, velocity: tuple[float, float] | None = None) -> None:
        """Fly the copies over the waiting samples; together these cost a quarter of what they would one by one."""
        running.epochs.append(Epoch(self.state.waiting, velocity))
        self.state.drop()
        if self._elsewhere is None:
            running.fly()


def _copy_of(sins: SinsEngine) -> SinsEngine:
    """A copy of the navigator that continues without GNSS; it needs no past, as no fix will make it go back."""
    twin = sins.snapshot()
    twin.run.past.forget()
    return twin


def _flown(candidates: Mapping[str, Candidate], epoch: Epoch, tally: Decisions) -> Decisions:
    """Fly the copies over an epoch; returns ``tally`` with the decisions of the epoch added.

    Other samples are fed ahead of the IMU's: an observation acts at its own time, however early it is known.
    """
    imu = [sample for sample in epoch.samples if isinstance(sample, (ImuSample, ImuBlock))]
    ahead: list[Sample] = [sample for sample in epoch.samples if not isinstance(sample, (ImuSample, ImuBlock))]
    for sample in [*ahead, joined(imu)] if imu else ahead:
        for candidate in candidates.values():
            candidate.feed(sample)
    return tally + _decided(epoch.velocity, candidates)


def hovered(decisions: Decisions) -> bool:
    """Whether the vehicle hovered during a rehearsal, by its RMS speed where the regimes were distinguished."""
    return decisions.travelled < 0.5 * SLOW**2 * _LENGTH_NS * 1e-9


def _decided(velocity: tuple[float, float] | None, candidates: Mapping[str, Candidate]) -> Decisions:
    """Decisions of one epoch at the true ``velocity``, by the last of the copies that distinguishes regimes."""
    square = 0.0 if velocity is None else 0.5 * (velocity[0] ** 2 + velocity[1] ** 2)
    if 2.0 * square < SLOW**2:
        return Decisions()
    for candidate in reversed(list(candidates.values())):
        branches = candidate.sins.run.timeline.filter.branches
        if branches is not None and HOVER in branches.names:
            return Decisions(PERIOD * square, PERIOD * square * branches.probability(HOVER))
    return Decisions()
