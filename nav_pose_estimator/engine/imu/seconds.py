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
    numbers = np.empty(15)
    interleaved = _summary(rows, numbers)
    rate_x, rate_y, rate_z, force_x, force_y, force_z, *spread, norm, shaking, vibration = numbers.tolist()
    return ImuSecond(
        end=end,
        samples=len(rows),
        rate=(rate_x, rate_y, rate_z),
        force=(force_x, force_y, force_z),
        norm=norm,
        vibration=vibration,
        shaking=shaking,
        spread=tuple(spread),
        interleaved=interleaved,
        gravity=math.hypot(force_x, force_y, force_z),
        turn=math.hypot(rate_x, rate_y, rate_z),
    )


@kernel
def _summary(rows, out):
    """Write means (6), ranges (6), mean norm of the force, shaking and vibration to ``out`` (15,).

    Returns True where two IMUs alternate.
    """
    count, interleaved = len(rows), False
    out[12] = out[13] = out[14] = 0.0
    for i in range(count):
        x, y, z = float(rows[i, at.IMU_ACCEL]), float(rows[i, at.IMU_ACCEL + 1]), float(rows[i, at.IMU_ACCEL + 2])
        out[12] += math.sqrt(x * x + y * y + z * z)
    out[12] /= count
    for axis in range(6):
        total, least, most, squares = 0.0, math.inf, -math.inf, 0.0
        before = float(rows[0, at.IMU_GYRO + axis])
        for i in range(count):
            value = float(rows[i, at.IMU_GYRO + axis])
            total += value
            least, most = min(least, value), max(most, value)
            squares += (value - before) ** 2
            before = value
        out[axis], out[6 + axis] = total / count, most - least
        out[13 + axis // 3] += squares
        interleaved = interleaved or _is_interleaved(
            rows, at.IMU_GYRO + axis, _APART_RATE if axis < 3 else _APART_FORCE
        )
    for sensor in range(2):
        out[13 + sensor] = math.sqrt(0.5 * out[13 + sensor] / (count - 1))
    return interleaved


@kernel
def _is_interleaved(rows, column, large):
    """Whether every second sample is offset by the same amount: demodulation at half the sample rate."""
    count = len(rows) - 2
    mean = 0.0
    for i in range(count):
        mean += _apart(rows, column, i)
    mean /= count
    if abs(mean) <= large:
        return False
    square = 0.0
    for i in range(count):
        square += (_apart(rows, column, i) - mean) ** 2
    return abs(mean) > _SETS_APART * math.sqrt(square / count**2)


@inlined
def _apart(rows, column, i):
    """Sample ``i`` + 1 less the mean of its neighbours, with alternating sign."""
    apart = float(rows[i + 1, column]) - 0.5 * (float(rows[i, column]) + float(rows[i + 2, column]))
    return apart if i % 2 == 0 else -apart
