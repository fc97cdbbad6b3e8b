"""Replay of a recording with the engine of the nodes, without middleware, as fast as possible."""

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from nav_pose_estimator.core.filter.layout import (
    BASE_STATES,
    D_ACCEL_BIAS,
    D_GYRO_BIAS,
    OUT_COLUMNS,
    SOLUTION_BIASES,
    SOLUTION_COV,
    SOLUTION_ENU,
)
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.navigator.filter_run import FilterRun
from nav_pose_estimator.engine.navigator.sins import solution_at_end
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import ImuBlock, Sample
from nav_pose_estimator.engine.solutions import Event, Mode, NavBlock, NavSolution, Output, PredictedDrift, Status
from nav_pose_estimator.offline.flights.outage_errors import OutageErrors, judge
from nav_pose_estimator.offline.flights.outages import GnssRemoval, Outage, OutageProof
from nav_pose_estimator.offline.flights.recording import Recording
from nav_pose_estimator.offline.flights.tracks import Reference, Track, TrackRecorder
from nav_pose_estimator.offline.replay.second_core import SecondCore

STATE_PERIOD_NS = 1_000_000_000
"""Period in which biases are recorded."""
DRAWN = 18_000
"""Largest number of drawn rows of a track: six minutes at 50 Hz; longer ones are decimated."""
RESETS = frozenset(("reset", "resume.begun"))
"""Names of events after which there is no solution until the navigator is at least level again."""
Progress = Callable[[int], None]


@dataclass
class Record:
    """All outputs of an estimator."""

    epoch_ns: int
    tracks: TrackRecorder
    biases: list[np.ndarray] = field(default_factory=list)  # BiasHistory.COLUMNS
    events: list[Event] = field(default_factory=list)
    modes: list[tuple[float, Mode]] = field(default_factory=list)
    predictions: list[PredictedDrift] = field(default_factory=list)
    imu_samples: int = 0
    _reset_ns: int = -1

    def take(self, outputs: Iterable[Output]) -> None:
        """Store the outputs of one call of ``feed``."""
        for output in outputs:
            if isinstance(output, NavBlock):
                self.tracks.add(output)
                self._note_mode(int(output.stamps_ns[0]), output.mode)
            elif isinstance(output, PredictedDrift):
                self.predictions.append(output)
            elif isinstance(output, Event):
                self._note_event(output)

    def note_biases(self, run: FilterRun, outputs: Sequence[Output], stamp_ns: int) -> None:
        """Store the biases of a navigator at ``stamp_ns``, its last IMU sample, if the last solution is that of it.

        It is not after a gap, for example, behind which the navigator aligns again.
        """
        block = next((output for output in reversed(outputs) if isinstance(output, NavBlock)), None)
        if block is not None and block.stamps_ns[-1] == stamp_ns and run.timeline.running:
            self.biases.append(_biases(solution_at_end(run, block), self.epoch_ns))

    @property
    def bias_history(self) -> "BiasHistory":
        """The sensor biases by time."""
        return BiasHistory(np.array(self.biases, float).reshape(-1, BiasHistory.COLUMNS))

    def _note_event(self, event: Event) -> None:
        if event.name in RESETS:  # the previous mode must not seem to last until the next solution
            self._note_mode(event.stamp_ns, Mode.ALIGNING)
            self._reset_ns = event.stamp_ns
        if event.text:
            self.events.append(event)

    def _note_mode(self, stamp_ns: int, mode: Mode) -> None:
        if stamp_ns <= self._reset_ns:  # of the call that ended with the reset: events come ahead of solutions
            return
        if not self.modes or self.modes[-1][1] is not mode:
            self.modes.append(((stamp_ns - self.epoch_ns) * 1e-9, mode))


@dataclass(frozen=True)
class BiasHistory:
    """``rows`` (N, COLUMNS): time [s], biases of gyroscope [rad/s] and accelerometer [m/s^2], their deviations."""

    COLUMNS = 13
    rows: np.ndarray

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def t(self) -> np.ndarray:
        """Times (N,) [s since the first stamp]."""
        return self.rows[:, 0]

    def of(self, sensor: int) -> tuple[np.ndarray, np.ndarray]:
        """Bias (N, 3) and standard deviation (N, 3) of the gyroscope (0) or the accelerometer (1)."""
        start = 1 + 3 * sensor
        return self.rows[:, start : start + 3], self.rows[:, start + 6 : start + 9]


def _biases(solution: NavSolution, epoch_ns: int) -> np.ndarray:
    biases, variances = solution.values[SOLUTION_BIASES:SOLUTION_ENU], solution.values[SOLUTION_COV :: BASE_STATES + 1]
    spread = (variances[first : first + 3] for first in (D_GYRO_BIAS, D_ACCEL_BIAS))
    return np.concatenate([[(solution.stamp_ns - epoch_ns) * 1e-9], biases, *map(np.sqrt, spread)])


@dataclass
class ReplayResult:
    """A finished replay. ``drawn`` and ``drawn_reference`` have at most ``DRAWN`` rows."""

    recording: Recording
    parameters: Parameters
    outages: list[Outage]
    reference: Reference
    fix_times: np.ndarray
    track: Track
    record: Record
    status: Status
    origin: tuple[float, float, float] | None
    errors: list[OutageErrors]
    proof: dict[str, float | int | None]
    seconds: float  # spent in the estimator, loading of its kernels included

    @cached_property
    def drawn(self) -> Track:
        """The track, decimated for drawing."""
        return self.track.thinned(DRAWN)

    @cached_property
    def drawn_reference(self) -> Reference:
        """The reference, decimated for drawing."""
        return self.reference.thinned(DRAWN)


def as_block(solution: NavSolution) -> NavBlock:
    """One solution in the form of a block."""
    row = solution.values[:OUT_COLUMNS]
    stamps = np.array([solution.stamp_ns], np.int64)
    return NavBlock(stamps, row[None, :], solution.mode, solution.reset_count, solution.correction_enu)


def replay(
    recording: Recording, parameters: Parameters, outages: list[Outage], progress: Progress | None = None
) -> ReplayResult:
    """Replay a recording without GNSS in ``outages``. ``progress`` receives the number of IMU samples just done."""
    delay = parameters.gnss.delay
    removal = GnssRemoval(outages, recording.epoch_ns, delay)
    proof = OutageProof(outages, recording.epoch_ns, delay)
    record = Record(recording.epoch_ns, TrackRecorder(recording.epoch_ns))
    began = time.perf_counter()
    with SecondCore() as core:
        # kernels are loaded on their first call, which delays nothing here
        engine = core.engine = PoseEstimator(parameters, train=core.train, rehearse=core.rehearse)
        run(engine, removal.filter(recording.samples), record, proof, progress, core.deliver)
        status = engine.status()
    seconds = time.perf_counter() - began
    reference = recording.reference(delay)
    fix_times = recording.fix_times(delay)
    track = record.tracks.track()
    lever = reference_lever(reference, parameters)
    return ReplayResult(
        recording=recording,
        parameters=parameters,
        outages=outages,
        reference=reference,
        fix_times=fix_times,
        track=track,
        record=record,
        status=status,
        origin=engine.origin,
        errors=[judge(outage, fix_times, reference, track, lever) for outage in outages],
        proof=proof.summary(),
        seconds=seconds,
    )


def reference_lever(reference: Reference, parameters: Parameters) -> np.ndarray:
    """Lever arm (3,) [m] in b from the IMU to the point of the reference: the antenna for GNSS, zero for the truth."""
    return np.array(parameters.gnss.lever_arm) if reference.kind == "GNSS" else np.zeros(3)


def run(
    engine: PoseEstimator,
    samples: Iterable[Sample],
    record: Record,
    proof: OutageProof,
    progress: Progress | None = None,
    ahead: Callable[[int], None] = lambda stamp_ns: None,
) -> None:
    """Feed ``samples``, each of which is checked to contain no GNSS from inside an outage.

    ``ahead`` receives the newest IMU stamp [ns] before it is fed to the estimator.
    """
    next_state = last_ns = reported = 0
    waiting: list[Sample] = []
    for sample in samples:
        proof.check(sample)
        waiting.append(sample)
        if not isinstance(sample, ImuBlock):
            continue
        record.imu_samples += len(sample)
        last_ns = int(sample.stamps_ns[-1])
        if not next_state - 2 * STATE_PERIOD_NS < last_ns < next_state:  # also after a clock that went back
            next_state = last_ns + STATE_PERIOD_NS
            ahead(last_ns)
            outputs = engine.feed_all(waiting)
            record.take(outputs)
            record.note_biases(engine.sins.run, outputs, last_ns)
            waiting = []
            if progress is not None:
                progress(record.imu_samples - reported)
            reported = record.imu_samples
    ahead(last_ns)
    record.take(engine.feed_all(waiting))
