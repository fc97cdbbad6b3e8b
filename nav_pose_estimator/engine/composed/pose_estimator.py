"""The estimator of the ``pose_estimator`` node and ``replay``: attitude filter, navigator and outage aid."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from nav_pose_estimator.engine import warm_up_flight
from nav_pose_estimator.engine.attitude.engine import AttitudeEngine
from nav_pose_estimator.engine.attitude.together import feed_together
from nav_pose_estimator.engine.composed import sensor_batch
from nav_pose_estimator.engine.composed.exchange import ExchangeClock, navigator_velocity, newest_stamp
from nav_pose_estimator.engine.composed.sensor_batch import Early, SensorBatch
from nav_pose_estimator.engine.navigator import stretch
from nav_pose_estimator.engine.navigator.go_back import UNDONE
from nav_pose_estimator.engine.navigator.heading_trial import TURNED
from nav_pose_estimator.engine.navigator.modes import LEVELLING
from nav_pose_estimator.engine.navigator.sins import SinsEngine, goes_on_over
from nav_pose_estimator.engine.outage.aid import OutageAid
from nav_pose_estimator.engine.outage.epochs import last_stamp
from nav_pose_estimator.engine.outage.methods.registry import estimators
from nav_pose_estimator.engine.outage.pilot import Train
from nav_pose_estimator.engine.outage.rehearsals import Elsewhere
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import (
    AttitudeSample,
    BeamVelocitySample,
    GnssFix,
    GnssVelocity,
    ImuBlock,
    ImuSample,
    MagSample,
    NavigatorVelocity,
    PressureSample,
    Sample,
    SatelliteCount,
    VelocityError,
    joined,
)
from nav_pose_estimator.engine.sensors.magnetometer import WRONG_START
from nav_pose_estimator.engine.solutions import (
    AttitudeBlock,
    AttitudeSolution,
    Event,
    Level,
    Mode,
    NavBlock,
    NavSolution,
    Output,
    Status,
)

_ANOTHER_STATE = (WRONG_START, UNDONE, TURNED)
_BETWEEN = (GnssFix, GnssVelocity, MagSample, PressureSample, SatelliteCount, BeamVelocitySample)
"""Samples that the navigator takes together with the IMU's."""
_MANY = 8  # least number of IMU samples that the attitude filter takes together with what is between them
_EPOCH, _SECOND = 2, 4  # number of exchanges in half a second and in a second


@dataclass(frozen=True)
class Snapshot:
    """The mutable state of a ``PoseEstimator``."""

    sins: Any
    attitude: Any
    outage_aid: OutageAid | None
    clock: ExchangeClock
    levels: bool


class PoseEstimator:
    """The three estimators with direct calls between them, for the same exchanges that the nodes make over topics."""

    def __init__(
        self,
        parameters: Parameters | None = None,
        attitude: bool = True,
        train: Train | None = None,
        rehearse: Elsewhere | None = None,
    ) -> None:
        """``attitude``: False omits the attitude filter, for benchmarks of the position only.

        ``train`` and ``rehearse`` run trainings and rehearsals elsewhere (``OutageAid``); by default they run here.
        """
        self.parameters = parameters or Parameters()
        self.sins = SinsEngine(self.parameters)
        self.attitude = AttitudeEngine(self.parameters) if attitude else None
        learner = self.parameters.learner
        helps = learner.enabled and estimators()[learner.method].helps
        self.outage_aid = OutageAid(learner, train, rehearse) if helps else None
        self._clock = ExchangeClock()
        self._ahead = _EPOCH if helps else _SECOND
        # Whether the navigator gets the attitude of each sample while it levels. That begins only where every piece
        # ends, so that a navigator which starts again amid a piece gets none of its samples, however they are fed.
        self._levels = True

    def feed(self, sample: Sample) -> list[Output]:
        """Take one sample; returns solutions and events in order: attitude first, then navigation."""
        if isinstance(sample, ImuBlock):
            return [output for a, b in self._pieces(sample) for output in self._feed([_part(sample, a, b)])]
        return self._feed([sample])

    def feed_all(self, samples: Sequence[Sample]) -> list[Output]:
        """Take samples in order of arrival; the same numbers as from ``feed``, in fewer and longer blocks.

        While GNSS aids the navigator, it needs nothing from the other estimators and is processed ahead of them: by
        half a second, or by a second where no method evaluates the solution every half second. Without GNSS, and where
        ``sensor_batch`` allows it, it gets samples of magnetometer and barometer ahead of a long block instead of
        between short ones; they act at their own time.
        """
        outputs: list[Output] = []
        done = 0
        while done < len(samples):
            if stretch.is_uneventful(self.sins.run):
                count = self._gather(samples, done, outputs)
                if count:
                    done += count
                    continue
            run = self.sins.run
            waiting = [run.clock.stamp(one.t) for one in run.timeline.queue.waiting()]
            count = sensor_batch.length(samples, done, waiting, run.parameters.aids.water_density > 0.0)
            is_joined = count > 1 and self.sins.mode not in LEVELLING
            batch = SensorBatch.of(samples[done : done + count]) if is_joined else None
            if batch is not None and goes_on_over(self.sins, batch.imu):
                for a, b in self._pieces(batch.imu):
                    outputs += _take_piece(self, _part(batch.imu, a, b), batch.early(a, b))
                outputs += [output for sample in batch.after for output in self.feed(sample)]
                done += count
            else:
                outputs += self.feed(samples[done])
                done += 1
        return outputs

    def _gather(self, samples: Sequence[Sample], first: int, outputs: list[Output]) -> int:
        """Process ``samples`` from ``first`` on, as many as the navigator may process ahead, up to one of another kind
        or to a gap, behind which it may align again; returns their number."""
        waiting: list[Sample] = []
        clock, done = replace(self._clock), first
        last_ns = self.sins.run.clock.stamp(self.sins.run.now)
        while done < len(samples):
            sample = samples[done]
            if isinstance(sample, ImuBlock):
                if sample.stamps_ns[0] - last_ns > sensor_batch.STEP_NS:
                    break
                done, last_ns = done + 1, int(sample.stamps_ns[-1])
                for a, b in clock.pieces(sample, self._ahead):
                    part = _part(sample, a, b)
                    waiting.append(part)
                    if clock.is_due(part, self._ahead):
                        outputs += self._feed(waiting)
                        waiting = []
                if not waiting:
                    break
            elif isinstance(sample, _BETWEEN):
                done += 1
                waiting.append(sample)
            else:
                break
        outputs += self._feed(waiting) if waiting else []
        return done - first

    def _pieces(self, block: ImuBlock) -> Iterator[tuple[int, int]]:
        """Cuts a block for processing; a navigator that is levelling needs the attitude of each sample."""
        for a, b in self._clock.pieces(block, _EPOCH):
            alone = self.attitude is not None and self._levels
            yield from itertools.pairwise(range(a, b + 1)) if alone else ((a, b),)

    def _feed(self, samples: Sequence[Sample], early: Early = ()) -> list[Output]:
        """Take samples that the navigator may process before the attitude filter, or one block with ``early`` ones."""
        if isinstance(samples[0], VelocityError):
            if self.outage_aid is not None:
                self.outage_aid.predicted(samples[0])
            return []
        solutions = sensor_batch.feed_ahead(self.sins, samples[0], early) if early else []
        solutions += self.sins.feed(samples[0]) if len(samples) == 1 else self.sins.feed_all(samples)
        before = self._clock.period // self._ahead
        outputs = _attitudes(self.attitude, self._clock, samples, early, solutions)
        if self._levels and self.sins.mode in LEVELLING:
            solutions += [event for tilt in _tilts(outputs) for event in self.sins.feed(tilt)]
        may_end = self._clock.period // self._ahead != before
        self._levels = self.sins.mode in LEVELLING and (self._levels or may_end)
        outputs += solutions
        if self.outage_aid is not None:
            for sample in (*(other for _, other in early), *samples):
                self.outage_aid.hear(sample)
            outputs += _helped(self.outage_aid, self.sins, solutions)
        if self.attitude is not None and any(isinstance(sample, GnssFix) for sample in samples):
            self.attitude.set_declination(self.sins.run.parameters.aids.declination)
        return outputs

    @property
    def mode(self) -> Mode:
        """The navigator's mode."""
        return self.sins.mode

    @property
    def origin(self) -> tuple[float, float, float] | None:
        """Latitude, longitude [rad] and height [m] of the local frame."""
        return self.sins.origin

    def set_use_gnss(self, flag: bool) -> None:
        """Switch the use of GNSS off and on, for an outage drill."""
        self.sins.set_use_gnss(flag)

    def set_parameters(self, parameters: Parameters) -> None:
        """Take new values of the parameters that are mutable in flight."""
        self.parameters = parameters
        self.sins.set_parameters(parameters)
        if self.attitude is not None:
            self.attitude.set_parameters(parameters)

    def status(self) -> Status:
        """The navigator's status."""
        return self.sins.status()

    def reset(self, stamp_ns: int, reason: str) -> list[Output]:
        """Restart all estimators; returns the events."""
        self._clock, self._levels = ExchangeClock(), True
        if self.outage_aid is not None:
            self.outage_aid.reset()
        attitude = [] if self.attitude is None else self.attitude.reset(stamp_ns, reason)
        return attitude + self.sins.reset(stamp_ns, reason)

    def warm_up(self) -> None:
        """Compile all kernels now."""
        self.sins.warm_up()
        if self.attitude is not None:
            self.attitude.warm_up()
        warm_up_flight.warm_up(lambda: PoseEstimator(self.parameters))

    def snapshot(self) -> Snapshot:
        """A copy of the mutable state, for ``restore``."""
        return Snapshot(
            sins=self.sins.snapshot(),
            attitude=None if self.attitude is None else self.attitude.snapshot(),
            outage_aid=None if self.outage_aid is None else self.outage_aid.copy(),
            clock=replace(self._clock),
            levels=self._levels,
        )

    def restore(self, snapshot: Snapshot) -> None:
        """Restore an earlier ``snapshot``."""
        self.sins.restore(snapshot.sins)
        if self.attitude is not None and snapshot.attitude is not None:
            self.attitude.restore(snapshot.attitude)
        if self.outage_aid is not None and snapshot.outage_aid is not None:
            self.outage_aid = snapshot.outage_aid.copy()
        self._clock, self._levels = replace(snapshot.clock), snapshot.levels


def _take_piece(estimator: PoseEstimator, block: ImuBlock, early: Early) -> list[Output]:
    """Feed a piece of a batch with its ``early`` samples ahead of it, or in order where the navigator aligns again."""
    if estimator.mode not in LEVELLING:
        return estimator._feed([block], early)
    return [output for each in _in_order(block, early) for output in estimator._feed([each])]


def _attitudes(
    attitude: AttitudeEngine | None,
    clock: ExchangeClock,
    samples: Sequence[Sample],
    early: Early,
    solutions: list[Output],
) -> list[Output]:
    """Feed the attitude filter, at each exchange also the velocity from ``solutions``; returns its outputs."""
    together = None if attitude is None else _attitudes_together(attitude, clock, samples, early, solutions)
    if together is not None:
        return together
    outputs: list[Output] = []
    since_ns = exchanged_ns = done = 0
    for part in _cut(samples, clock):
        if attitude is not None and isinstance(part, (ImuBlock, ImuSample, MagSample)):
            parts: Iterable[Sample] = [part]
            if early and isinstance(part, ImuBlock):
                end = done + len(part)
                parts = _in_order(part, [(place - done, other) for place, other in early if done <= place < end])
                done = end
            # IMU events are omitted, as the navigator reports them, too
            outputs += [one for each in parts for one in attitude.feed(each) if not _is_imu_event(one)]
        if isinstance(part, (ImuBlock, ImuSample)) and clock.is_due(part) and attitude is not None:
            since_ns, exchanged_ns = max(since_ns, exchanged_ns), newest_stamp(part)
            velocity = navigator_velocity(solutions, since_ns, exchanged_ns)
            if velocity is not None:
                attitude.feed(velocity)
    return outputs


def _attitudes_together(
    attitude: AttitudeEngine,
    clock: ExchangeClock,
    samples: Sequence[Sample],
    early: Early,
    solutions: list[Output],
) -> list[Output] | None:
    """``_attitudes`` for many IMU samples at once; None where they must be fed block by block."""
    blocks, fields, count = list[ImuBlock](), list[tuple[int, MagSample]](), 0
    for sample in samples:
        if isinstance(sample, ImuBlock):
            blocks.append(sample)
            count += len(sample.stamps_ns)
        elif isinstance(sample, MagSample):
            fields.append((count, sample))
        elif isinstance(sample, ImuSample):
            return None
    if count < _MANY:
        return None
    fields += [(place, sample) for place, sample in early if isinstance(sample, MagSample)]
    imu = joined(blocks)
    velocities, exchanged_ns, now = dict[int, NavigatorVelocity](), 0, replace(clock)
    for begin, end in clock.pieces(imu):
        if now.is_due(_part(imu, begin, end)):
            since_ns, exchanged_ns = exchanged_ns, int(imu.stamps_ns[end - 1])
            velocity = navigator_velocity(solutions, since_ns, exchanged_ns)
            if velocity is not None:
                velocities[end] = velocity
    outputs = feed_together(attitude, imu, fields, velocities)
    if outputs is not None:
        clock.period = now.period
    return outputs


def _cut(samples: Sequence[Sample], clock: ExchangeClock) -> Iterator[Sample]:
    """``samples`` with IMU blocks cut behind each exchange; ``clock`` must get each part before the next is taken."""
    for sample in samples:
        if isinstance(sample, ImuBlock):
            for a, b in clock.pieces(sample):
                yield _part(sample, a, b)
        else:
            yield sample


def _helped(aid: OutageAid, sins: SinsEngine, solutions: list[Output]) -> list[Output]:
    """Pass ``solutions`` to the outage aid and, in an outage, its evidence to the navigator; returns new outputs."""
    outputs: list[Output] = []
    for solution in solutions:
        if isinstance(solution, Event) and solution.name in _ANOTHER_STATE:
            aid.reset()  # what it has learned so far is based on a wrong state
        if not isinstance(solution, (NavBlock, NavSolution)):
            continue
        samples, drift = aid.step(solution, sins)
        if wrong := aid.wrong_class():
            outputs.append(_told(sins, last_stamp(solution), wrong))
        for sample in samples:
            outputs += sins.feed(sample)
        if drift is not None:
            outputs.append(drift)
    return outputs


def _told(sins: SinsEngine, stamp_ns: int, text: str) -> Event:
    """A warning, counted in the navigator's journal."""
    event = Event(stamp_ns, "outage.class", Level.WARN, text, {})
    sins.journal.counters[event.name] += 1
    return event


def _part(block: ImuBlock, begin: int, end: int) -> ImuBlock:
    if begin == 0 and end == len(block):
        return block
    return block.part(begin, end)


def _in_order(block: ImuBlock, others: Sequence[tuple[int, Sample]]) -> Iterator[Sample]:
    """The parts of a block and, between them, the other samples where they arrived."""
    done = 0
    for place, other in others:
        if place > done:
            yield _part(block, done, place)
            done = place
        yield other
    yield _part(block, done, len(block))


def _tilts(outputs: list[Output]) -> Iterator[AttitudeSample]:
    """Attitudes of the filter as samples for an aligning navigator, which uses their tilt and its deviation."""
    for output in outputs:
        if isinstance(output, AttitudeSolution):
            yield AttitudeSample(output.stamp_ns, tuple(output.q_nb.tolist()), output.cov_n)
        elif isinstance(output, AttitudeBlock):
            for stamp, q_nb, tilt_sd, yaw_sd in zip(
                output.stamps_ns.tolist(), output.q_nb.tolist(), output.tilt_sd, output.yaw_sd, strict=True
            ):
                yield AttitudeSample(stamp, tuple(q_nb), np.diag([tilt_sd**2, tilt_sd**2, yaw_sd**2]))


def _is_imu_event(output: Output) -> bool:
    return isinstance(output, Event) and output.name.startswith("imu.")
