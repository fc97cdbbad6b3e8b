"""No regret: outages are rehearsed while GNSS is good, and help that did not help in rehearsal is not used.

Every minute copies of the navigator fly half a minute without GNSS on the live data: one coasts, the others are helped,
each in its own way. Afterwards all are compared with the aided navigator. A rehearsal begins with what had been learned
by then, so its outage is held back from the learning. Only the past decides about the next outage.
"""

from __future__ import annotations

import copy
from collections import deque
from dataclasses import dataclass

import numpy as np

from nav_pose_estimator.core.earth.ellipsoid import step_enu
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.engine.navigator.modes import DENIED
from nav_pose_estimator.engine.navigator.sins import SinsEngine
from nav_pose_estimator.engine.outage.epochs import EpochCollector, last_stamp
from nav_pose_estimator.engine.outage.habits import MotionKnowledge
from nav_pose_estimator.engine.samples import (
    GnssFix,
    GnssVelocity,
    ImuBlock,
    ImuSample,
    Sample,
    SatelliteCount,
    SetPose,
    joined,
)
from nav_pose_estimator.engine.solutions import Mode, NavBlock, NavSolution

COAST = "coast"
_LENGTH_NS = 30_000_000_000
_PERIOD_NS = 60_000_000_000
_KEPT = 6  # rehearsals that count
_STATED = 2.0  # rehearsals that the filter's own covariance is worth
_SMALLEST_VARIANCE = 0.05  # parts of what the filter states; more than stated is for the innovations to say
_LEAST = 3  # with fewer, chance decides
_LONGEST_WAIT_NS = 2_000_000_000  # four epochs: only where the navigator has no solution that would end one
_FROM_GNSS = (GnssFix, GnssVelocity, SatelliteCount, SetPose)


@dataclass
class Contestant:
    """One way through the outage: a navigator of its own, and what helps it."""

    sins: SinsEngine
    collector: EpochCollector
    knowledge: MotionKnowledge | None

    def copy(self) -> Contestant:
        """An independent copy."""
        return Contestant(self.sins.snapshot(), self.collector.copy(), self.knowledge)

    def feed(self, sample: Sample) -> None:
        """Fly on, and take in what the motion says."""
        for output in self.sins.feed(sample):
            if self.knowledge is None or not isinstance(output, (NavBlock, NavSolution)):
                continue
            if self.collector.feed(output) is not None:
                evidence, _ = self.knowledge.evidence(last_stamp(output), np.array(self.collector.recent))
                if evidence is not None:
                    self.sins.feed(evidence)


class VirtualOutages:
    """Rehearsals of an outage and what they say of each way to be helped."""

    def __init__(self) -> None:
        self._contestants: dict[str, Contestant] = {}
        self._waiting: list[Sample] = []  # what the copies get at the end of the epoch, all IMU samples as one block
        self._waiting_since = 0  # ns, IMU stamp
        self._next_ns = 0
        self._until_ns = 0
        self._squares: deque[dict[str, float]] = deque(maxlen=_KEPT)  # errors at the end, m^2
        self._surprises: deque[float] = deque(maxlen=_KEPT)  # squared errors of coasting in parts of what was stated

    def copy(self) -> VirtualOutages:
        """An independent copy, running rehearsals included."""
        twin = copy.copy(self)
        twin._contestants = {name: contestant.copy() for name, contestant in self._contestants.items()}
        twin._squares = self._squares.copy()
        twin._surprises = self._surprises.copy()
        twin._waiting = self._waiting.copy()
        return twin

    @property
    def rehearsals(self) -> int:
        """Number of finished rehearsals that count."""
        return len(self._squares)

    def rms(self, name: str) -> float | None:
        """RMS error [m] at the end of the rehearsals that ``name`` flew; None without one."""
        squares = [errors[name] for errors in self._squares if name in errors]
        return float(np.sqrt(np.mean(squares))) if squares else None

    def is_worse(self, name: str, rival: str, ratio: float) -> bool:
        """True when three or more rehearsals that both flew say: ``name`` errs more than ``ratio`` times ``rival``."""
        both = [errors for errors in self._squares if name in errors and rival in errors]
        return len(both) >= _LEAST and sum(e[name] for e in both) > ratio**2 * sum(e[rival] for e in both)

    @property
    def drift_variance(self) -> float:
        """How large the squared errors of coasting are in parts of what the filter states, 1 while that is unknown.

        A filter that expects a poor receiver thinks little of its own attitude, however good the receiver is. Then it
        would believe what was learned of the motion more than itself.
        """
        parts = (_STATED + sum(self._surprises)) / (_STATED + len(self._surprises))
        return min(max(parts, _SMALLEST_VARIANCE), 1.0)

    def feed(self, sample: Sample) -> None:
        """Hand a sample to the copies; nothing that comes from GNSS reaches them."""
        if not self._contestants or isinstance(sample, _FROM_GNSS):
            return
        self._waiting.append(sample)
        if isinstance(sample, (ImuSample, ImuBlock)):
            stamp = sample.stamp_ns if isinstance(sample, ImuSample) else int(sample.stamps_ns[-1])
            self._waiting_since = self._waiting_since or stamp
            if not 0 <= stamp - self._waiting_since <= _LONGEST_WAIT_NS:
                self._catch_up()

    def is_due(self, stamp_ns: int, sins: SinsEngine) -> bool:
        """Called several times a second behind ``feed``; judges what has ended. True when ``start`` is to be called."""
        self._catch_up()
        if sins.mode is not Mode.AIDED or self._has_restarted():
            self._stop()
        elif self._contestants:
            if stamp_ns >= self._until_ns:
                self._judge(sins)
                self._stop()
        else:
            return stamp_ns >= self._next_ns or stamp_ns < self._next_ns - _PERIOD_NS
        return False

    def start(
        self, stamp_ns: int, sins: SinsEngine, collector: EpochCollector, ways: dict[str, MotionKnowledge]
    ) -> None:
        """Begin a rehearsal of coasting and of every way in ``ways``."""
        self._contestants = {COAST: Contestant(sins.snapshot(), EpochCollector(), None)}
        for name, knowledge in ways.items():
            self._contestants[name] = Contestant(sins.snapshot(), collector.copy(), knowledge)
        self._until_ns, self._next_ns = stamp_ns + _LENGTH_NS, stamp_ns + _PERIOD_NS

    def _judge(self, sins: SinsEngine) -> None:
        errors = {}
        truth, known = sins.nominal_state(), sins.horizontal_sd
        for name, contestant in self._contestants.items():
            east, north, _ = step_enu(truth[at.LAT : at.VEL], contestant.sins.nominal_state()[at.LAT : at.VEL])
            errors[name] = float(east**2 + north**2)
        stated = self._contestants[COAST].sins.horizontal_sd ** 2 - known**2
        self._surprises.append(errors[COAST] / max(stated, 1.0))
        self._squares.append(errors)

    def _has_restarted(self) -> bool:
        """A gap in the IMU data makes the copies align again, for which they lack GNSS."""
        return any(one.sins.mode not in (*DENIED, Mode.AIDED) for one in self._contestants.values())

    def _catch_up(self) -> None:
        """Fly the copies up to the last IMU sample: a quarter of the work that each sample by itself would be.

        The other samples go ahead of the IMU's: an observation acts at its own time, however early it is known.
        """
        waiting, self._waiting, self._waiting_since = self._waiting, [], 0
        imu = [sample for sample in waiting if isinstance(sample, (ImuSample, ImuBlock))]
        for sample in waiting:
            if not isinstance(sample, (ImuSample, ImuBlock)):
                self._fly(sample)
        if imu:
            self._fly(joined(imu))

    def _fly(self, sample: Sample) -> None:
        for contestant in self._contestants.values():
            contestant.feed(sample)

    def _stop(self) -> None:
        self._contestants.clear()
        self._waiting.clear()
        self._waiting_since = 0
