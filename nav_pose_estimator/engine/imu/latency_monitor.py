"""GNSS latency beyond ``gnss.delay``: estimated by shifting GNSS velocity changes against those of the IMU.

With stamps that are late by tau, the filter places the vehicle where it was tau ago, and adapts its heading: the
innovations do not show the latency for long. So over each window, the forces implied by GNSS velocity tau later are
compared with the IMU's impulses rotated by the best-fitting rotation. The variation of the difference, summed with
exponential forgetting, is approximately a parabola in tau with its minimum at the latency. In steady turns a rotation
explains any shift, and no latency is found. On ten recorded flights without ``gnss.delay`` the estimate was within 0.2
s of the known latency.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from nav_pose_estimator.core.alignment import motion_history
from nav_pose_estimator.core.numerics.jit import kernel

_STEP = 0.2  # s between the shifts that are compared
SHIFTS = _STEP * np.arange(-3, 4)
"""s: candidate latencies."""
_NONE = 3  # index of the shift 0
_MEMORY = 0.95  # forgetting factor of the sums from window to window
_MOST = 20.0  # (m/s)^2: limit of one window's variation, so that a shock does not dominate the sums
_LEAST = 0.15  # s: a smaller latency is not reported
_BETTER, _ENOUGH = 0.5, 0.8
"""A latency must reduce the sum without shift to less than this fraction, and by at least this amount [(m/s)^2]."""
_PROOF = 2  # consecutive windows that establish a latency
_OFFSET_SD = 0.1  # s: deviation of the latency of velocities from that of positions; on recorded flights at most 0.2
_LATELY = 10  # windows for which a latency that is no longer established remains probable


@dataclass(eq=False)
class LatencyMonitor:
    """``delay`` [s]: stamp minus time of validity of GNSS, beyond ``gnss.delay``; 0 while none is established."""

    delay: float = field(default=0.0, init=False)
    windows: float = field(default=0.0, init=False)
    """Number of windows in the sums, faded like them."""
    _estimate: float = field(default=0.0, init=False)  # s, with its variance [s^2]
    _variance: float = field(default=math.inf, init=False)
    _sums: np.ndarray = field(default_factory=lambda: np.zeros(len(SHIFTS)), init=False)
    _found: int = field(default=0, init=False)
    _remains: int = field(default=0, init=False)

    @property
    def is_probable(self) -> bool:
        """Whether a latency is established or was lately; noise can hide it for some windows."""
        return self._remains > 0

    @property
    def is_least(self) -> bool:
        """Whether ``delay`` is the largest one that is tried, so that the true one may be larger."""
        return abs(self.delay) >= float(SHIFTS[-1])

    def forget_time(self) -> None:
        """The navigator starts again: forget the windows, keep a latency that is probable."""
        if not self.is_probable:
            self._sums[:], self.windows, self._found = 0.0, 0.0, 0
            self._estimate, self._variance = 0.0, math.inf

    def rms(self, prior_sd: float) -> float:
        """Root mean square of the latency [s], which is zero with deviation ``prior_sd`` before any motion."""
        if not math.isfinite(self._variance):
            return prior_sd
        share = prior_sd**2 / (prior_sd**2 + self._variance)
        return math.hypot(share * self._estimate, math.sqrt(share * self._variance))

    def compare(self, impulses: np.ndarray, forces: np.ndarray | None) -> None:
        """Evaluate a window with motion: ``impulses`` (S, 3) [m/s] of the IMU.

        ``forces`` (len(SHIFTS), S, 3) [m/s] are those of GNSS later by each shift; None where GNSS has gaps.
        """
        if forces is None:
            return
        _add_up(self._sums, impulses, forces)
        self.windows = _MEMORY * self.windows + 1.0
        self._conclude()

    def _conclude(self) -> None:
        sums = self._sums.tolist()
        best = min(range(len(sums)), key=lambda k: sums[k])
        delay, least = float(SHIFTS[best]), sums[best]
        middle = min(max(best, 1), len(sums) - 2)
        slope, bend = sums[middle + 1] - sums[middle - 1], sums[middle - 1] - 2.0 * sums[middle] + sums[middle + 1]
        if middle == best:
            delay, least = delay - 0.5 * _STEP * slope / bend, least - 0.125 * slope**2 / bend
        is_late = least < _BETTER * sums[_NONE] and sums[_NONE] - least > _ENOUGH
        self._found = self._found + 1 if is_late else 0
        self.delay = delay if self._found >= _PROOF and abs(delay) > _LEAST else 0.0
        self._remains = _LATELY if self.delay else max(self._remains - 1, 0)
        self._estimate, self._variance = 0.0, math.inf
        if bend > 0.0:  # one degree of freedom for each window, because they overlap
            self._estimate = float(SHIFTS[middle]) - 0.5 * _STEP * slope / bend
            self._variance = 2.0 * _STEP**2 * max(least, 0.0) / (bend * self.windows) + _OFFSET_SD**2


@kernel
def _add_up(sums, impulses, forces):
    """Fade the ``sums`` (L,), and add the variation that each of ``forces`` (L, S, 3) leaves unexplained."""
    for late in range(len(sums)):
        _, apart = motion_history.unexplained(impulses, forces[late])
        sums[late] = _MEMORY * sums[late] + min(apart, _MOST)
