"""Conversion of a log's sensor data to a recording, with the same samples in the same order as from a bag."""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from nav_pose_estimator.engine.samples import GnssFix, GnssVelocity, ImuBlock, Sample, SatelliteCount
from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.bags.raw_messages import BagError
from nav_pose_estimator.offline.flights.flight_window import ARMED
from nav_pose_estimator.offline.flights.interleaving import interleaved
from nav_pose_estimator.offline.flights.latency import PRIOR, PRIOR_SOURCE
from nav_pose_estimator.offline.flights.recording import Recording
from nav_pose_estimator.offline.flights.tracks import Reference
from nav_pose_estimator.offline.logs import sensors
from nav_pose_estimator.offline.logs.clock_fit import ClockFit, fit_clock
from nav_pose_estimator.offline.logs.options import LogOptions
from nav_pose_estimator.offline.logs.segments import Segment, find_segments
from nav_pose_estimator.offline.logs.sensors import FIX, NO_FIX, Array, Gnss, Imu, LogSensors

SLOW_HZ = 40.0
"""Rate [Hz] below which a logged IMU aliases vibration and misses rotations, so that a warning is given."""
UNDATED_NS = 10**18  # stamp of the log's time zero if GNSS does not give the date
CLOCK_WINDOW_US = 60_000_000
"""Time of the fixes that the rate of the clock is estimated from; only those before the first outage are used."""
_FASTEST = 0.9  # smallest time of the log per second of true time, for the start of an outage
BESIDE_US = 500_000
"""Time before the first and after the last IMU sample within which other samples belong to the recording."""


@dataclass
class LogRecording(Recording):
    """A recording from a log, with access to the log."""

    log: LogSensors | None = None
    options: LogOptions = field(default_factory=LogOptions)

    @property
    def imu_number(self) -> int:
        """Number of its IMU in the log, from 1."""
        return self.options.imu or 1

    def with_imu(self, number: int) -> "LogRecording":
        """The same flight with another IMU of the log, numbered from 1."""
        assert self.log is not None
        return log_recording(self.log, replace(self.options, imu=number))


def log_recording(log: LogSensors, options: LogOptions) -> LogRecording:
    """The recording of a log. Raises ``BagError`` without IMU or GNSS, and for an unknown IMU or segment."""
    imu = _chosen_imu(log, options.imu)
    receiver = _receiver(log)
    segment, notices = _chosen_segment(log, imu, options)
    imu = _cut_imu(imu, segment)
    gnss, repeated = sensors.fresh(_cut(receiver, segment))
    if not gnss.has_fix.any():
        raise BagError(f"{log.path}: segment {options.segment} holds no three-dimensional GNSS fix")
    clock = _Clock(imu.time_us, gnss, options)
    block = _imu_block(imu, clock)
    timed = _timed_samples(gnss, log, segment, clock)
    # in order of receipt, the IMU first at equal times
    rows = np.searchsorted(block.stamps_ns, [stamp for stamp, _ in timed], side="right")
    epoch_ns, last_ns = min([int(block.stamps_ns[0]), *(stamp for stamp, _ in timed[:1])]), int(block.stamps_ns[-1])
    counters = log.counters.copy()
    counters.update({"log.gnss_repeated": repeated, "log.imu_clipped": imu.clipped})
    return LogRecording(
        path=log.path,
        samples=interleaved(block, [sample for _, sample in timed], rows),
        epoch_ns=epoch_ns,
        duration=(last_ns - epoch_ns) * 1e-9,
        notices=[*log.notices, *notices, *clock.notices, *_notices(log, imu, gnss, repeated, options)],
        counters=+counters,
        sidecar=_sidecar(log, clock, epoch_ns),
        opinion=_opinion(log.opinion, clock, epoch_ns),
        log=log,
        options=options,
    )


def _chosen_imu(log: LogSensors, number: int | None) -> Imu:
    if not log.imus:
        raise BagError(f"{log.path} holds no IMU data ({log.needs[0]}), without which there is no pose; {_held(log)}")
    if not 1 <= (number or 1) <= len(log.imus):
        names = ", ".join(f"{i} {imu.name}" for i, imu in enumerate(log.imus, 1))
        raise BagError(f"{log.path} has no IMU {number}; choose from {names}")
    return log.imus[(number or 1) - 1]


def _receiver(log: LogSensors) -> Gnss:
    receiver = log.receiver
    if receiver is None or len(receiver.time_us) == 0:
        raise BagError(f"{log.path} holds no GNSS ({log.needs[1]}), without which there is no position; {_held(log)}")
    if not receiver.has_fix.any():
        raise BagError(f"{log.path}: the receiver ({receiver.name}) never has a three-dimensional fix")
    return receiver


def _held(log: LogSensors) -> str:
    names = ", ".join(log.names[:40]) or "nothing"
    return f"it holds {names}" + (f" and {len(log.names) - 40} more" if len(log.names) > 40 else "")


def _chosen_segment(log: LogSensors, imu: Imu, options: LogOptions) -> tuple[Segment, list[str]]:
    """The requested segment, else the whole log, and notices about the choice."""
    found = find_segments(imu.time_us, log.armed, options.max_gap)
    if options.segment is None:
        notices = [f"the log holds {len(found)} segments: --segment N takes one, --list shows them"] * (len(found) > 1)
        return Segment(int(imu.time_us[0]), int(imu.time_us[-1]), 0.0), notices
    if not 1 <= options.segment <= len(found):
        raise BagError(f"{log.path} has no segment {options.segment}; there are {len(found)}, --list shows them")
    return found[options.segment - 1], []


def _cut_imu(imu: Imu, segment: Segment) -> Imu:
    chosen = (imu.time_us >= segment.begin_us) & (imu.time_us <= segment.end_us)
    return Imu(imu.name, imu.time_us[chosen], imu.gyro[chosen], imu.accel[chosen], imu.clipped)


def _cut(gnss: Gnss, segment: Segment) -> Gnss:
    chosen = _inside(gnss.time_us, segment)
    return replace(gnss, **{name: getattr(gnss, name)[chosen] for name in sensors.PER_MESSAGE})


def _inside(time_us: Array, segment: Segment) -> Array:
    """Whether each of ``time_us`` (N,) is in the segment, or within ``BESIDE_US`` of it."""
    return (time_us > segment.begin_us - BESIDE_US) & (time_us < segment.end_us + BESIDE_US)


def _first_minute(gnss: Gnss, end_us: float) -> ClockFit | None:
    """Fit to the first minute of fixes with a time, limited to those before ``end_us``."""
    timed = gnss.time_us[(gnss.utc_us > 0) & gnss.has_fix]
    if not len(timed):
        return None
    return fit_clock(gnss, int(timed[0]), int(min(timed[0] + CLOCK_WINDOW_US, end_us)))


class _Clock:
    """Conversion of the log's microseconds to stamps, in nanoseconds of UTC if the log contains the date."""

    def __init__(self, imu_us: Array, gnss: Gnss, options: LogOptions) -> None:
        self._begin_us = int(imu_us[0])
        early = _first_minute(gnss, self._begin_us + _FASTEST * options.until * 1e6)
        fit = early or _first_minute(gnss, math.inf)  # for the date, and for a notice about the clock
        if options.clock == "gnss" and fit is None:
            raise UserError("--clock gnss: the log has too few fixes with a time for that")
        automatic = options.clock == "auto" and early is not None and early.wrong
        scaled = fit is not None and (options.clock == "gnss" or automatic)
        self.rate = fit.rate if scaled and fit is not None else 1.0
        self._begin_ns = UNDATED_NS + self._begin_us * 1000
        if fit is not None:
            self._begin_ns = (fit.utc_us - round((fit.at_us - self._begin_us) * self.rate)) * 1000
        self.notices = []
        if fit is not None and fit.wrong:
            other = "gnss" if options.clock == "auto" else "auto"  # auto does not where an outage hides the fixes
            done = "its times were scaled" if scaled else f"--clock {other} scales its times"
            self.notices.append(f"{fit.describe()}; {done}")

    def stamps(self, time_us: Array) -> Array:
        """Stamps (N,) int64 [ns] of ``time_us`` (N,)."""
        since = time_us.astype(np.int64) - self._begin_us
        if self.rate == 1.0:
            return self._begin_ns + since * 1000
        return self._begin_ns + np.round(since * (1000.0 * self.rate)).astype(np.int64)


def _imu_block(imu: Imu, clock: _Clock) -> ImuBlock:
    return ImuBlock(clock.stamps(imu.time_us), np.ascontiguousarray(imu.gyro), np.ascontiguousarray(imu.accel))


def _timed_samples(gnss: Gnss, log: LogSensors, segment: Segment, clock: _Clock) -> list[tuple[int, Sample]]:
    """(time of receipt [ns], sample) of all sensors but the IMU, in order; those of one message as from a bag."""
    timed: list[tuple[int, Sample]] = []
    for i, stamp in enumerate(clock.stamps(gnss.time_us).tolist()):
        timed += [(stamp, sample) for sample in _gnss_samples(gnss, i, stamp)]
    for series in log.others:
        inside = _inside(series.time_us, segment)
        stamps, rows = clock.stamps(series.time_us[inside]).tolist(), series.values[inside].tolist()
        timed += [(t, sensors.sample(series, t, row)) for t, row in zip(stamps, rows, strict=True)]
    timed.sort(key=lambda item: item[0])
    return timed


def _gnss_samples(gnss: Gnss, i: int, stamp: int) -> list[Sample]:
    lat, lon, alt = gnss.position[i].tolist()
    horizontal, vertical, speed = gnss.accuracy[i].tolist()
    known = np.isfinite(horizontal) and np.isfinite(vertical)
    cov = np.diag([horizontal**2, horizontal**2, vertical**2]) if known else None
    out: list[Sample] = [GnssFix(stamp, lat, lon, alt, FIX if gnss.has_fix[i] else NO_FIX, cov)]
    east, north, up = gnss.velocity[i].tolist()
    if gnss.has_fix[i] and np.isfinite(east) and np.isfinite(north):
        out.append(GnssVelocity(stamp, (east, north, up), np.eye(3) * speed**2 if np.isfinite(speed) else None))
    if gnss.satellites[i] >= 0:
        out.append(SatelliteCount(None, int(gnss.satellites[i])))
    return out


def _opinion(opinion: Reference | None, clock: _Clock, epoch_ns: int) -> Reference | None:
    """The autopilot's estimate with times in seconds of the recording."""
    if opinion is None:
        return None
    time_us = np.round(opinion.t * 1e6).astype(np.int64)
    return replace(opinion, t=(clock.stamps(time_us) - epoch_ns) * 1e-9)


def _sidecar(log: LogSensors, clock: _Clock, epoch_ns: int) -> dict:
    """Further data of the log in the form of NAME.json."""
    sidecar: dict = {} if log.delay is None else {PRIOR: log.delay[0], PRIOR_SOURCE: log.delay[1]}
    if log.armed:
        spans = (clock.stamps(np.array(log.armed, np.int64).ravel()) - epoch_ns) * 1e-9
        sidecar[ARMED] = np.round(spans, 3).reshape(-1, 2).tolist()
    return sidecar


def _notices(log: LogSensors, imu: Imu, gnss: Gnss, repeated: int, options: LogOptions) -> list[str]:
    """Sentences for the user about the quality of the data."""
    notices = []
    rate = imu.rate()
    if rate < SLOW_HZ:
        notices.append(f"the IMU was logged at {rate:.0f} Hz: too slow to coast for a minute; log it at 50 Hz or more")
    pauses = np.diff(imu.time_us) * 1e-6
    long = pauses[pauses > options.max_gap]
    if len(long):
        times = "once" if len(long) == 1 else f"{len(long)} times"
        notices.append(f"the IMU pauses {times}, {long.max():.1f} s at most: the estimator goes on from its last state")
    if repeated:
        notices.append(f"{repeated} GNSS messages only repeat the previous one: left out")
    if imu.clipped:
        notices.append(
            f"{imu.clipped} IMU samples were out of the sensor's range ({100 * imu.clipped / len(imu.time_us):.2g} %)"
        )
    if gnss.sea_level:
        notices.append("heights are above mean sea level: the log has no ellipsoid heights")
    return notices
