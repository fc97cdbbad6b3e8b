"""The aided pass of a flight with forced outages, which stops at the start of each outage."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from nav_pose_estimator.engine.composed.pose_estimator import Snapshot
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import GnssFix, GnssVelocity, ImuBlock, Sample
from nav_pose_estimator.engine.solutions import Mode, NavBlock, NavSolution, Status
from nav_pose_estimator.offline.benchmarks.outage.shared_flight import SharedFlight
from nav_pose_estimator.offline.flights.outages import GnssLeak, Outage
from nav_pose_estimator.offline.flights.recording import Recording
from nav_pose_estimator.offline.replay.replay import as_block

_AHEAD_NS = 10**9  # lead of a stamp over the IMU from which it is damaged, so that the navigator rejects it
_BATCH_NS = 10**9  # duration of a batch


@dataclass(frozen=True)
class Start:
    """The start of an outage: the estimators, and the position in the stream to continue from."""

    outage: Outage
    snapshots: list[Snapshot]  # for each method
    index: int
    row: int
    doubt: str  # the navigator's doubt about its pose; empty if there is none
    state: np.ndarray | None  # last row of the solution, OUT_COLUMNS
    lag_one: tuple[float, float]  # autocorrelation of the last innovations, position and velocity


def aided_pass(recording: Recording, parameters: Sequence[Parameters], runs: list[Outage]) -> Iterator[Start]:
    """Run the whole flight with GNSS and stop at the start of each outage."""
    flight = SharedFlight(parameters)
    state = None
    waiting, ahead = list(runs), Batch()
    delay_ns = round(parameters[0].gnss.delay * 1e9)
    newest_gnss = 0
    samples = recording.held
    next_imu = _next_imu_stamps(samples)
    for index, sample in enumerate(samples):
        if not waiting:
            return
        done = 0
        while waiting:
            start_ns = recording.epoch_ns + round(waiting[0].start * 1e9)
            row = _first_at(sample, start_ns, delay_ns, next_imu[index])
            if row is None:
                break
            if newest_gnss >= start_ns:
                raise GnssLeak("GNSS from inside an outage was used before it")
            if row > done:
                ahead.add(part_of(sample, done, row))
            state = _last_row(flight.engine.feed_all(ahead.take()), state)
            done = row
            status = flight.engine.status()
            yield Start(waiting.pop(0), flight.snapshots(), index, done, _doubt(status), state, _lag_one(status))
        if ahead.add(part_of(sample, done, None)):
            state = _last_row(flight.engine.feed_all(ahead.take()), state)
        if isinstance(sample, (GnssFix, GnssVelocity)) and sample.stamp_ns <= next_imu[index] + _AHEAD_NS:
            newest_gnss = max(newest_gnss, sample.stamp_ns - delay_ns)


class Batch:
    """Samples that are fed together, because long blocks cost less with the same result."""

    def __init__(self) -> None:
        self._samples: list[Sample] = []
        self._until = 0  # ns

    def add(self, sample: Sample) -> bool:
        """Add a sample; True if the batch is about a second long and ``take`` is due."""
        self._samples.append(sample)
        if not isinstance(sample, ImuBlock) or not len(sample):
            return False
        last = int(sample.stamps_ns[-1])
        if not self._until - 2 * _BATCH_NS < last < self._until:  # also after a clock that went back
            self._until = last + _BATCH_NS
            return True
        return False

    def take(self) -> list[Sample]:
        """Remove and return the samples."""
        samples, self._samples = self._samples, []
        return samples


def _lag_one(status: Status) -> tuple[float, float]:
    figures = [status.values.get(f"innovation.{name}.lag_1", np.nan) for name in ("gnss_position", "gnss_velocity")]
    return float(figures[0]), float(figures[1])


def _doubt(status: Status) -> str:
    """Reason why an outage that starts now cannot be evaluated, by the navigator's status; empty if it is aided."""
    if status.mode is Mode.AIDED:
        return status.gnss_refusal or status.doubt
    return status.waiting_for or status.gnss_refusal or status.mode.value.lower()


def _next_imu_stamps(samples: list[Sample]) -> list[int]:
    """Stamp of the IMU sample that follows each sample, or of the last one: the time at which the sample arrives."""
    stamps, now = [0] * len(samples), 0
    for i in range(len(samples) - 1, -1, -1):
        sample = samples[i]
        stamps[i] = now or int(getattr(sample, "stamps_ns", [0])[-1])
        if isinstance(sample, ImuBlock) and len(sample):
            now = int(sample.stamps_ns[0])
    return stamps


def _first_at(sample: Sample, start_ns: int, delay_ns: int, next_imu_ns: int) -> int | None:
    """Row of ``sample`` at which the outage begins; None if it begins later."""
    if isinstance(sample, ImuBlock):
        row = int(np.searchsorted(sample.stamps_ns, start_ns))
        return row if row < len(sample) else None
    if sample.stamp_ns is None:
        return None
    # GNSS with a negative latency is valid after its stamp. A stamp far ahead of the next IMU sample is damaged and
    # does not begin an outage, but one after a gap of the IMU is not damaged.
    time_ns = sample.stamp_ns - min(delay_ns, 0) * isinstance(sample, (GnssFix, GnssVelocity))
    return 0 if start_ns <= time_ns <= next_imu_ns + _AHEAD_NS else None


def part_of(sample: Sample, first: int, last: int | None) -> Sample:
    """Rows ``first`` to ``last`` (None: the last one) of an IMU block; other samples are unchanged."""
    if not isinstance(sample, ImuBlock) or (first == 0 and last is None):
        return sample
    return sample.part(first, last)


def _last_row(outputs: list, before: np.ndarray | None) -> np.ndarray | None:
    for output in reversed(outputs):
        if isinstance(output, NavBlock):
            return output.rows[-1]
        if isinstance(output, NavSolution):
            return as_block(output).rows[-1]
    return before
