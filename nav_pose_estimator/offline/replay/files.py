"""Output files of a replay: summary.json, trajectory.tum, estimate.csv and the solution bag."""

import math
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from nav_pose_estimator.core.earth.ellipsoid import lla_to_enu
from nav_pose_estimator.core.numerics.decimal_text import decimal_rows
from nav_pose_estimator.core.numerics.rotation import euler_from_quat_many
from nav_pose_estimator.engine.parameters.schema import flatten
from nav_pose_estimator.engine.solutions import Mode
from nav_pose_estimator.offline.flights.tracks import Track
from nav_pose_estimator.offline.json_file import versions, write_json
from nav_pose_estimator.offline.replay import second_opinion
from nav_pose_estimator.offline.replay.replay import ReplayResult
from nav_pose_estimator.offline.replay.report import mode_spans
from nav_pose_estimator.offline.replay.warnings import warnings

SUMMARY, TUM, CSV, REPORT, SOLUTION = "summary.json", "trajectory.tum", "estimate.csv", "report.html", "solution"
CSV_COLUMNS = (
    "t_s,lat_deg,lon_deg,alt_m,east_m,north_m,up_m,v_east_mps,v_north_mps,v_up_mps,roll_deg,pitch_deg,yaw_deg,"
    "sd_east_m,sd_north_m,sd_up_m,mode"
)
_CSV_DECIMALS = (4, 9, 9, *(4,) * 13)
_TUM_DECIMALS = (6, 6, 6, 9, 9, 9, 9)


def decimated(track: Track, rate_hz: float) -> Iterator[Track]:
    """Yield the track at up to ``rate_hz`` in parts, because its text needs twenty times the memory."""
    last = -(1 << 62)
    for piece in track.pieces():
        slots = np.floor(piece.t * rate_hz + 1e-6).astype(np.int64)
        chosen = np.diff(slots, prepend=last) != 0
        last = int(slots[-1])
        yield Track(piece.t[chosen], piece.rows[chosen])


def write_summary(path: Path, result: ReplayResult, wall_seconds: float) -> dict[str, Any]:
    """Write the results of a replay for scripts, and return them; NaN becomes null."""
    recording, status, spans = result.recording, result.status, mode_spans(result)
    summary = {
        "bag": recording.path.name,
        "duration_s": recording.duration,
        "imu_samples": recording.imu_count,
        "reference": result.reference.kind if len(result.reference) else None,
        "gnss_delay_s": result.parameters.gnss.delay,
        "final_mode": status.mode.value,
        "seconds_aided": sum(end - start for start, end, mode in spans if mode is Mode.AIDED),
        "first_aided_s": next((start for start, _, mode in spans if mode is Mode.AIDED), None),
        "modes": [{"start_s": start, "end_s": end, "mode": mode.value} for start, end, mode in spans],
        "outages": [
            {key: value for key, value in vars(e).items() if not isinstance(value, np.ndarray)} for e in result.errors
        ],
        "outage_proof": result.proof,
        "second_opinion": second_opinion.figures(result),
        "not_finite_rows": sum(int((~np.isfinite(p.rows).all(axis=1)).sum()) for p in result.track.pieces()),
        "counters": {**status.counters, **result.recording.counters},
        "values": status.values,
        "notices": recording.notices,
        "warnings": [asdict(warned) for warned in warnings(result)],
        "estimator_seconds": result.seconds,
        "times_real_time": recording.duration / max(result.seconds, 1e-9),
        "wall_seconds": wall_seconds,
        "versions": versions(),
        "parameters": flatten(result.parameters),
    }
    return write_json(path, summary)


def write_tum(path: Path, result: ReplayResult, rate_hz: float) -> None:
    """Write lines ``stamp x y z qx qy qz qw`` with ENU metres from the origin, the format of evo."""
    with path.open("w", encoding="utf-8") as file:
        for track in decimated(result.track, rate_hz):
            rows = decimal_rows(
                np.column_stack([_local(track, result), track.q_nb[:, [1, 2, 3, 0]]]), _TUM_DECIMALS, " "
            )
            stamps = (np.round(track.t * 1e9).astype(np.int64) + result.recording.epoch_ns).tolist()
            file.writelines(f"{s // 10**9}.{s % 10**9:09d} {row}\n" for s, row in zip(stamps, rows, strict=True))


def write_csv(path: Path, result: ReplayResult, rate_hz: float) -> None:
    """Write the estimate as text with the columns ``CSV_COLUMNS``; t is relative to the bag's first stamp."""
    with path.open("w", encoding="utf-8") as file:
        file.write(CSV_COLUMNS + "\n")
        for track in decimated(result.track, rate_hz):
            angles = np.degrees(euler_from_quat_many(track.q_nb))
            position = track.position * np.array([180.0 / math.pi, 180.0 / math.pi, 1.0])
            parts = [track.t, position, _local(track, result), track.velocity, angles, track.sd("position")]
            rows = decimal_rows(np.column_stack(parts), _CSV_DECIMALS, ",")
            modes = modes_at(result, track.t)
            file.writelines(f"{row},{mode.value}\n" for row, mode in zip(rows, modes, strict=True))


def modes_at(result: ReplayResult, t: np.ndarray) -> list[Mode]:
    """The mode at each of the times ``t`` (N,) [s from the first stamp]."""
    starts, _, modes = zip(*mode_spans(result), strict=True)
    return [modes[i] for i in np.maximum(np.searchsorted(starts, t, side="right") - 1, 0)]


def _local(track: Track, result: ReplayResult) -> np.ndarray:
    origin = result.origin or (tuple(result.track.position[0]) if len(track) else (0.0, 0.0, 0.0))
    return np.asarray(lla_to_enu(*track.position.T, *origin)).reshape(-1, 3)
