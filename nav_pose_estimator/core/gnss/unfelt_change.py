"""Detection of GNSS velocity changes that the IMU does not measure, as at the beginning of a spoofed drift.

A spoofer whose positions agree with its velocities passes every test of GNSS against itself. But when the drift begins
or ends, its velocity changes without a force on the vehicle. A steady drift is no acceleration and cannot be observed:
a change that is missed in the first seconds is never found, nor one as slow as the navigator's tilt is uncertain (0.1
deg is 0.017 m/s^2). So the difference between the receiver's velocity and one propagated by the IMU alone is averaged
over seconds, and its change is compared with the uncertainty by tilt, heading, turns and accelerations, and with the
changes usual in the same flight. A change must be complete and lasting; a difference that keeps growing is a tilt
error. Without a clock.
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

_SPAN = 4  # s that are averaged before and after a change
_CHANGE = 1  # s that a change itself may take
SPANS = 2 * _SPAN + _CHANGE
"""s of data that the test uses."""
LASTS = _SPAN
"""s that a change has lasted when it is found."""
_VELOCITY_SD = 0.1  # m/s: white noise of one velocity on each axis
_SHARED = 0.05  # m/s: error that all velocities of a span have in common
_TIMING = 0.1  # s: time offset of receiver and IMU, by which an acceleration looks like a change until it ends
_SCALE = 0.04  # scale and cross-axis errors relative to a change of velocity
_RATIO = 4.2  # smallest ratio of a change to the usual ones
_USUAL_AT_LEAST = 0.25  # floor of the usual changes, in standard deviations
_LEAST, _MOST = 0.4, 20.0  # m/s: range of changes that count; larger ones are of another vehicle's receiver
_SETTLED = 0.35  # largest difference of the seconds after a change, relative to it
_HISTORY = 20  # comparisons before the first conclusion
_FAMILIAR, _SLOW = 2.0, 2.0  # factor on the largest manoeuvre so far, plus m/s: limit up to which ``usual`` is valid
_MEMORY = 300.0  # comparisons over which the usual changes are averaged


# --- columns of a second's means: index of each quantity, with its size if that is not 1 -----------------------------
APART = 0  # (2) m/s, East and North: the receiver's velocity minus that of the IMU, up to a constant
VELOCITY = 2  # (2) m/s, East and North: velocity propagated by the IMU
COUNT = 4  # number of GNSS velocities in the means
HEADING_SD = 5  # rad: standard deviation of the heading
DRIFT_SD = 6  # m/s^2: standard deviation of the IMU velocity's drift, by tilt and accelerometer bias
COLUMNS = 7


@dataclass(eq=False, slots=True)
class UnfeltChange:
    """The test, called every second; the usual size of changes is learned from earlier calls."""

    usual: float = field(default=0.0, init=False)
    """RMS of the changes so far, in standard deviations."""
    ratio: float = field(default=0.0, init=False)
    """Ratio of the last change to it."""
    _compared: int = field(default=0, init=False)
    _moved: float = field(default=0.0, init=False)  # m/s: largest change of velocity by the IMU in a comparison
    # both, of comparisons that may contain a change
    _pending: deque[tuple[float, float]] = field(default_factory=deque, init=False)

    def find(self, seconds: Array) -> Vector2 | None:
        """The change [m/s] of the receiver's velocity in the last of ``seconds`` that no force explains, or None.

        ``seconds`` (N, COLUMNS) are consecutive and belong to one velocity propagated by the IMU without corrections;
        ``SPANS`` of them are enough.
        """
        if len(seconds) < 2 * _SPAN:
            return None
        deviations, east, north = _largest_change(seconds)
        self.ratio = deviations / max(self.usual, _USUAL_AT_LEAST)
        size = math.hypot(east, north)
        moved = _moved(seconds)
        known = self._compared >= _HISTORY and moved < _FAMILIAR * self._moved + _SLOW
        if known and self.ratio > _RATIO and _LEAST < size < _MOST and _has_settled(seconds, size):
            self._pending.clear()
            return east, north
        self._pending.append((min(deviations, _RATIO * max(self.usual, _USUAL_AT_LEAST)), moved))
        if len(self._pending) > 2 * _SPAN:
            self._compared += 1
            square, (usual, moved) = self.usual**2, self._pending.popleft()
            self.usual = math.sqrt(square + (usual**2 - square) / min(self._compared, _MEMORY))
            self._moved = max(self._moved, moved)
        return None


def _moved(seconds: Array) -> float:
    """Change of the velocity by the IMU [m/s] from the first to the last seconds of a comparison."""
    east, north = (seconds[-1, VELOCITY:COUNT] - seconds[-SPANS:][0, VELOCITY:COUNT]).tolist()
    return math.hypot(east, north)


def _has_settled(seconds: Array, size: float) -> bool:
    east, north = (seconds[-1, APART:VELOCITY] - seconds[-_SPAN, APART:VELOCITY]).tolist()
    return math.hypot(east, north) < _SETTLED * size + 2.0 * _SHARED


@kernel
def _largest_change(seconds):
    """The largest change over all gaps: in standard deviations, and its East and North components [m/s]."""
    largest = (-1.0, 0.0, 0.0)
    for gap in range(min(_CHANGE, len(seconds) - 2 * _SPAN) + 1):
        found = _change(seconds, gap)
        if found[0] > largest[0]:
            largest = found
    return largest


@kernel
def _change(seconds, gap):
    """Change between the last seconds and those ``gap`` [s] before them, in standard deviations and in m/s."""
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
    """Mean acceleration [m/s^2] over a span of ``seconds`` from the ``first`` on."""
    last = first + _SPAN - 1
    east = seconds[last, VELOCITY] - seconds[first, VELOCITY]
    north = seconds[last, VELOCITY + 1] - seconds[first, VELOCITY + 1]
    return math.hypot(east, north) / (_SPAN - 1)


@kernel
def add_second(seconds, count, trace, received, begin, heading_sd, drift_sd):
    """Append the means of the second from ``begin`` [s] on to the first ``count`` rows of ``seconds`` (SPANS, COLUMNS).

    The oldest row is dropped if all are in use. Returns the new count, 0 without a GNSS velocity in that second.
    ``trace`` (M, 4): time [s] and velocity [m/s] propagated by the IMU, in order of time; ``received`` (K, 4): the same
    of the receiver.
    """
    if count == len(seconds):
        count -= 1
        for i in range(count):
            for k in range(COLUMNS):
                seconds[i, k] = seconds[i + 1, k]
    return count + 1 if _mean_over(trace, received, begin, heading_sd, drift_sd, seconds[count]) else 0


@kernel
def _mean_over(trace, received, begin, heading_sd, drift_sd, out):
    """Write the means of ``add_second`` to ``out`` (COLUMNS,); False without a GNSS velocity."""
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
            imu_velocity = trace[k, 1 + axis] + share * (trace[k + 1, 1 + axis] - trace[k, 1 + axis])
            out[APART + axis] += received[i, 1 + axis] - imu_velocity
            out[VELOCITY + axis] += imu_velocity
        out[COUNT] += 1.0
    if out[COUNT] == 0.0:
        return False
    for i in range(COUNT):
        out[i] /= out[COUNT]
    out[HEADING_SD], out[DRIFT_SD] = heading_sd, drift_sd
    return True
