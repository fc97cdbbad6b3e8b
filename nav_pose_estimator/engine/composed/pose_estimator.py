"""Attitude filter, navigator and learner composed: what the ``pose_estimator`` node and ``replay`` run."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.numerics.imu_checks import stays_in_period
from nav_pose_estimator.engine import warm_up_flight
from nav_pose_estimator.engine.attitude.engine import AttitudeEngine
from nav_pose_estimator.engine.composed import sensor_batch
from nav_pose_estimator.engine.composed.sensor_batch import SensorBatch
from nav_pose_estimator.engine.navigator.modes import LEVELLING
from nav_pose_estimator.engine.navigator.sins import SinsEngine
from nav_pose_estimator.engine.outage.aid import OutageAid
from nav_pose_estimator.engine.outage.methods.registry import estimators
from nav_pose_estimator.engine.outage.pilot import Train
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import (
    AttitudeSample,
    GnssFix,
    ImuBlock,
    ImuSample,
    MagSample,
    MotionEvidence,
    NavigatorVelocity,
    Sample,
    VelocityError,
)
from nav_pose_estimator.engine.solutions import (
    AttitudeBlock,
    AttitudeSolution,
    Event,
    Mode,
    NavBlock,
    NavSolution,
    Output,
    Status,
)

_GOOD_TILT = 0.05  # rad: about what manoeuvres cost the attitude filter on its own
_EXCHANGE_NS = 250_000_000
"""The estimators talk to each other at the first IMU sample of every such period, whatever the size of the blocks."""


class PoseEstimator:
    """The three estimators with direct calls between them: the same exchanges that the nodes make over topics."""

    def __init__(self, parameters: Parameters | None = None, attitude: bool = True, train: Train | None = None) -> None:
        """``attitude`` False leaves the attitude filter out (benchmarks that look at the position only).

        ``train`` carries out training jobs elsewhere (``OutageAid``); by default they run here, at once.
        """
        self.parameters = parameters or Parameters()
        self.sins = SinsEngine(self.parameters)
        self.attitude = AttitudeEngine(self.parameters) if attitude else None
        learner = self.parameters.learner
        helps = learner.enabled and estimators()[learner.method].helps
        self.outage_aid = OutageAid(learner, train) if helps else None
        self._period = 0

    def feed(self, sample: Sample) -> list[Output]:
        """Take one sample; returns solutions and events in order: attitude first, then navigation."""
        if isinstance(sample, ImuBlock):
            return [output for a, b in self._pieces(sample) for output in self._feed(_part(sample, a, b))]
        return self._feed(sample)

    def feed_all(self, samples: Sequence[Sample]) -> list[Output]:
        """Take samples in the order in which they arrived: the numbers of ``feed``, in fewer and longer blocks.

        Where ``sensor_batch`` allows it, the navigator hears of magnetometer and barometer ahead of a long block
        instead of between short ones; they act at their own time.
        """
        outputs: list[Output] = []
        done = 0
        while done < len(samples):
            count = sensor_batch.length(samples, done)
            batch, done = samples[done : done + count], done + count
            if count > 1 and self.sins.mode not in LEVELLING:
                outputs += self._feed_batch(SensorBatch.of(batch))
            else:
                outputs += [output for sample in batch for output in self.feed(sample)]
        return outputs

    def _feed_batch(self, batch: SensorBatch) -> list[Output]:
        outputs: list[Output] = []
        for begin, end in self._pieces(batch.imu):
            outputs += self._feed(_part(batch.imu, begin, end), batch.early(begin, end))
        return outputs + [output for sample in batch.after for output in self._feed(sample)]

    def _pieces(self, block: ImuBlock) -> Iterator[tuple[int, int]]:
        """Where to cut: behind each sample at which the estimators talk. Blocks so give what single samples give."""
        count = len(block)
        if self.attitude is not None and self.sins.mode in LEVELLING:
            return itertools.pairwise(range(count + 1))
        if stays_in_period(block.stamps_ns, self._period, _EXCHANGE_NS):
            return iter([(0, count)])
        periods = block.stamps_ns // _EXCHANGE_NS
        ends = np.flatnonzero(periods[1:] != periods[:-1]) + 2
        cuts = [0, *([1] if periods[0] != self._period else []), *ends.tolist(), count]
        if cuts[-2] >= count:
            del cuts[-2]
        return itertools.pairwise(cuts)

    def _feed(self, sample: Sample, early: Sequence[tuple[int, Sample]] = ()) -> list[Output]:
        """Take one sample; ``early`` came behind so many IMU samples of it, but the navigator hears of them first."""
        if isinstance(sample, VelocityError):
            if self.outage_aid is not None:
                self.outage_aid.predicted(sample)
            return []
        outputs: list[Output] = []
        if self.attitude is not None and isinstance(sample, (ImuSample, ImuBlock, MagSample)):
            # what the attitude filter says of the IMU the navigator says as well: told once
            for part in _in_order(sample, early) if isinstance(sample, ImuBlock) else (sample,):
                outputs += [o for o in self.attitude.feed(part) if not _is_imu_event(o)]
        solutions = [event for _, other in early for event in self.sins.feed(other)]
        solutions += self.sins.feed(sample)
        if self.sins.mode in LEVELLING:
            solutions += [event for tilt in _tilts(outputs) for event in self.sins.feed(tilt)]
        outputs += solutions
        if self.outage_aid is not None:
            for _, other in early:
                self.outage_aid.hear(other)
            self.outage_aid.hear(sample)
            outputs += self._help(self.outage_aid, solutions)
        if isinstance(sample, (ImuSample, ImuBlock)) and self._is_time_to_talk(sample):
            self._exchange(solutions)
        if self.attitude is not None and isinstance(sample, GnssFix):
            self.attitude.set_declination(self.sins.declination)
        return outputs

    def _help(self, outage_aid: OutageAid, solutions: list[Output]) -> list[Output]:
        """Show the solution to what learns from it; in an outage let the navigator hear what it says."""
        outputs: list[Output] = []
        for solution in solutions:
            if not isinstance(solution, (NavBlock, NavSolution)):
                continue
            said, drift = outage_aid.step(solution, self.sins)
            for sample in said:
                outputs += self.sins.feed(sample)
                if isinstance(sample, MotionEvidence) and sample.air_velocity is not None:
                    self.sins.journal.count("outage.evidence.network")
            if drift is not None:
                outputs.append(drift)
        return outputs

    def _is_time_to_talk(self, sample: ImuSample | ImuBlock) -> bool:
        stamp = sample.stamp_ns if isinstance(sample, ImuSample) else int(sample.stamps_ns[-1])
        period, self._period = self._period, stamp // _EXCHANGE_NS
        return self._period != period

    def _exchange(self, solutions: list[Output]) -> None:
        """The navigator's newest velocity for the attitude filter."""
        moved = [o for o in solutions if isinstance(o, (NavBlock, NavSolution))]
        if moved:
            self._share_velocity(moved[-1])

    def _share_velocity(self, output: NavBlock | NavSolution) -> None:
        if self.attitude is None:
            return
        if isinstance(output, NavSolution):
            stamp, velocity, q_nb, tilt_var = output.stamp_ns, output.vel_n, output.q_nb, np.diag(output.cov)[:2]
        else:
            stamp, last = int(output.stamps_ns[-1]), output.rows[-1]
            velocity, q_nb = last[at.OUT_VEL : at.OUT_QUAT], last[at.OUT_QUAT : at.OUT_RATE]
            tilt_var = last[at.OUT_VAR : at.OUT_VAR + 2]
        aided = output.mode is Mode.AIDED
        valid = aided or float(tilt_var.max()) < _GOOD_TILT**2
        sample = NavigatorVelocity(stamp, tuple(velocity.tolist()), valid, tuple(q_nb.tolist()), drifting=not aided)
        self.attitude.feed(sample)

    @property
    def mode(self) -> Mode:
        """How things stand with the navigator."""
        return self.sins.mode

    @property
    def origin(self) -> tuple[float, float, float] | None:
        """Latitude, longitude [rad] and height [m] of the local frame."""
        return self.sins.origin

    def set_use_gnss(self, flag: bool) -> None:
        """Switch GNSS off and on again (outage drill)."""
        self.sins.set_use_gnss(flag)

    def set_parameters(self, parameters: Parameters) -> None:
        """Change what is marked mutable in flight."""
        self.parameters = parameters
        self.sins.set_parameters(parameters)
        if self.attitude is not None:
            self.attitude.set_parameters(parameters)

    def status(self) -> Status:
        """The navigator's status."""
        return self.sins.status()

    def reset(self, stamp_ns: int, reason: str) -> list[Output]:
        """Start again."""
        self._period = 0
        if self.outage_aid is not None:
            self.outage_aid.reset()
        attitude = [] if self.attitude is None else self.attitude.reset(stamp_ns, reason)
        return attitude + self.sins.reset(stamp_ns, reason)

    def warm_up(self) -> None:
        """Compile every kernel now."""
        self.sins.warm_up()
        if self.attitude is not None:
            self.attitude.warm_up()
        warm_up_flight.warm_up(lambda: PoseEstimator(self.parameters))

    def snapshot(self) -> Any:
        """Everything that changes, to be given to ``restore``."""
        attitude = None if self.attitude is None else self.attitude.snapshot()
        outage_aid = None if self.outage_aid is None else self.outage_aid.copy()
        return self.sins.snapshot(), attitude, outage_aid, self._period

    def restore(self, snapshot: Any) -> None:
        """Go back to an earlier ``snapshot``."""
        sins, attitude, outage_aid, self._period = snapshot
        if self.outage_aid is not None and outage_aid is not None:
            self.outage_aid = outage_aid.copy()
        self.sins.restore(sins)
        if self.attitude is not None and attitude is not None:
            self.attitude.restore(attitude)


def _part(block: ImuBlock, begin: int, end: int) -> ImuBlock:
    if begin == 0 and end == len(block):
        return block
    return block.part(begin, end)


def _in_order(block: ImuBlock, others: Sequence[tuple[int, Sample]]) -> Iterator[Sample]:
    """A block in parts, with the other samples where they arrived."""
    done = 0
    for place, other in others:
        if place > done:
            yield _part(block, done, place)
            done = place
        yield other
    yield _part(block, done, len(block))


def _tilts(outputs: list[Output]) -> Iterator[AttitudeSample]:
    """The attitudes of a filter, for a navigator that aligns: what it takes from them is the tilt and its deviation."""
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
