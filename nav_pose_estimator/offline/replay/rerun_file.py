"""Output of a replay for the Rerun viewer (``replay --rerun FILE.rrd``), if the package rerun-sdk is installed.

It contains reference and estimate as paths, the moving vehicle, and errors, sigmas and modes over the time of flight.
"""

from pathlib import Path
from typing import Any

import numpy as np

from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.flights.tracks import displacement_enu
from nav_pose_estimator.offline.replay.replay import ReplayResult
from nav_pose_estimator.offline.replay.report import errors_enu, mode_spans
from nav_pose_estimator.whole_file import replacing

TIMELINE = "flight"
_RATE = 20.0  # Hz
_COLORS = {"reference": (150, 158, 165), "estimate": (31, 111, 235), "outage": (209, 73, 91)}


def check(path: Path) -> None:
    """Raise ``UserError`` if the file cannot be written, before the work begins."""
    if path.suffix != ".rrd":
        raise UserError(f"--rerun writes a file that ends with .rrd, not {path.name!r}")
    if path.is_dir():
        raise UserError(f"--rerun {path} is a folder; choose another name")
    if not path.absolute().parent.is_dir():
        raise UserError(f"--rerun: the folder {path.absolute().parent} does not exist")
    try:
        import rerun  # noqa: F401
    except ImportError:
        raise UserError("--rerun needs the Python package rerun-sdk: pip install rerun-sdk") from None


def write_rerun(path: Path, result: ReplayResult) -> None:
    """Write the file atomically."""
    import rerun as rr

    stream = rr.RecordingStream("nav_pose_estimator")
    with replacing(path) as unfinished:
        stream.save(unfinished)
        _log_paths(rr, stream, result)
        _log_vehicle(rr, stream, result)
        _log_errors(rr, stream, result)
        for start, _, mode in mode_spans(result):
            stream.set_time(TIMELINE, duration=start)
            stream.log("mode", rr.TextLog(mode.value))
        stream.flush()
        stream.disconnect()


def _log_paths(rr: Any, stream: Any, result: ReplayResult) -> None:
    """Log the static paths, East, North, Up [m] from the origin."""
    origin = _origin(result)
    stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    estimate = displacement_enu(result.track.position, origin)
    _log_path(rr, stream, "estimate", estimate, "estimate")
    if len(result.reference):
        _log_path(rr, stream, "reference", displacement_enu(result.reference.position, origin), "reference")
    for i, outage in enumerate(result.outages):
        inside = outage.contains(result.track.t)
        _log_path(rr, stream, f"outage_{i}", estimate[inside], "outage")


def _log_path(rr: Any, stream: Any, name: str, enu: np.ndarray, color: str) -> None:
    good = enu[np.isfinite(enu).all(axis=1)]
    if len(good):
        stream.log(f"world/{name}", rr.LineStrips3D([good], colors=[_COLORS[color]]), static=True)


def _log_vehicle(rr: Any, stream: Any, result: ReplayResult) -> None:
    """Position and attitude of the vehicle, and its axes."""
    step = max(round(len(result.track) / max(result.recording.duration * _RATE, 1.0)), 1)
    t, q = result.track.t[::step], result.track.q_nb[::step]
    enu = displacement_enu(result.track.position[::step], _origin(result))
    stream.log("world/vehicle", rr.TransformAxes3D(2.0), static=True)
    columns = rr.Transform3D.columns(translation=enu, quaternion=q[:, [1, 2, 3, 0]])
    stream.send_columns("world/vehicle", indexes=[rr.TimeColumn(TIMELINE, duration=t)], columns=columns)
    _log_number(rr, stream, "horizontal/three_sigma", t, 3.0 * result.track.horizontal_sd[::step])


def _log_errors(rr: Any, stream: Any, result: ReplayResult) -> None:
    """Errors against the reference [m]."""
    times, errors = errors_enu(result)
    _log_number(rr, stream, "horizontal/error", times, np.linalg.norm(errors[:, :2], axis=1))
    _log_number(rr, stream, "vertical/error", times, errors[:, 2])


def _log_number(rr: Any, stream: Any, name: str, t: np.ndarray, values: np.ndarray) -> None:
    good = np.isfinite(values)
    index = rr.TimeColumn(TIMELINE, duration=t[good])
    stream.send_columns(name, indexes=[index], columns=rr.Scalars.columns(scalars=values[good]))


def _origin(result: ReplayResult) -> np.ndarray:
    return np.array(result.origin or result.track.position[0])
