"""Does a receiver's velocity change by what the IMU feels? It does not when a spoofer begins to drag the fix along.

A spoofer whose positions go where its velocities say passes every test of GNSS against itself. But to begin, or to end,
its velocity has to change, and the vehicle feels no force for that. A steady drag is no acceleration and leaves no
trace: what is missed in the first seconds cannot be noticed later, and a drag that sets in as slowly as the
navigator's tilt is uncertain (0.1 deg is 0.017 m/s^2) is never noticed. So the mean difference between the receiver's
velocity and one that only the IMU carries along is compared over seconds, by the measure of what is usual in the same
flight, and with what tilt, heading, turns and accelerations may do. A change has to be over and to stay: a difference
that grows on and on is a wrong tilt. Without a clock.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.numerics.jit import kernel

Array = NDArray[np.float64]

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


# --- columns of a second's means ------------------------------------------------------------------------------------
APART = 0  # 2: m/s, East and North: the receiver's velocity less the IMU's, up to a constant
VELOCITY = 2  # 2: m/s, the IMU's
COUNT = 4  # velocities that are in it
HEADING_SD = 5  # rad
DRIFT_SD = 6  # m/s^2, by which the IMU's velocity may drift away: tilt, and bias of the accelerometer
COLUMNS = 7


@dataclass(eq=False)
class UnfeltChange:
    """Ask it every second; what is usual is learned from the answers, a few seconds late."""

    usual: float = field(default=0.0, init=False)
    """Root mean square of what has been found so far, in deviations."""
    ratio: float = field(default=0.0, init=False)
    """Of the last comparison to that."""
    _compared: int = field(default=0, init=False)
    _fresh: deque[float] = field(default_factory=deque, init=False)  # deviations that may be part of a change

    def find(self, seconds: Array) -> Vector2 | None:
        """The change [m/s] of the receiver's velocity in the last of ``seconds`` that no force explains, or None.

        ``seconds`` (N, COLUMNS) follow one another and belong to one IMU velocity that nothing has corrected;
        ``SPANS`` say enough.
        """
        if len(seconds) < 2 * _SPAN:
            return None
        deviations, east, north = _largest_change(seconds)
        self.ratio = deviations / max(self.usual, _USUAL_AT_LEAST)
        size = math.hypot(east, north)
        if self._compared >= _HISTORY and self.ratio > _RATIO and _LEAST < size < _MOST and _has_settled(seconds, size):
            self._fresh.clear()
            return east, north
        self._fresh.append(min(deviations, _RATIO * max(self.usual, _USUAL_AT_LEAST)))
        if len(self._fresh) > 2 * _SPAN:
            self._compared += 1
            square = self.usual**2
            self.usual = math.sqrt(square + (self._fresh.popleft() ** 2 - square) / min(self._compared, _MEMORY))
        return None


def _has_settled(seconds: Array, size: float) -> bool:
    east, north = (seconds[-1, APART:VELOCITY] - seconds[-_SPAN, APART:VELOCITY]).tolist()
    return math.hypot(east, north) < _SETTLED * size + 2.0 * _SHARED


@kernel
def _largest_change(seconds):
    """The larger one of the changes that are or are not over at once: in deviations, and East and North in m/s."""
    largest = (-1.0, 0.0, 0.0)
    for gap in range(min(_CHANGE, len(seconds) - 2 * _SPAN) + 1):
        found = _change(seconds, gap)
        if found[0] > largest[0]:
            largest = found
    return largest


@kernel
def _change(seconds, gap):
    """The change between the last seconds and those ``gap`` [s] before them, in deviations and in m/s."""
    after = len(seconds) - _SPAN
    before = after - gap - _SPAN
    means, counts, heading_sd, drift_sd = np.zeros(4), np.zeros(2), 0.0, 0.0
    for k in range(_SPAN):
        for i in range(4):
            means[i] += (seconds[after + k, APART + i] - seconds[before + k, APART + i]) / _SPAN
        counts[0] += seconds[before + k, COUNT]
        counts[1] += seconds[after + k, COUNT]
    for k in range(len(seconds)):
        heading_sd, drift_sd = max(heading_sd, seconds[k, HEADING_SD]), max(drift_sd, seconds[k, DRIFT_SD])
    east, north, turned_east, turned_north = means
    variance = (
        2.0 * _VELOCITY_SD**2 * (1.0 / counts[0] + 1.0 / counts[1])
        + _SHARED**2
        + (drift_sd * (_SPAN + gap)) ** 2
        + (heading_sd**2 + _SCALE**2) * (turned_east**2 + turned_north**2)
        + (_TIMING * (_acceleration(seconds, after) + _acceleration(seconds, before))) ** 2
    )
    return math.hypot(east, north) / math.sqrt(variance), east, north


@kernel
def _acceleration(seconds, first):
    """m/s^2, mean over a span of ``seconds`` from the ``first`` on."""
    last = first + _SPAN - 1
    east = seconds[last, VELOCITY] - seconds[first, VELOCITY]
    north = seconds[last, VELOCITY + 1] - seconds[first, VELOCITY + 1]
    return math.hypot(east, north) / (_SPAN - 1)


@kernel
def second_of(trace, received, begin, heading_sd, drift_sd, out):
    """Means of the second from ``begin`` [s] on into ``out`` (COLUMNS,); False where nothing was received in it.

    ``trace`` (M, 4): time [s] and velocity [m/s] of the IMU in order, ``received`` (K, 4): the receiver's.
    """
    for i in range(COLUMNS):
        out[i] = 0.0
    k = 0
    for i in range(len(received)):
        t = received[i, 0]
        if not (begin <= t < begin + 1.0 and trace[0, 0] <= t and len(trace) > 1):
            continue
        k = 0 if t < trace[k, 0] else k
        while k < len(trace) - 2 and trace[k + 1, 0] <= t:
            k += 1
        share = min((t - trace[k, 0]) / (trace[k + 1, 0] - trace[k, 0]), 1.0)
        for axis in range(2):
            felt = trace[k, 1 + axis] + share * (trace[k + 1, 1 + axis] - trace[k, 1 + axis])
            out[APART + axis] += received[i, 1 + axis] - felt
            out[VELOCITY + axis] += felt
        out[COUNT] += 1.0
    if out[COUNT] == 0.0:
        return False
    for i in range(COUNT):
        out[i] /= out[COUNT]
    out[HEADING_SD], out[DRIFT_SD] = heading_sd, drift_sd
    return True
