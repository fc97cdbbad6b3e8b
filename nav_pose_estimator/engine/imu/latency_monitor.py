"""By how much does GNSS follow the IMU late? Asked of the changes of velocity in both, shifted against each other.

A receiver's stamp that is late by tau puts the vehicle where it was tau ago, with a heading that fits: no innovation
shows it for long. So over each window the forces that GNSS velocity tells, taken tau later, are compared with the
impulses that the IMU feels, turned by the best rotation. What varies in the difference, summed with a fading memory, is
a parabola in tau; its lowest point is the latency. In steady turns the rotation explains a shift, and nothing is found.
On ten recorded flights without ``gnss.delay`` it lay within 0.2 s of the latency that is known of them.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from nav_pose_estimator.core.alignment import motion_history

_STEP = 0.2  # s
SHIFTS = _STEP * np.arange(-3, 4)
"""s by which velocities may be late."""
_NONE = 3  # number of the shift that is none
_MEMORY = 0.95  # of the sums, from window to window
_BLOW = 20.0  # (m/s)^2: more of one window is a blow
_LEAST = 0.15  # s: less costs little
_BETTER, _ENOUGH = 0.5, 0.8
"""A shift has to leave so little of the difference, and to explain so much of it [(m/s)^2]."""
_PROOF = 2  # windows in a row


@dataclass(eq=False)
class LatencyMonitor:
    """``delay`` [s]: stamp minus validity of GNSS beyond ``gnss.delay``; 0 while none is proved."""

    delay: float = field(default=0.0, init=False)
    _sums: np.ndarray = field(default_factory=lambda: np.zeros(len(SHIFTS)), init=False)
    _found: int = field(default=0, init=False)

    def compare(self, impulses: np.ndarray, forces: np.ndarray | None) -> None:
        """A window in which the IMU moves: its ``impulses`` (S, 3) [m/s].

        ``forces`` (len(SHIFTS), S, 3) as GNSS told them so much later; None where it did not.
        """
        if forces is None:
            return
        apart = [motion_history.unexplained(impulses, shifted)[1] for shifted in forces]
        self._sums = _MEMORY * self._sums + np.minimum(apart, _BLOW)
        self._conclude()

    def _conclude(self) -> None:
        sums = self._sums.tolist()
        best = min(range(len(sums)), key=lambda k: sums[k])
        delay, least = float(SHIFTS[best]), sums[best]
        if 0 < best < len(sums) - 1:
            slope, bend = sums[best + 1] - sums[best - 1], sums[best - 1] - 2.0 * least + sums[best + 1]
            delay, least = delay - 0.5 * _STEP * slope / bend, least - 0.125 * slope**2 / bend
        is_late = least < _BETTER * sums[_NONE] and sums[_NONE] - least > _ENOUGH
        self._found = self._found + 1 if is_late else 0
        self.delay = delay if self._found >= _PROOF and abs(delay) > _LEAST else 0.0
