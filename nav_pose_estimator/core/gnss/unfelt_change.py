"""Does a receiver's velocity change by what the IMU feels? It does not when a spoofer begins to drag the fix along.

A spoofer whose positions go where its velocities say passes every test of GNSS against itself. But to begin, or to end,
its velocity has to change, and the vehicle feels no force for that. A steady drag is no acceleration and leaves no
trace: what is missed in the first seconds cannot be noticed later, and a drag that sets in as slowly as the
navigator's tilt is uncertain (0.1 deg is 0.017 m/s^2) is never noticed. So the mean difference between the receiver's
velocity and one that only the IMU carries along is compared over seconds, by the measure of what is usual in the same
flight, and with what tilt, heading, turns and accelerations may do. A change has to be over and to stay: a difference
that grows on and on is a wrong tilt. Pure Python, without a clock.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

Vector2 = tuple[float, float]

_SPAN = 4  # s of means before and after a change
_CHANGE = 1  # s that may lie between them
SPANS = 2 * _SPAN + _CHANGE
"""Seconds that are looked at."""
LASTS = _SPAN
"""s that a change has lasted when it is found."""
_VELOCITY_SD = 0.1  # m/s of one velocity on each axis
_SHARED = 0.05  # m/s that all velocities of a span have in common
_TIMING = 0.1  # s between the clocks of receiver and IMU: an acceleration looks like a change until it ends
_SCALE = 0.04  # of a change of velocity: scales and cross-axis errors
_RATIO = 4.2  # to what is usual ...
_USUAL_AT_LEAST = 0.25
_LEAST, _MOST = 0.4, 20.0  # m/s: smaller ones are chance; a receiver that is faster still is another vehicle's
_SETTLED = 0.35  # of the change, by which the seconds after it may differ: what goes on and on is a wrong tilt
_HISTORY = 20  # comparisons before anything is concluded
_MEMORY = 300.0  # comparisons: what is usual may change with the flight


@dataclass(frozen=True, slots=True)
class Second:
    """Means over one second."""

    apart: Vector2
    """m/s, East and North: the receiver's velocity less the IMU's, up to a constant."""
    count: int
    """Velocities that are in it."""
    velocity: Vector2
    """m/s, the IMU's."""
    heading_sd: float
    """rad."""
    drift_sd: float
    """m/s^2, by which the IMU's velocity may drift away: tilt, and bias of the accelerometer."""


@dataclass(eq=False)
class UnfeltChange:
    """Ask it every second; what is usual is learned from the answers, a few seconds late."""

    usual: float = field(default=0.0, init=False)
    """Root mean square of what has been found so far, in deviations."""
    ratio: float = field(default=0.0, init=False)
    """Of the last comparison to that."""
    _compared: int = field(default=0, init=False)
    _fresh: deque[float] = field(default_factory=deque, init=False)  # deviations that may be part of a change

    def find(self, seconds: Sequence[Second]) -> Vector2 | None:
        """The change [m/s] of the receiver's velocity in the last of ``seconds`` that no force explains, or None.

        ``seconds`` follow one another and belong to one IMU velocity that nothing has corrected; ``SPANS`` say enough.
        """
        found = [_compare(seconds, gap) for gap in range(_CHANGE + 1) if len(seconds) >= 2 * _SPAN + gap]
        if not found:
            return None
        deviations, change = max(found, key=lambda one: one[0])
        self.ratio = deviations / max(self.usual, _USUAL_AT_LEAST)
        size = math.hypot(*change)
        if self._compared >= _HISTORY and self.ratio > _RATIO and _LEAST < size < _MOST and _has_settled(seconds, size):
            self._fresh.clear()
            return change
        self._fresh.append(min(deviations, _RATIO * max(self.usual, _USUAL_AT_LEAST)))
        if len(self._fresh) > 2 * _SPAN:
            self._compared += 1
            square = self.usual**2
            self.usual = math.sqrt(square + (self._fresh.popleft() ** 2 - square) / min(self._compared, _MEMORY))
        return None


def _has_settled(seconds: Sequence[Second], size: float) -> bool:
    apart = math.dist(seconds[-1].apart, seconds[-_SPAN].apart)
    return apart < _SETTLED * size + 2.0 * _SHARED


def _compare(seconds: Sequence[Second], gap: int) -> tuple[float, Vector2]:
    """The change between the last seconds and those ``gap`` [s] before them, in deviations and in m/s."""
    after, before = seconds[-_SPAN:], seconds[-2 * _SPAN - gap :][:_SPAN]
    change = _difference([s.apart for s in after], [s.apart for s in before])
    turned = _difference([s.velocity for s in after], [s.velocity for s in before])
    heading_sd = max(s.heading_sd for s in seconds)
    variance = (
        2.0 * _VELOCITY_SD**2 * sum(1.0 / sum(s.count for s in part) for part in (before, after))
        + _SHARED**2
        + (max(s.drift_sd for s in seconds) * (_SPAN + gap)) ** 2
        + (heading_sd**2 + _SCALE**2) * (turned[0] ** 2 + turned[1] ** 2)
        + (_TIMING * (_acceleration(after) + _acceleration(before))) ** 2
    )
    return math.hypot(*change) / math.sqrt(variance), change


def _difference(after: Sequence[Vector2], before: Sequence[Vector2]) -> Vector2:
    """Of the means."""
    east, north = (
        sum(one[axis] for one in after) / len(after) - sum(one[axis] for one in before) / len(before) for axis in (0, 1)
    )
    return east, north


def _acceleration(seconds: Sequence[Second]) -> float:
    """m/s^2, mean over ``seconds``."""
    return math.dist(seconds[-1].velocity, seconds[0].velocity) / (len(seconds) - 1)
