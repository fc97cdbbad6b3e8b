"""History of GNSS velocities, and the specific force that they imply from second to second."""

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.numerics.jit import kernel

Array = NDArray[np.float64]

GAP = 1.2
"""Longest time between velocities [s] over which they are interpolated."""
_MOST = 400  # velocities that are stored


class VelocityHistory:
    """Velocities in order of time."""

    def __init__(self, capacity: int = _MOST) -> None:
        self._rows = np.empty((capacity, 4))  # time [s] and velocity ENU [m/s]
        self._count = 0

    def add(self, t: float, east: float, north: float, up: float) -> None:
        """Add a velocity [m/s] valid at ``t`` [s]; it is ignored unless it is later than the last one."""
        if self._count == len(self._rows) and t > self._rows[-1, 0]:
            self._drop(1)
        self._count = _added(self._rows, self._count, t, east, north, up)

    def forget_before(self, t: float) -> None:
        """Drop velocities up to ``t`` [s]."""
        self._drop(int(self._rows[: self._count, 0].searchsorted(t, side="right")))

    def _drop(self, first: int) -> None:
        """Drop the ``first`` velocities (a number)."""
        if first:
            left = self._rows[first : self._count].copy()
            self._rows[: len(left)], self._count = left, len(left)

    def rows(self) -> Array:
        """View (N, 4) of the stored velocities: time [s] and velocity ENU [m/s]; read only."""
        return self._rows[: self._count]

    def forces(self, ends: np.ndarray, seconds: int, gravity: float) -> Array | None:
        """Specific force, integrated over each of the S ``seconds`` up to each of ``ends``, (L, S, 3) [m/s], ENU.

        ``ends`` (L,) [s], in order. None where the velocities do not cover that time or have a ``GAP``.
        """
        out = np.empty((len(ends), seconds, 3))
        return out if _changes(self._rows, self._count, ends, gravity, out) else None


@kernel
def _added(rows, count, t, east, north, up):
    """Append a velocity, if it is later than the last one, to the first ``count`` of ``rows``; returns their number."""
    if count > 0 and not t > rows[count - 1, 0]:
        return count
    rows[count, 0], rows[count, 1], rows[count, 2], rows[count, 3] = t, east, north, up
    return count + 1


@kernel
def _changes(rows, count, ends, gravity, out):
    """Write the changes from second to second, plus those by gravity, to ``out`` (L, S, 3); False across a gap."""
    seconds, begin, end = out.shape[1], ends[0] - out.shape[1], ends[-1]
    first = last = 0
    while first < count and rows[first, 0] <= begin - GAP:
        first += 1
    last = first
    while last < count and rows[last, 0] < end + GAP:
        if last > first and rows[last, 0] - rows[last - 1, 0] > GAP:
            return False
        last += 1
    if last - first < 3 or rows[first, 0] > begin or rows[last - 1, 0] < end:
        return False
    for late in range(len(ends)):
        k = first
        for s in range(seconds + 1):
            t = ends[late] - seconds + s
            while k < last - 2 and rows[k + 1, 0] <= t:
                k += 1
            share = (t - rows[k, 0]) / (rows[k + 1, 0] - rows[k, 0])
            for axis in range(3):
                v = rows[k, 1 + axis] + share * (rows[k + 1, 1 + axis] - rows[k, 1 + axis])
                if s > 0:
                    out[late, s - 1, axis] += v
                if s < seconds:
                    out[late, s, axis] = (gravity if axis == 2 else 0.0) - v
    return True
