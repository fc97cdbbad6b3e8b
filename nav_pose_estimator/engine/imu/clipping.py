"""Detection of saturation at an unknown range: repeated values at the largest value that the sensor has ever had.

An axis that resolves its noise or the vehicle's motion hardly ever repeats a value, except at the end of its range. A
sensor with a coarse resolution cannot be tested, because smooth peaks also look like plateaus. The signal lost beyond
the range is estimated by extending the slopes on both sides of a plateau.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.numerics.imu_checks import finest_and_largest

_LEAST = (0.8, 12.0)  # rad/s, m/s^2: smallest range that an IMU has
_RUN = 3  # consecutive equal values that count as a plateau
_CHANCE = math.log(1e-6)  # log of the probability of the plateaus by chance, below which saturation is established
_ENOUGH = 20  # values outside of the plateaus that are needed to estimate the rate of repetition
_RESOLVED = 2.0  # resolution: median second difference of an axis, in quantisation steps, that the test needs
_SAME = 1e-4  # relative tolerance of equality: the range of an integer is one step larger on the negative side
_LEAST_BEYOND, _MOST_BEYOND = 0.1, 2.0  # limits of the estimated height beyond the range, relative to it
_UNKNOWN = 0.3  # that height where the slopes are unknown


class Clipped(NamedTuple):
    """Signal lost by saturation in one second: angle [rad], velocity [m/s], and a clause that names the range."""

    angle: float
    velocity: float
    words: str


class ClipWatch:
    """The detector. It receives every second of IMU rows, and knows a range after a few plateaus at it."""

    def __init__(self) -> None:
        self._sensors = (_Range(0), _Range(3))

    def second(self, rows: np.ndarray) -> Clipped | None:
        """Evaluate the IMU rows (N, 7) of a second, the first one from before it; None without saturation."""
        if len(rows) < _RUN:
            return None
        gyroscope, accelerometer = self._sensors
        rates, forces = finest_and_largest(rows)
        angle, velocity = gyroscope.second(rows, *rates), accelerometer.second(rows, *forces)
        if angle > 0.0:
            words = f"gyroscope clips at {gyroscope.bound:.3g} rad/s"
        elif velocity > 0.0:
            words = f"accelerometer clips at {accelerometer.bound:.3g} m/s^2"
        else:
            return None
        return Clipped(angle, velocity, words)


@dataclass(eq=False, slots=True)
class _Range:
    """Range of one sensor: the largest absolute value of its axes so far, once plateaus at it establish saturation."""

    first: int  # first of its three columns
    bound: float = field(default=0.0, init=False)  # largest absolute value so far
    _evidence: float = field(default=0.0, init=False)  # log of the probability that the plateaus at it are chance
    _waiting: float = field(default=0.0, init=False)  # lost signal of plateaus that are not yet established
    _finest: float = field(default=math.inf, init=False)  # smallest step between two values: the resolution

    def second(self, rows: np.ndarray, finest: float, largest: float) -> float:
        """Integral [unit s] of the signal beyond the range; 0 while saturation is not established.

        ``finest`` and ``largest``: smallest step and largest absolute value of the second.
        """
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
        """Evaluate the plateaus of one axis (N,) that reaches the bound."""
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
    """Probability that a value outside of the plateaus repeats; 1 where it is unknown or the resolution too coarse."""
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
    """Area of the triangle that the slopes on both sides form above a plateau, with limits on its height."""
    bound, step = float(values[first]), float(np.median(np.diff(t)))
    lasts = float(t[last] - t[first]) + step
    rise = (bound - values[first - 2]) / (2.0 * step) if first >= 2 else 0.0
    fall = (bound - values[last + 2]) / (2.0 * step) if last + 2 < len(values) else 0.0
    rise, fall = rise or fall, fall or rise
    height = lasts * rise * fall / (rise + fall) if rise > 0.0 and fall > 0.0 else _UNKNOWN * bound
    return 0.5 * lasts * min(max(height, _LEAST_BEYOND * bound), _MOST_BEYOND * bound)
