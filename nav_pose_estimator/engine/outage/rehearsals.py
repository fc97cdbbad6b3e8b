"""No regret: outages are rehearsed while GNSS is good, and help that did not help in rehearsal is not used.

Every minute copies of the navigator fly half a minute without GNSS on the live data: one coasts, the others are helped,
each in its own way. Afterwards all are compared with the aided navigator. A rehearsal begins with what had been learned
by then, so its outage is held back from the learning. Only the past decides about the next outage.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from nav_pose_estimator.core.earth.ellipsoid import step_enu
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.numerics.snapshot import snapshot
from nav_pose_estimator.engine.navigator.modes import DENIED
from nav_pose_estimator.engine.navigator.sins import SinsEngine
from nav_pose_estimator.engine.navigator.status import horizontal_deviation
from nav_pose_estimator.engine.outage.epochs import EpochCollector, last_stamp
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
_LONGEST_WAIT_NS = 2_000_000_000  # four epochs: only where the navigator has no solution that would end one
_FROM_GNSS = (GnssFix, GnssVelocity, SatelliteCount, SetPose, ReturnDecision)


@dataclass
class Contestant:
    """One way through the outage: a navigator of its own, and what helps it."""

    sins: SinsEngine
    collector: EpochCollector
    guide: Guide | None

    def copy(self) -> Contestant:
        """An independent copy."""
        return Contestant(self.sins.snapshot(), snapshot(self.collector), self.guide)

    def feed(self, sample: Sample) -> None:
        """Fly on, and take in what the motion says."""
        for output in self.sins.feed(sample):
            if self.guide is None or not isinstance(output, (NavBlock, NavSolution)):
                continue
            if self.collector.feed(output) is not None:
                for said in self.guide.advise(last_stamp(output), self.collector.recent).samples:
                    self.sins.feed(said)


@dataclass
class RehearsalState:
    """What the contestants still have to fly, when the rehearsal ends, and what the last ones have shown."""

    waiting: list[Sample] = field(default_factory=list)  # what the copies get at the end of the epoch
    waiting_since: int = 0  # ns, IMU stamp
    next_ns: int = 0
    until_ns: int = 0
    squares: deque[dict[str, float]] = field(default_factory=deque)  # errors at the end, m^2
    surprises: deque[float] = field(default_factory=deque)  # squared error of coasting over its stated variance


class Rehearsals:
    """Rehearsals of an outage and what they say about each kind of help."""

    def __init__(self, rules: RehearsalRules | None = None) -> None:
        self._rules = rules or RehearsalRules()
        kept = self._rules.kept
        self.contestants: dict[str, Contestant] = {}
        self.state = RehearsalState(squares=deque(maxlen=kept), surprises=deque(maxlen=kept))

    def copy(self) -> Rehearsals:
        """An independent copy, running rehearsals included."""
        twin = Rehearsals(self._rules)
        twin.contestants = {name: contestant.copy() for name, contestant in self.contestants.items()}
        twin.state = snapshot(self.state)
        return twin

    @property
    def count(self) -> int:
        """Number of finished rehearsals that count."""
        return len(self.state.squares)

    def rms(self, name: str) -> float | None:
        """RMS error [m] at the end of the rehearsals that ``name`` flew; None without one."""
        squares = [errors[name] for errors in self.state.squares if name in errors]
        return float(np.sqrt(np.mean(squares))) if squares else None

    def scores(self) -> dict[str, float]:
        """What diagnostics show: RMS errors [m] of every way, how many rehearsals count, and ``drift_variance``."""
        names = dict.fromkeys(name for errors in self.state.squares for name in errors)
        scores = {f"rehearsal.rms_30_s.{name}": rms for name in names if (rms := self.rms(name)) is not None}
        return scores | {"rehearsal.count": float(self.count), "rehearsal.drift_variance": self.drift_variance}

    def is_worse(self, name: str, rival: str, ratio: float) -> bool:
        """True when three or more rehearsals that both flew say: ``name`` errs more than ``ratio`` times ``rival``."""
        both = [errors for errors in self.state.squares if name in errors and rival in errors]
        return len(both) >= self._rules.least and sum(e[name] for e in both) > ratio**2 * sum(e[rival] for e in both)

    @property
    def drift_variance(self) -> float:
        """The squared errors of coasting as a fraction of the variance that the filter states, 1 while unknown.

        A filter that expects a poor receiver states a large error of its own attitude, however good the receiver is.
        Then it would believe what was learned of the motion more than itself.
        """
        stated, surprises = self._rules.stated, self.state.surprises
        fraction = (stated + sum(surprises)) / (stated + len(surprises))
        return min(max(fraction, self._rules.smallest_variance), 1.0)

    def feed(self, sample: Sample) -> None:
        """Hand a sample to the copies; nothing that comes from GNSS reaches them."""
        if not self.contestants or isinstance(sample, _FROM_GNSS):
            return
        self.state.waiting.append(sample)
        if isinstance(sample, (ImuSample, ImuBlock)):
            stamp = sample.stamp_ns if isinstance(sample, ImuSample) else int(sample.stamps_ns[-1])
            self.state.waiting_since = self.state.waiting_since or stamp
            if not 0 <= stamp - self.state.waiting_since <= _LONGEST_WAIT_NS:
                self._catch_up()

    def is_due(self, stamp_ns: int, sins: SinsEngine) -> bool:
        """Called several times a second behind ``feed``; judges what has ended. True when ``start`` is to be called."""
        self._catch_up()
        if sins.mode is not Mode.AIDED or self._has_restarted():
            self._stop()
        elif self.contestants:
            if stamp_ns >= self.state.until_ns:
                self._judge(sins)
                self._stop()
        else:
            return stamp_ns >= self.state.next_ns or stamp_ns < self.state.next_ns - _PERIOD_NS
        return False

    def start(self, stamp_ns: int, sins: SinsEngine, collector: EpochCollector, ways: Mapping[str, Guide]) -> None:
        """Begin a rehearsal of coasting and of every way in ``ways``."""
        self.contestants = {COAST: Contestant(sins.snapshot(), EpochCollector(), None)}
        for name, guide in ways.items():
            self.contestants[name] = Contestant(sins.snapshot(), snapshot(collector), guide)
        self.state.until_ns, self.state.next_ns = stamp_ns + _LENGTH_NS, stamp_ns + _PERIOD_NS

    def _judge(self, sins: SinsEngine) -> None:
        errors = {}
        truth, known = sins.run.settled.nav, horizontal_deviation(sins.run)
        for name, contestant in self.contestants.items():
            east, north, _ = step_enu(truth[at.LAT : at.VEL], contestant.sins.run.settled.nav[at.LAT : at.VEL])
            errors[name] = float(east**2 + north**2)
        stated = horizontal_deviation(self.contestants[COAST].sins.run) ** 2 - known**2
        self.state.surprises.append(errors[COAST] / max(stated, 1.0))
        self.state.squares.append(errors)

    def _has_restarted(self) -> bool:
        """A gap in the IMU data makes the copies align again, for which they lack GNSS."""
        return any(one.sins.mode not in (*DENIED, Mode.AIDED) for one in self.contestants.values())

    def _catch_up(self) -> None:
        """Fly the copies up to the last IMU sample: a quarter of the work that each sample by itself would be.

        The other samples go ahead of the IMU's: an observation acts at its own time, however early it is known.
        """
        waiting, self.state.waiting, self.state.waiting_since = self.state.waiting, [], 0
        imu = [sample for sample in waiting if isinstance(sample, (ImuSample, ImuBlock))]
        for sample in waiting:
            if not isinstance(sample, (ImuSample, ImuBlock)):
                self._fly(sample)
        if imu:
            self._fly(joined(imu))

    def _fly(self, sample: Sample) -> None:
        for contestant in self.contestants.values():
            contestant.feed(sample)

    def _stop(self) -> None:
        self.contestants.clear()
        self.state.waiting.clear()
        self.state.waiting_since = 0
