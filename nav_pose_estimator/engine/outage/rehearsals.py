"""Rehearsals of outages while GNSS is good: a way through an outage that was worse than coasting is not used.

Every minute, a copy of the navigator flies half a minute of live data without GNSS (``rehearsal``): one of its filters
coasts, the others are aided, each in its own way. At the end all are compared with the aided navigator. A rehearsal
uses the models as they were at its beginning, so that its data are held out from training, and only past rehearsals
decide about the next outage.

Rehearsals also show the ratio of the drift to the stated covariance, the variance that the stated position of each way
lacks, and how often a travelling vehicle is taken to hover.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.motion.regimes import Decisions
from nav_pose_estimator.core.numerics.snapshot import snapshot
from nav_pose_estimator.engine.navigator.sins import SinsEngine
from nav_pose_estimator.engine.navigator.status import horizontal_deviation
from nav_pose_estimator.engine.outage.epochs import EpochCollector
from nav_pose_estimator.engine.outage.methods.method import Guide, RehearsalRules
from nav_pose_estimator.engine.outage.rehearsal import LENGTH_NS, Epoch, Outcome, Rehearsal, hovered
from nav_pose_estimator.engine.samples import (
    GnssFix,
    GnssVelocity,
    ImuBlock,
    ImuSample,
    ReturnDecision,
    Sample,
    SatelliteCount,
    SetPose,
)
from nav_pose_estimator.engine.solutions import Mode

_PERIOD_NS = 60_000_000_000
_LONGEST_WAIT_NS = 2_000_000_000  # four epochs; reached only where no solution of the navigator ends an epoch
_FROM_GNSS = (GnssFix, GnssVelocity, SatelliteCount, SetPose, ReturnDecision)

Elsewhere = Callable[[Callable[[], Outcome | None]], Callable[[], Outcome | None]]
"""Submits work to another process; the returned function waits for the result."""


def at_its_end(work: Callable[[], Outcome | None]) -> Callable[[], Outcome | None]:
    """An ``Elsewhere`` in this process: costs less than as data arrive, but a node cannot stop that long."""
    outcome = work()
    return lambda: outcome


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
            spread[name] = 0.5 * lacking / (LENGTH_NS * 1e-9)
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
        self.running = Rehearsal.of(sins, collector, ways)
        self.state.until_ns, self.state.next_ns = stamp_ns + LENGTH_NS, stamp_ns + _PERIOD_NS

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
        running.epochs.append(Epoch.of(self.state.waiting, velocity))
        self.state.drop()
        if self._elsewhere is None:
            running.fly()
