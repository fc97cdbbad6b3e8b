"""A simulated flight in the estimator: its outputs, and their errors relative to the truth."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import cache

import numpy as np

from nav_pose_estimator.core.earth.ellipsoid import lla_to_enu
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import GnssFix, GnssVelocity, ImuBlock, ImuSample, Sample, SatelliteCount
from nav_pose_estimator.engine.solutions import Event, Mode, NavBlock, NavSolution
from nav_pose_estimator.offline.replay.replay import as_block
from nav_pose_estimator.sim import scenarios
from nav_pose_estimator.sim.faults import Fault, Stop
from nav_pose_estimator.sim.recording import Recording

GNSS = (GnssFix, GnssVelocity, SatelliteCount)


@cache
def flight(name: str = "multirotor_light", duration: float = 120.0, seed: int = 5, rate: float = 100.0) -> Recording:
    """A simulated flight, which is cached; faults are added to copies of it."""
    return scenarios.generate(name, duration, seed, imu_rate=rate)


def silence(start: float, length: float) -> tuple[Fault, ...]:
    """Faults that stop all messages of the receiver."""
    return tuple(Stop(kind, start, length) for kind in GNSS)


@dataclass
class Told:
    """Row i of every array belongs to one IMU sample; ``t`` counts from the recording's start [s]."""

    estimator: PoseEstimator
    recording: Recording
    events: list[Event]
    modes: list[Mode]
    last: NavSolution | None
    t: np.ndarray
    error: np.ndarray  # (N, 3) estimate minus truth, ENU [m]
    sigma: np.ndarray  # (N,) horizontal
    position: np.ndarray  # (N, 3) ENU [m]
    speed: np.ndarray
    correction: np.ndarray  # (N, 3) map -> odom
    resets: np.ndarray
    variances: np.ndarray  # (N, 3) ENU [m^2]

    @property
    def off(self) -> np.ndarray:
        """Horizontal error (N,) [m]."""
        return np.hypot(self.error[:, 0], self.error[:, 1])

    def between(self, start: float, end: float) -> np.ndarray:
        """Mask of the rows in [start, end) [s]."""
        return (self.t >= start) & (self.t < end)

    def modes_between(self, start: float, end: float) -> set[Mode]:
        return {mode for mode, inside in zip(self.modes, self.between(start, end), strict=True) if inside}

    def when(self, name: str, after: float = 0.0) -> list[float]:
        """Times of the events whose name begins with ``name``."""
        times = (
            (event.stamp_ns - self.recording.start_ns) * 1e-9 for event in self.events if event.name.startswith(name)
        )
        return [t for t in times if t >= after]

    def event(self, name: str) -> Event:
        return next(event for event in self.events if event.name.startswith(name))

    def count(self, name: str) -> int:
        """The sum of the counters whose name begins with ``name``."""
        return sum(n for key, n in self.estimator.status().counters.items() if key.startswith(name))


@dataclass
class _Pages:
    stamps: list = field(default_factory=list)
    rows: list = field(default_factory=list)
    correction: list = field(default_factory=list)
    resets: list = field(default_factory=list)
    modes: list = field(default_factory=list)

    def add(self, block: NavBlock) -> None:
        n = len(block.stamps_ns)
        self.stamps.append(block.stamps_ns)
        self.rows.append(block.rows)
        self.correction.append(np.tile(block.correction_enu, (n, 1)))
        self.resets.append(np.full(n, block.reset_count))
        self.modes += [block.mode] * n


def tell(
    recording: Recording, *faults: Fault, samples: Iterable[Sample] | None = None, attitude: bool = False, **overrides
) -> Told:
    """Feed the flight with ``faults``; ``gnss__delay=0.1`` sets the parameter ``gnss.delay``."""
    parameters = update(Parameters(), {name.replace("__", "."): value for name, value in overrides.items()})
    estimator = PoseEstimator(parameters, attitude=attitude)
    spoiled = recording.with_faults(*faults) if faults else recording
    pages, events, last = _Pages(), [], None
    for sample in _last_alone(spoiled.samples() if samples is None else samples):
        for output in estimator.feed(sample):
            if isinstance(output, Event):
                events.append(output)
            elif isinstance(output, NavSolution):
                last = output
                pages.add(as_block(output))
            elif isinstance(output, NavBlock):
                pages.add(output)
    return _told(estimator, recording, events, pages, last)


def _last_alone(samples: Iterable[Sample]) -> Iterator[Sample]:
    """The samples with the last IMU sample separate, so that its solution has biases and covariance."""
    before: Sample | None = None
    for sample in samples:
        if before is not None:
            yield before
        before = sample
    if isinstance(before, ImuBlock):
        yield before.part(0, -1)
        yield ImuSample(int(before.stamps_ns[-1]), tuple(before.gyro[-1].tolist()), tuple(before.accel[-1].tolist()))
    elif before is not None:
        yield before


def _told(estimator: PoseEstimator, recording: Recording, events: list, pages: _Pages, last) -> Told:
    rows = np.concatenate(pages.rows) if pages.rows else np.empty((0, at.OUT_COLUMNS))
    stamps = np.concatenate(pages.stamps) if pages.stamps else np.empty(0, np.int64)
    t = (stamps - recording.start_ns) * 1e-9
    place = rows[:, at.OUT_POS : at.OUT_VEL]
    var = rows[:, at.OUT_VAR + at.DPOS : at.OUT_VAR + at.DPOS + 2]
    return Told(
        estimator,
        recording,
        events,
        pages.modes,
        last,
        t,
        recording.error_enu(t, place),
        np.sqrt(var.sum(axis=1)),
        lla_to_enu(*place.T, *recording.origin),
        np.linalg.norm(rows[:, at.OUT_VEL : at.OUT_QUAT], axis=1),
        np.concatenate(pages.correction) if pages.correction else np.empty((0, 3)),
        np.concatenate(pages.resets) if pages.resets else np.empty(0),
        rows[:, at.OUT_VAR + at.DPOS : at.OUT_VAR + at.DPOS + 3],
    )
