"""Upper bound of the error that one second of faulty IMU data may have caused: dead, saturated or shocked sensors."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.numerics.imu_checks import is_calm
from nav_pose_estimator.core.numerics.jit import COMPILED
from nav_pose_estimator.engine.imu.rules import CLIPPED_FORCE, CLIPPED_RATE

_DEAD = 0.2  # s without any change of a sensor after which it is dead: no live sensor repeats a value for that long
_DEAD_AXIS = 0.5  # s without any change of one axis, while the others vary, after which the axis is dead
_OTHERS_FORCE, _OTHERS_RATE = 0.3, 0.05  # m/s^2, rad/s: variation of the other axes that this requires
_STRUCK_FORCE, _STRUCK_RATE = 50.0, 10.0  # m/s^2, rad/s: deviation from the last good second that is a shock
_USUAL_FORCE, _USUAL_RATE = 2.0, 0.2  # m/s^2, rad/s: motion that a vehicle may make while a sensor is dead
_BEYOND = 0.3  # how far a clipped value may have exceeded the range, relative to it
_MOST_TILT, _MOST_SPEED = 1.0, 200.0  # rad, m/s: limits of the result
_LEAST_TILT, _LEAST_SPEED = 0.005, 0.2  # rad, m/s: smaller errors are within the filter's own noise


_BOUNDS = (0.99 * _STRUCK_RATE, 0.99 * _STRUCK_FORCE, CLIPPED_RATE, CLIPPED_FORCE)
"""Bounds of the quick test ``is_calm``, with a margin for rounding."""


class Doubt(NamedTuple):
    """Standard deviations to be added to attitude [rad], velocity [m/s], biases, and horizontal position [m].

    ``lasting``: the error is not observable with GNSS at once, so that it counts while GNSS is good as well.
    """

    tilt: float
    speed: float
    gyro_bias: float = 0.0
    accel_bias: float = 0.0
    position: float = 0.0
    lasting: bool = False

    def with_one_more(self, other: Doubt) -> Doubt:
        """The sum of two independent errors."""
        tilt, speed, gyro, accel, position = (math.hypot(a, b) for a, b in zip(self[:5], other[:5], strict=True))
        return Doubt(tilt, speed, gyro, accel, position, self.lasting or other.lasting)


class DoubtMeter:
    """Measures the possible error of each second by comparison with the last good one."""

    def __init__(self) -> None:
        self._usual: np.ndarray | None = None  # (6,) means of the last good second

    def measure(self, rows: np.ndarray) -> Doubt | None:
        """Possible error by the IMU rows (N, 7) of a second, the first one from before it; None for good data."""
        if len(rows) < 3:
            return None
        if COMPILED and self._usual is not None and is_calm(rows, self._usual, _BOUNDS, (_DEAD, _DEAD_AXIS)):
            return None
        step, values = np.diff(rows[:, at.IMU_T]), rows[1:, at.IMU_GYRO :]
        same = rows[1:, at.IMU_GYRO :] == rows[:-1, at.IMU_GYRO :]
        usual = values.mean(axis=0) if self._usual is None else self._usual
        tilt = _possible_error(step, values[:, :3], same[:, :3], usual[:3], _STRUCK_RATE, _USUAL_RATE, CLIPPED_RATE)
        speed = _possible_error(step, values[:, 3:], same[:, 3:], usual[3:], _STRUCK_FORCE, _USUAL_FORCE, CLIPPED_FORCE)
        tilt += _error_of_dead_axes(step, values[:, :3], same[:, :3], usual[:3], _USUAL_RATE, _OTHERS_RATE)
        speed += _error_of_dead_axes(step, values[:, 3:], same[:, 3:], usual[3:], _USUAL_FORCE, _OTHERS_FORCE)
        if tilt < _LEAST_TILT and speed < _LEAST_SPEED:
            self._usual = values.mean(axis=0)
            return None
        dead = [_longest_run(step, same[:, one].all(axis=1))[1] >= _DEAD for one in (slice(0, 3), slice(3, 6))]
        # GNSS shows the heading error of a dead gyroscope only in accelerations; both at rest: no noise, a simulation
        return Doubt(min(tilt, _MOST_TILT), min(speed, _MOST_SPEED), lasting=dead == [True, False])


def _possible_error(
    step: np.ndarray,
    values: np.ndarray,
    same: np.ndarray,
    usual: np.ndarray,
    struck: float,
    moves: float,
    range_: float,
) -> float:
    """Integral [unit s] of the possible error of one sensor's ``values`` (N, 3), each over ``step`` (N,) [s]."""
    away = np.sqrt(((values - usual) ** 2).sum(axis=1))
    total = float((step * away)[away > struck].sum())
    all_same = same.all(axis=1)
    run, lasts = _longest_run(step, all_same)
    if lasts >= _DEAD:
        total += lasts * max(moves, float(away[run].mean()))
    clipped = same & (np.abs(values) > range_) & ~all_same[:, None]
    total += _BEYOND * float((step[:, None] * np.abs(values))[clipped].sum())
    return total if math.isfinite(total) else 0.0


def _error_of_dead_axes(
    step: np.ndarray, values: np.ndarray, same: np.ndarray, usual: np.ndarray, moves: float, others_move: float
) -> float:
    """Integral [unit s] of the possible error of single axes that repeat one value while the others vary."""
    total = 0.0
    for axis in range(3):
        run, lasts = _longest_run(step, same[:, axis])
        others = np.delete(values[run], axis, axis=1)
        if lasts >= _DEAD_AXIS and float(np.ptp(others, axis=0).min()) > others_move:
            total += lasts * max(moves, abs(float(values[run, axis].mean() - usual[axis])))
    return total if math.isfinite(total) else 0.0


def _longest_run(step: np.ndarray, same: np.ndarray) -> tuple[slice, float]:
    """Rows of the longest run of equal values (N,), including the first of them, and its duration [s]."""
    change = np.flatnonzero(~same)
    begin, end = np.append(0, change), np.append(change, len(step))
    ends_at = np.append(0.0, np.cumsum(step))
    lasts = ends_at[end] - ends_at[begin]
    longest = int(np.argmax(lasts))
    return slice(int(begin[longest]), int(end[longest])), float(lasts[longest])
