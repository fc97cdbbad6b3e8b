"""Pairs of magnetic fields in a recording, with the rotation between them by the gyroscope."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from nav_pose_estimator.core.alignment.levelling import dipole_dip
from nav_pose_estimator.core.numerics.rotation import quat_conjugate, quat_from_rotvec, quat_multiply, quat_to_matrix
from nav_pose_estimator.engine.samples import ImuBlock, MagSample
from nav_pose_estimator.offline.flights.recording import Recording

LAG = 2.0  # s between the fields of a pair: long against noise, and short enough for the gyroscope bias
_PARTS = ("before", "after", "turn", "down")
_PERIOD = 0.1  # s between pairs
_FORCE_WINDOW = 1.0  # s over which the specific force is averaged
LONGEST_STEP = 0.5  # s: longest gap of IMU or magnetometer within a pair


@dataclass(frozen=True)
class FieldPairs:
    """``before``, ``after`` (N, 3) [uT] as published, ``turn`` (N, 3, 3) from the later axes of the IMU to the earlier.

    ``down`` (N, 3): unit vector opposite to the mean specific force around the earlier field, times the sine of the
    expected dip at the place; zero where the place is unknown. Its product with a correct field is positive.
    """

    before: np.ndarray
    after: np.ndarray
    turn: np.ndarray
    down: np.ndarray

    def __len__(self) -> int:
        return len(self.before)


def joined(parts: list[FieldPairs]) -> FieldPairs:
    """Join the pairs of several recordings."""
    return FieldPairs(*(np.concatenate([getattr(p, name) for p in parts]) for name in _PARTS))


def field_pairs(recording: Recording, gyro_bias: np.ndarray | None) -> FieldPairs:
    """All pairs of ``recording``, in axes as published; ``gyro_bias`` (3,) [rad/s] is subtracted if known."""
    t_field, field = _fields(recording)
    imu = recording.imu
    t_imu = (imu.stamps_ns - recording.epoch_ns) * 1e-9
    inside = (t_field > t_imu[0]) & (t_field < t_imu[-1])
    t_field, field = _thinned(t_field[inside], field[inside])
    attitudes = _attitudes_at(t_field, t_imu, imu.gyro if gyro_bias is None else imu.gyro - gyro_bias)
    gaps = np.r_[t_imu[:-1][np.diff(t_imu) > LONGEST_STEP], t_field[:-1][np.diff(t_field) > LONGEST_STEP]]
    later = np.searchsorted(t_field, t_field + LAG)
    rows: list[tuple[int, int]] = []
    for i, k in enumerate(later.tolist()):
        if k < len(t_field) and not np.any((gaps >= t_field[i]) & (gaps < t_field[k])):
            rows.append((i, k))
    turn = [quat_to_matrix(quat_multiply(quat_conjugate(attitudes[i]), attitudes[k])) for i, k in rows]
    first, second = np.array(rows, dtype=int).reshape(-1, 2).T
    down = -_sine_of_dip(recording) * _mean_force(imu, t_imu, t_field[first])
    return FieldPairs(field[first], field[second], np.array(turn).reshape(-1, 3, 3), down)


def _sine_of_dip(recording: Recording) -> float:
    """Sine of the dip of the geomagnetic dipole at the first fix; zero without one."""
    fix = next((fix for fix in recording.fixes if fix.status >= 0 and math.isfinite(fix.lat + fix.lon)), None)
    return 0.0 if fix is None else math.sin(dipole_dip(fix.lat, fix.lon))


def _mean_force(imu: ImuBlock, t_imu: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Unit vectors (N, 3) of the specific force over ``_FORCE_WINDOW`` around ``t``."""
    sums = np.vstack((np.zeros(3), np.cumsum(imu.accel, axis=0)))
    begin, end = (np.searchsorted(t_imu, t + half * _FORCE_WINDOW) for half in (-0.5, 0.5))
    force = sums[np.maximum(end, begin + 1)] - sums[begin]
    return np.asarray(force / np.linalg.norm(force, axis=1, keepdims=True))


def _fields(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """Times (N,) [s] and fields (N, 3) [uT] of all magnetometer samples, in order of time."""
    samples = [s for s in recording.samples if isinstance(s, MagSample)]
    t = (np.array([s.stamp_ns for s in samples], dtype=np.int64) - recording.epoch_ns) * 1e-9
    field = np.array([s.field for s in samples], dtype=float).reshape(-1, 3) * 1e6
    good = np.isfinite(field).all(axis=1) & field.any(axis=1)
    t, first = np.unique(t[good], return_index=True)
    return t, field[good][first]


def _thinned(t: np.ndarray, field: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Times and fields decimated to about one per ``_PERIOD``."""
    if len(t) < 2:
        return t, field
    count = max(round(_PERIOD / max(float(np.median(np.diff(t))), 1e-3)), 1)
    middle = slice((count - 1) // 2, None, count)
    return t[middle], field[middle]


def _attitudes_at(t: np.ndarray, t_imu: np.ndarray, gyro: np.ndarray) -> np.ndarray:
    """Attitudes (N, 4) at ``t`` relative to the first IMU sample; rates are means over the interval up to the stamp."""
    attitudes = np.empty((len(t), 4))
    q, row = np.array([1.0, 0.0, 0.0, 0.0]), 1
    for i, now in enumerate(t):
        while row < len(t_imu) and t_imu[row] <= now:
            q = quat_multiply(q, quat_from_rotvec(gyro[row] * (t_imu[row] - t_imu[row - 1])))
            row += 1
        rest = now - t_imu[row - 1]
        attitudes[i] = quat_multiply(q, quat_from_rotvec(gyro[min(row, len(gyro) - 1)] * rest))
    return attitudes
