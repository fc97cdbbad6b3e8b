"""How large an error a second of IMU data may have caused: dead, clipped or struck sensors."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.numerics.imu_checks import is_calm
from nav_pose_estimator.core.numerics.jit import COMPILED
from nav_pose_estimator.engine.imu.rules import CLIPPED_FORCE, CLIPPED_RATE

_DEAD = 0.2  # s without any change: no live sensor sends one value for so long
_DEAD_AXIS = 0.5  # s without any change of one axis, while the others move: it is dead
_OTHERS_FORCE, _OTHERS_RATE = 0.3, 0.05  # m/s^2, rad/s by which they do
_STRUCK_FORCE, _STRUCK_RATE = 50.0, 10.0  # m/s^2, rad/s away from the last good second
_USUAL_FORCE, _USUAL_RATE = 2.0, 0.2  # m/s^2, rad/s: what a vehicle does while a sensor is dead
_BEYOND = 0.3  # of the range: how far a clipped value may have been beyond it
_MOST_TILT, _MOST_SPEED = 1.0, 200.0  # rad, m/s
_LEAST_TILT, _LEAST_SPEED = 0.005, 0.2  # less is within the filter's own noise


_BOUNDS = (0.99 * _STRUCK_RATE, 0.99 * _STRUCK_FORCE, CLIPPED_RATE, CLIPPED_FORCE)
"""Below them nothing is struck or clipped, whatever the rounding."""


class Doubt(NamedTuple):
    """Deviations to be added to attitude [rad], velocity [m/s], biases [rad/s, m/s^2] and horizontal position [m].

    ``lasting``: GNSS does not show at once what is wrong, so that it counts while GNSS is there, too.
    """

    tilt: float
    speed: float
    gyro_bias: float = 0.0
    accel_bias: float = 0.0
    way: float = 0.0
    lasting: bool = False

    def with_one_more(self, other: Doubt) -> Doubt:
        """Both of them, which have nothing to do with each other."""
        tilt, speed, gyro, accel, way = (math.hypot(a, b) for a, b in zip(self[:5], other[:5], strict=True))
        return Doubt(tilt, speed, gyro, accel, way, self.lasting or other.lasting)


class DoubtMeter:
    """Compares each second with the last good one."""

    def __init__(self) -> None:
        self._usual: np.ndarray | None = None  # (6,) means of the last good second

    def measure(self, rows: np.ndarray) -> Doubt | None:
        """Of the IMU rows (N, 7) of a second, with one from before it; None where nothing is wrong with them."""
        if len(rows) < 3:
            return None
        values = rows[1:, at.IMU_GYRO :]
        if COMPILED and self._usual is not None and is_calm(rows, self._usual, _BOUNDS, (_DEAD, _DEAD_AXIS)):
            self._usual = values.mean(axis=0)
            return None
        step = np.diff(rows[:, at.IMU_T])
        same = rows[1:, at.IMU_GYRO :] == rows[:-1, at.IMU_GYRO :]
        usual = values.mean(axis=0) if self._usual is None else self._usual
        tilt = _possible_error(step, values[:, :3], same[:, :3], usual[:3], _STRUCK_RATE, _USUAL_RATE, CLIPPED_RATE)
        speed = _possible_error(step, values[:, 3:], same[:, 3:], usual[3:], _STRUCK_FORCE, _USUAL_FORCE, CLIPPED_FORCE)
        tilt += _led_by_an_axis(step, values[:, :3], same[:, :3], usual[:3], _USUAL_RATE, _OTHERS_RATE)
        speed += _led_by_an_axis(step, values[:, 3:], same[:, 3:], usual[3:], _USUAL_FORCE, _OTHERS_FORCE)
        if tilt < _LEAST_TILT and speed < _LEAST_SPEED:
            self._usual = values.mean(axis=0)
            return None
        return Doubt(min(tilt, _MOST_TILT), min(speed, _MOST_SPEED))


def _possible_error(
    step: np.ndarray,
    values: np.ndarray,
    same: np.ndarray,
    usual: np.ndarray,
    struck: float,
    moves: float,
    range_: float,
) -> float:
    """Integral [unit s] of what one sensor's ``values`` (N, 3) may be wrong by: ``step`` (N,) s each."""
    away = np.sqrt(((values - usual) ** 2).sum(axis=1))
    total = float((step * away)[away > struck].sum())
    all_same = same.all(axis=1)
    run, lasts = _longest_run(step, all_same)
    if lasts >= _DEAD:
        total += lasts * max(moves, float(away[run].mean()))
    clipped = same & (np.abs(values) > range_) & ~all_same[:, None]
    total += _BEYOND * float((step[:, None] * np.abs(values))[clipped].sum())
    return total if math.isfinite(total) else 0.0


def _led_by_an_axis(
    step: np.ndarray, values: np.ndarray, same: np.ndarray, usual: np.ndarray, moves: float, others_move: float
) -> float:
    """The same of single axes that repeat one value while the others move."""
    total = 0.0
    for axis in range(3):
        run, lasts = _longest_run(step, same[:, axis])
        others = np.delete(values[run], axis, axis=1)
        if lasts >= _DEAD_AXIS and float(np.ptp(others, axis=0).min()) > others_move:
            total += lasts * max(moves, abs(float(values[run, axis].mean() - usual[axis])))
    return total if math.isfinite(total) else 0.0


def _longest_run(step: np.ndarray, same: np.ndarray) -> tuple[slice, float]:
    """Rows of the longest run of equal values (N,) with the first of them, and how long it lasts [s]."""
    change = np.flatnonzero(~same)
    begin, end = np.append(0, change), np.append(change, len(step))
    ends_at = np.append(0.0, np.cumsum(step))
    lasts = ends_at[end] - ends_at[begin]
    longest = int(np.argmax(lasts))
    return slice(int(begin[longest]), int(end[longest])), float(lasts[longest])
