"""Statistics of one second of IMU data, on which the plausibility checks are based."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.numerics.jit import inlined, kernel

_COMPLETE = 0.8  # s that the samples of a second have to span
_SETS_APART = 20.0  # significance, in standard errors, of the difference between every second sample and the rest
_APART_RATE, _APART_FORCE = 0.1, 0.5  # rad/s, m/s^2: smallest such difference that counts


class ImuSecond(NamedTuple):
    """Statistics over one second in body axes; ``end`` is its engine time [s]."""

    end: float
    samples: int
    rate: tuple[float, ...]
    """(3,) rad/s, mean."""
    force: tuple[float, ...]
    """(3,) m/s^2, mean."""
    norm: float
    """m/s^2, mean of the specific force's norm."""
    vibration: float
    """m/s^2: standard deviation of the specific force (all axes), from differences of consecutive samples."""
    shaking: float
    """rad/s: the same of the angular rate."""
    spread: tuple[float, ...]
    """(6,) range, largest less smallest value, of each axis of rate and force."""
    interleaved: bool
    """Whether every second sample is of another IMU."""
    gravity: float
    """m/s^2, norm of the mean force, which vibration does not affect."""
    turn: float
    """rad/s, norm of the mean rate."""


def second_of(rows: np.ndarray, end: float) -> ImuSecond | None:
    """Statistics of the IMU rows (N, 7) of the second up to ``end`` [s]; None where too many rows are missing."""
    if len(rows) < 5 or rows[-1, at.IMU_T] - rows[0, at.IMU_T] < _COMPLETE:
        return None
    numbers, squares = np.empty(13), np.empty((2, 3 * (len(rows) - 1)))
    interleaved = _summary(rows, numbers, squares)
    rate_x, rate_y, rate_z, force_x, force_y, force_z, *spread, norm = numbers.tolist()
    shaking, vibration = np.add.reduce(squares, axis=1).tolist()
    return ImuSecond(
        end=end,
        samples=len(rows),
        rate=(rate_x, rate_y, rate_z),
        force=(force_x, force_y, force_z),
        norm=norm,
        vibration=math.sqrt(0.5 * vibration / (len(rows) - 1)),
        shaking=math.sqrt(0.5 * shaking / (len(rows) - 1)),
        spread=tuple(spread),
        interleaved=interleaved,
        gravity=math.hypot(force_x, force_y, force_z),
        turn=math.hypot(rate_x, rate_y, rate_z),
    )


@kernel
def _summary(rows, out, squares):
    """Write means (6), ranges (6) and mean norm of the force to ``out`` (13,); True where two IMUs alternate.

    ``squares`` (2, 3 (N - 1)) receives the squared differences of consecutive samples, of rates and of forces.
    """
    count = len(rows)
    for i in range(count - 1):
        for axis in range(3):
            turn = rows[i + 1, at.IMU_GYRO + axis] - rows[i, at.IMU_GYRO + axis]
            push = rows[i + 1, at.IMU_ACCEL + axis] - rows[i, at.IMU_ACCEL + axis]
            squares[0, 3 * i + axis], squares[1, 3 * i + axis] = turn * turn, push * push
    norm = 0.0
    for i in range(count):
        x, y, z = rows[i, at.IMU_ACCEL], rows[i, at.IMU_ACCEL + 1], rows[i, at.IMU_ACCEL + 2]
        norm += math.sqrt(x * x + y * y + z * z)
    out[12] = norm / count
    interleaved = False
    for axis in range(6):
        total, least, most = 0.0, math.inf, -math.inf
        for i in range(count):
            value = rows[i, at.IMU_GYRO + axis]
            total += value
            least, most = min(least, value), max(most, value)
        out[axis], out[6 + axis] = total / count, most - least
        interleaved = interleaved or _is_interleaved(
            rows, at.IMU_GYRO + axis, _APART_RATE if axis < 3 else _APART_FORCE
        )
    return interleaved


@kernel
def _is_interleaved(rows, column, large):
    """Whether every second sample is offset by the same amount: demodulation at half the sample rate."""
    count = len(rows) - 2
    mean = 0.0
    for i in range(count):
        mean += _apart(rows, column, i) / count
    square = 0.0
    for i in range(count):
        square += (_apart(rows, column, i) - mean) ** 2
    return abs(mean) > _SETS_APART * math.sqrt(square / count**2) and abs(mean) > large


@inlined
def _apart(rows, column, i):
    """Sample ``i`` + 1 less the mean of its neighbours, with alternating sign."""
    apart = rows[i + 1, column] - 0.5 * (rows[i, column] + rows[i + 2, column])
    return apart if i % 2 == 0 else -apart
