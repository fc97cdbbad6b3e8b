"""Option ``--list``: a description of a recording, in the same form for logs of both kinds and for bags."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import (
    Airspeed,
    DifferentialPressure,
    MagSample,
    PressureSample,
    RangeToGround,
    Sample,
    SatelliteCount,
)
from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.flights.recording import Recording, load
from nav_pose_estimator.offline.logs import sensors
from nav_pose_estimator.offline.logs.clock_fit import fit_clock
from nav_pose_estimator.offline.logs.imu_choice import compare_imus
from nav_pose_estimator.offline.logs.log_flight import log_recording
from nav_pose_estimator.offline.logs.open_recording import log_form, read_sensors
from nav_pose_estimator.offline.logs.options import LogOptions
from nav_pose_estimator.offline.logs.segments import find_segments
from nav_pose_estimator.offline.logs.sensors import Array, Gnss, Imu, LogSensors, Series
from nav_pose_estimator.offline.remote import at_hand

_SENSORS = (
    ("magnetometer", MagSample),
    ("barometer", PressureSample),
    ("airspeed", Airspeed),
    ("pitot tube", DifferentialPressure),
    ("range", RangeToGround),
)


def describe(
    path: Path, options: LogOptions, remaps: dict[str, str] | None = None, parameters: Parameters | None = None
) -> list[str]:
    """Lines about a log or a bag. Raises ``BagError`` if it is neither."""
    with at_hand(path) as here:
        if log_form(here) is None:
            return _lines(_of_bag(load(here, remaps)), options, None)
        return _lines(read_sensors(here), options, parameters or Parameters())


def _lines(log: LogSensors, options: LogOptions, parameters: Parameters | None) -> list[str]:
    span = log.imus[0].time_us[[0, -1]] if log.imus else np.zeros(2, np.int64)
    head = f"{log.path.name}: {log.form}, {log.firmware or 'unknown source'}"
    lines = [head + (f", {log.vehicle}" if log.vehicle else "")]
    lines += _segment_lines(log, options, int(span[0]))
    lines += _imu_lines(log, options, parameters)
    lines += [_gnss_line(gnss) for gnss in log.gnss] or [f"GNSS: none ({log.needs[1]})"]
    lines += list(_sensor_lines(log.others))
    lines.append("estimator: " + (f"{log.opinion.kind}, {len(log.opinion.t)} rows" if log.opinion else "none"))
    lines.append(_clock_line(log.receiver))
    if log.delay is not None:
        lines.append(f"GNSS latency: {log.delay[0]:g} s by the autopilot's parameter {log.delay[1]}")
    if log.antenna is not None:
        place = ", ".join(f"{value + 0.0:.2f}" for value in log.antenna)
        lines.append(f"antenna: {place} m forward, left, up of the IMU by the autopilot's parameters (gnss.lever_arm)")
    return [*lines, *(f"note: {text}" for text in log.notices)]


def _segment_lines(log: LogSensors, options: LogOptions, begin_us: int) -> Iterable[str]:
    if not log.imus:
        yield "segments: none"
        return
    times = "once" if log.armed and len(log.armed) == 1 else f"{len(log.armed or [])} times"
    arming = "arming not recorded" if log.armed is None else f"armed {times}"
    yield f"segments ({arming}; seconds since the first IMU sample):"
    for number, piece in enumerate(find_segments(log.imus[0].time_us, log.armed, options.max_gap), 1):
        first, last = ((t - begin_us) * 1e-6 for t in (piece.begin_us, piece.end_us))
        armed = f", armed for {piece.armed:.0f} s" if piece.armed else ""
        yield f"  {number}: {first:.1f} to {last:.1f}, {piece.duration:.0f} s{armed}"


def _imu_lines(log: LogSensors, options: LogOptions, parameters: Parameters | None) -> Iterable[str]:
    if not log.imus:
        yield f"IMU: none ({log.needs[0]})"
    for number, imu in enumerate(log.imus, 1):
        clipped = f", {imu.clipped} samples out of range" if imu.clipped else ""
        pause = float(np.diff(imu.time_us).max()) * 1e-6
        yield (
            f"IMU {number}: {imu.name}, {imu.rate():.0f} Hz, longest pause {pause:.2f} s, "
            f"vibration {_vibration(imu):.1f} m/s^2{clipped}"
        )
    if len(log.imus) < 2 or parameters is None:
        return
    try:
        found = compare_imus(log_recording(log, options), parameters, float("inf"))
    except UserError as error:
        yield f"recommended: not known ({error})"
        return
    if found is None:
        yield "recommended: not known (the navigator starts with none of them)"
        return
    values = ", ".join(f"{value:.2f}" for value in found.innovations)
    yield f"recommended: IMU {found.best} (GNSS velocities differ from the predicted ones by {values} m/s RMS)"


def _vibration(imu: Imu) -> float:
    """Standard deviation of the specific force [m/s^2] by the differences of successive samples, as of white noise."""
    steps = np.diff(np.linalg.norm(imu.accel, axis=1))
    return float(np.std(steps) / np.sqrt(2.0)) if len(steps) else 0.0


def _gnss_line(gnss: Gnss) -> str:
    distinct, repeated = sensors.fresh(gnss)
    rate = 1e6 / float(np.median(np.diff(distinct.time_us))) if len(distinct.time_us) > 1 else 0.0
    counts = gnss.satellites[(gnss.satellites >= 0) & gnss.has_fix]
    parts = [f"{rate:.1f} Hz", f"{int(gnss.has_fix.sum())} fixes of {len(gnss.time_us)} messages"]
    parts.append(f"{counts.min()} to {counts.max()} satellites" if len(counts) else "satellites not known")
    velocity = np.isfinite(gnss.velocity[gnss.has_fix])
    if not velocity.size or not velocity[:, :2].any():
        parts.append("no velocity")
    elif not velocity[:, 2].any():
        parts.append("no vertical velocity")
    stated = gnss.accuracy[gnss.has_fix]
    if np.isfinite(stated[:, 0]).any():
        parts.append(f"horizontal accuracy {np.nanmedian(stated[:, 0]):.1f} m")
    if repeated:
        parts.append(f"{repeated} messages only repeat the one before")
    parts.append("height above sea level" if gnss.sea_level else "height above the ellipsoid")
    return f"GNSS: {gnss.name}, {', '.join(parts)}"


def _sensor_lines(others: list[Series]) -> Iterable[str]:
    for words, kind in _SENSORS:
        found = next((series for series in others if series.kind is kind), None)
        yield f"{words}: " + ("none" if found is None else f"{found.name}, {found.rate():.1f} Hz")


def _clock_line(gnss: Gnss | None) -> str:
    fit = fit_clock(gnss, 0, 1 << 62) if gnss is not None else None
    if fit is None:
        return "clock: not known (no GNSS time in the log)"
    wrong = "; --clock auto scales its times" if fit.wrong else ""
    jumps = f", {fit.jumps} jumps of the GNSS time" if fit.jumps else ""
    return f"clock: {fit.describe()} (deviation {fit.sd * 1e6:.0f} ppm, {fit.span:.0f} s{jumps}){wrong}"


def _of_bag(recording: Recording) -> LogSensors:
    """Contents of a bag, in the form of those of a log."""
    block = recording.imu
    others = [
        Series(words, kind, times, np.empty((len(times), 0)))
        for words, kind in _SENSORS
        if len(times := _times(recording.samples, kind))
    ]
    return LogSensors(
        path=recording.path,
        form="rosbag2",
        firmware="ground truth" if recording.truth is not None else "",
        vehicle="",
        imus=[Imu("sensor_msgs/Imu", block.stamps_ns // 1000, block.gyro, block.accel)],
        gnss=[_gnss_of_bag(recording)] if recording.fixes else [],
        others=others,
        needs=("sensor_msgs/Imu", "sensor_msgs/NavSatFix"),
        notices=recording.notices,
    )


def _times(samples: Iterable[Sample], kind: type) -> Array:
    stamps = [getattr(s, "stamp_ns", None) for s in samples if type(s) is kind]
    return np.array([stamp for stamp in stamps if stamp], np.int64) // 1000


def _gnss_of_bag(recording: Recording) -> Gnss:
    fixes = recording.fixes
    count = len(fixes)
    velocity = np.full((count, 3), np.nan)
    for i, sample in enumerate(recording.velocities[:count]):
        velocity[i] = sample.vel_enu
    counts = [-1 if s.count is None else s.count for s in recording.samples if type(s) is SatelliteCount]
    spread = [np.nan if f.cov_enu is None else float(np.sqrt(0.5 * np.trace(f.cov_enu[:2, :2]))) for f in fixes]
    return Gnss(
        name="sensor_msgs/NavSatFix",
        time_us=np.array([f.stamp_ns for f in fixes], np.int64) // 1000,
        position=np.array([(f.lat, f.lon, f.alt) for f in fixes]),
        has_fix=np.array([f.status >= 0 for f in fixes]),
        velocity=velocity,
        accuracy=np.column_stack([spread, np.full((count, 2), np.nan)]),
        satellites=np.array((counts + [-1] * count)[:count], np.int64),
        utc_us=np.zeros(count, np.int64),
    )
