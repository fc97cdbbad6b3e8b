"""Training data of a recording: aided epochs, and the second of IMU data before each of them."""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.learning.conv_lstm import STEPS
from nav_pose_estimator.core.motion import epochs as me
from nav_pose_estimator.core.motion.airframe import PastFlight
from nav_pose_estimator.core.motion.prior import MOVES
from nav_pose_estimator.core.motion.vehicle_class import classify
from nav_pose_estimator.core.motion.windows import CHANNELS, INCREMENTS, increments, window
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.outage.airframe_file import LONGEST_NAME
from nav_pose_estimator.engine.outage.epochs import EpochCollector
from nav_pose_estimator.engine.outage.methods.method import OutageMethod
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.solutions import NavBlock, NavSolution
from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.archive.kept import key_of
from nav_pose_estimator.offline.flights import latency
from nav_pose_estimator.offline.flights.config_file import load_parameters
from nav_pose_estimator.offline.flights.recording import Recording
from nav_pose_estimator.offline.logs.open_recording import open_recording, prepared
from nav_pose_estimator.offline.logs.options import LogOptions
from nav_pose_estimator.offline.sidecar import sidecar_path
from nav_pose_estimator.offline.terminal import printable

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

LEAST = 60.0
"""Shortest aided flight [s], below which the wind of a recording is not observable enough."""
_CLIMBS = 0.5  # m/s: vertical speed that counts as climbing
_CHUNK = 1 << 20  # bytes that are hashed at once


@dataclass(frozen=True)
class FlightData:
    """Training data of a flight.

    ``epochs`` (N, COLUMNS) of aided flight; ``windows`` (N, STEPS, CHANNELS) and ``increments`` (N, INCREMENTS) of the
    second before each, as in ``core.motion.windows``.
    """

    name: str
    digest: str
    epochs: Array
    windows: Floats
    increments: Floats

    @property
    def seconds(self) -> float:
        """Duration of the flight [s]."""
        return len(self.epochs) * me.PERIOD

    @property
    def past(self) -> PastFlight:
        """Entry for the list of flights in the file."""
        return PastFlight(printable(self.name)[:LONGEST_NAME], self.digest, self.seconds)

    @property
    def shown_class(self) -> str:
        """Class of the vehicle by its motion; ``UNKNOWN`` if that is ambiguous, as in pure hover."""
        return classify(self.epochs)


class Recorder(OutageMethod):
    """Records the last second with every epoch."""

    name = "recorder"

    def columns(self, output: NavBlock | NavSolution, rows: Array) -> Array:
        """The window row by row, and the increments."""
        return np.concatenate([window(rows).ravel(), increments(rows)])


def digest_of(path: Path) -> str:
    """SHA-256 of a recording, hexadecimal: of a file its content, of a folder names and contents of its files."""
    digest = hashlib.sha256()
    files = [path] if path.is_file() else sorted(item for item in path.rglob("*") if item.is_file())
    for file in files:
        if file != path:
            digest.update(f"{file.relative_to(path).as_posix()}\n".encode())
        with file.open("rb") as content:
            while chunk := content.read(_CHUNK):
                digest.update(chunk)
    return digest.hexdigest()


@dataclass(frozen=True)
class Reading:
    """Options for reading recordings: parameter file, part of a log, latency of the fixes as in ``--gnss-delay``."""

    config: Path | None = None
    log: LogOptions = field(default_factory=LogOptions)
    gnss_delay: str | None = None


@dataclass(frozen=True)
class Recorded:
    """A recording, the SHA-256 of its content, and how it is read."""

    path: Path
    digest: str
    reading: Reading

    @property
    def key(self) -> str:
        """Key that depends on everything that affects the replay, but not on the path of the recording."""
        files = (sidecar_path(self.path), self.reading.config)
        read_as = (self.digest, self.reading.log, self.reading.gnss_delay)
        return key_of(read_as, [path for path in files if path is not None])


def fly(recorded: Recorded) -> FlightData:
    """Replay a recording with GNSS; ``UserError`` without GNSS, or with less than ``LEAST`` of aided flight."""
    path, reading = recorded.path, recorded.reading
    parameters = update(load_parameters(reading.config), {"learner.enabled": False})
    recording = prepared(open_recording(path, reading.log, parameters=parameters), parameters, np.inf)
    parameters, _ = latency.choose(recording, parameters, reading.gnss_delay, reading.config, np.inf, search=True)
    found = list(good_epochs(recording, PoseEstimator(parameters, attitude=False), EpochCollector(Recorder())))
    rows = np.array(found) if found else np.empty((0, me.COLUMNS + STEPS * CHANNELS + INCREMENTS))
    rows = rows[flown(rows)]
    if not len(rows) and not recording.fixes:
        raise UserError(f"{path.name} holds no GNSS fixes, without which nothing can be learned from its motion")
    if len(rows) * me.PERIOD < LEAST:
        raise UserError(
            f"{path.name} holds {len(rows) * me.PERIOD:.0f} s of flight with good GNSS and known heading, "
            f"at least {LEAST:.0f} are needed"
        )
    epochs, seen, happened = np.split(rows, [me.COLUMNS, rows.shape[1] - INCREMENTS], axis=1)
    windows = seen.astype(np.float32).reshape(-1, STEPS, CHANNELS)
    return FlightData(recording.name, recorded.digest, epochs, windows, happened.astype(np.float32))


def good_epochs(recording: Recording, engine: PoseEstimator, collector: EpochCollector) -> Iterator[Array]:
    """Yield the epochs of aided flight, as ``collector`` forms them, of a ``recording`` in ``engine``."""
    for sample in recording.samples:
        for output in engine.feed(sample):
            if isinstance(output, (NavBlock, NavSolution)):
                finished = collector.feed(output)
                if finished is not None and finished.is_good:
                    yield finished.values


def flown(rows: Array) -> slice:
    """Rows from the first to the last epoch in motion, without those on the ground."""
    speed = np.hypot(rows[:, me.VELOCITY], rows[:, me.VELOCITY + 1])
    moving = np.flatnonzero((speed > MOVES) | (np.abs(rows[:, me.VELOCITY + 2]) > _CLIMBS))
    return slice(int(moving[0]), int(moving[-1]) + 1) if len(moving) else slice(0)
