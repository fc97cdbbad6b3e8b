"""An IMU that clips, whatever its range: equal values in a row at the largest value that the sensor has ever had.

Where an axis resolves its own noise or the vehicle's motion, it hardly ever repeats a value; at the end of its range
it does so again and again. A sensor that is too coarse for that tells nothing, because its smooth peaks look the same.
What was missed lies between a plateau and the two slopes that lead to it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.numerics.imu_checks import finest_and_largest

_LEAST = (0.8, 12.0)  # rad/s, m/s^2: no IMU has a smaller range
_RUN = 3  # equal values in a row
_CHANCE = math.log(1e-6)  # of so many repetitions, by how often values elsewhere repeat
_ENOUGH = 20  # values elsewhere by which that is known
_RESOLVED = 2.0  # smallest steps by which an axis changes its slope, as a median
_SAME = 1e-4  # of a value: the range of an integer is one larger on the negative side
_LEAST_BEYOND, _MOST_BEYOND = 0.1, 2.0  # of the range: height of the part that was cut off
_UNKNOWN = 0.3  # ... where neither slope is known


class Clipped(NamedTuple):
    """What a second of clipped values has missed: angle [rad], velocity [m/s], and the range in words."""

    angle: float
    velocity: float
    words: str


class ClipWatch:
    """Give it every second of rows; it knows a range after a few runs, and counts from then on."""

    def __init__(self) -> None:
        self._sensors = (_Range(0), _Range(3))

    def second(self, rows: np.ndarray) -> Clipped | None:
        """Of the IMU rows (N, 7) of a second, with one from before it; None where nothing clips."""
        if len(rows) < _RUN:
            return None
        gyroscope, accelerometer = self._sensors
        angle, velocity = gyroscope.second(rows), accelerometer.second(rows)
        if angle > 0.0:
            words = f"gyroscope clips at {gyroscope.bound:.3g} rad/s"
        elif velocity > 0.0:
            words = f"accelerometer clips at {accelerometer.bound:.3g} m/s^2"
        else:
            return None
        return Clipped(angle, velocity, words)


@dataclass(eq=False)
class _Range:
    """The range of one sensor: the largest value of all its axes, if it proves to be more than that."""

    first: int  # of its three columns
    bound: float = field(default=0.0, init=False)
    _evidence: float = field(default=0.0, init=False)  # logarithm of the chance that it is none
    _waiting: float = field(default=0.0, init=False)  # what has been missed if it is one
    _finest: float = field(default=math.inf, init=False)  # step between two values: the sensor's resolution

    def second(self, rows: np.ndarray) -> float:
        """Integral of what lay beyond the range, 0 while that is not proved."""
        finest, largest = finest_and_largest(rows, at.IMU_GYRO + self.first)
        self._finest = min(self._finest, finest)
        if largest < max(_LEAST[self.first // 3], self.bound * (1.0 - _SAME)):
            return 0.0
        if largest > self.bound * (1.0 + _SAME):
            self.bound, self._evidence, self._waiting = largest, 0.0, 0.0
        t, columns = rows[:, at.IMU_T], rows[:, at.IMU_GYRO + self.first : at.IMU_GYRO + self.first + 3]
        for sign in (1.0, -1.0):
            for axis in np.flatnonzero((sign * columns).max(axis=0) >= self.bound * (1.0 - _SAME)).tolist():
                self._look_at(t, sign * columns[:, axis])
        if self._evidence > _CHANCE:
            return 0.0
        missed, self._waiting = self._waiting, 0.0
        return missed

    def _look_at(self, t: np.ndarray, values: np.ndarray) -> None:
        """An axis (N,) that reaches the bound."""
        plateaus = list(_plateaus(values, self.bound))
        chance = _chance_of_repeating(values, plateaus, self._finest)
        for first, last in plateaus:
            self._waiting += _beyond(t, values, first, last)
            if last - first + 1 >= _RUN:
                self._evidence += (last - first) * math.log(chance)


def _plateaus(values: np.ndarray, bound: float) -> Iterator[tuple[int, int]]:
    """First and last index of the runs of values (N,) at ``bound``."""
    at_it = values >= bound * (1.0 - _SAME)
    edges = np.flatnonzero(np.diff(np.r_[False, at_it, False]))
    for first, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        yield first, end - 1


def _chance_of_repeating(values: np.ndarray, plateaus: list[tuple[int, int]], finest: float) -> float:
    """How often values (N,) outside of the plateaus repeat themselves; 1 where that is unknown or says nothing."""
    outside = np.ones(len(values), dtype=bool)
    for first, last in plateaus:
        outside[first : last + 1] = False
    changes, bends = np.abs(np.diff(values)), np.abs(np.diff(values, 2))
    changes, bends = changes[outside[1:] & outside[:-1]], bends[outside[2:] & outside[1:-1] & outside[:-2]]
    if len(bends) < _ENOUGH:
        return 1.0
    if float(np.median(bends)) < _RESOLVED * finest * (1.0 - _SAME):
        return 1.0
    return (float((changes == 0.0).sum()) + 1.0) / (len(changes) + 2.0)


def _beyond(t: np.ndarray, values: np.ndarray, first: int, last: int) -> float:
    """Area of the triangle above a plateau that its slopes make, within what is likely."""
    bound, step = float(values[first]), float(np.median(np.diff(t)))
    lasts = float(t[last] - t[first]) + step
    rise = (bound - values[first - 2]) / (2.0 * step) if first >= 2 else 0.0
    fall = (bound - values[last + 2]) / (2.0 * step) if last + 2 < len(values) else 0.0
    rise, fall = rise or fall, fall or rise
    height = lasts * rise * fall / (rise + fall) if rise > 0.0 and fall > 0.0 else _UNKNOWN * bound
    return 0.5 * lasts * min(max(height, _LEAST_BEYOND * bound), _MOST_BEYOND * bound)
