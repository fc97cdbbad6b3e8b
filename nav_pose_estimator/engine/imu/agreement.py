"""Consistency test of GNSS and IMU: whether both observe the same changes of velocity.

The data of a base station, of another vehicle, or of a frozen or replaying receiver are consistent in themselves: the
positions follow from the velocities. But they do not describe this vehicle, and a filter that follows them attributes
the difference to tilt. The test compares, over windows of several seconds, the specific force integrated by the IMU and
rotated by the best-fitting rotation with the force that GNSS velocity implies. It compares the variation of the two
with the variation of their difference; a constant difference would be tilt, bias or scale. On thirteen recorded
flights, with and without compensated latency, the difference was below half of the variation, or the IMU measured too
little motion, in all windows but two consecutive ones: a shock (launch, crash) falls into two windows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from nav_pose_estimator.core.alignment import motion_history

# Limits of the variation of the force over a window, relative to its squared norm; 0.01 is about 1 m/s^2.
_MIN_EXCITATION = 0.01  # smallest variation of the IMU's force with which a contradiction counts
_MIN_MOTION = 0.002  # smallest variation of the IMU's force with which an agreement counts
_MAX_RESTING = 0.1  # largest variation of the GNSS force, relative to the IMU's, of a receiver that reports no motion
# Variation of the difference, relative to the larger of both: above the first they contradict, below the second agree.
_CONTRADICTS, _AGREES = 0.5, 0.25
_WINDOWS_TO_RAISE, _WINDOWS_TO_CLEAR = 3, 2  # consecutive windows that raise and clear the contradiction


@dataclass(eq=False, slots=True)
class MotionAgreement:
    """The test. It receives every window for which both GNSS and IMU are known."""

    apart: float = field(default=0.0, init=False)
    """m/s: difference of the velocity changes over the last window; 0 unless a contradiction is established."""
    share: float = field(default=0.0, init=False)
    """Unexplained variation of the force in the last window, relative to the larger variation of the two."""
    moves: bool = field(default=False, init=False)
    """Whether the IMU measured motion in the last window."""
    only_imu_moves: bool = field(default=False, init=False)
    """Whether the IMU measured motion in the last window and GNSS hardly any, without an agreement since the start."""
    is_contradicted: bool = field(default=False, init=False)
    """Whether a contradiction of GNSS and IMU is established."""
    _contradicting: int = field(default=0, init=False)  # consecutive windows that contradict
    _agreeing: int = field(default=0, init=False)  # consecutive windows that agree
    _has_agreed: bool = field(default=False, init=False)  # in any window since the start

    def forget_time(self) -> None:
        """Start counting windows anew after a change of the clock; an established contradiction remains."""
        self._contradicting = self._agreeing = 0
        self.apart = 0.0

    def compare(self, impulses: np.ndarray, forces: np.ndarray) -> None:
        """Compare a window: ``impulses`` (S, 3) [m/s] of the IMU in b at its beginning, ``forces`` (S, 3) of GNSS."""
        total = float(np.vdot(forces, forces))
        imu, apart = (part / total for part in motion_history.unexplained(impulses, forces))
        gnss = motion_history.varying(forces) / total
        moves = max(gnss, imu)
        self.share = apart / moves if moves > 0.0 else 0.0
        self._has_agreed = self._has_agreed or (imu > 0.5 * _MIN_MOTION and apart < _CONTRADICTS * moves)
        self.only_imu_moves = not self._has_agreed and imu > _MIN_EXCITATION and gnss < _MAX_RESTING * imu
        self.moves = imu > _MIN_MOTION
        contradicts = imu > _MIN_EXCITATION and apart > _CONTRADICTS * moves
        self._contradicting = self._contradicting + 1 if contradicts else 0
        self._agreeing = self._agreeing + 1 if self.moves and apart < _AGREES * moves else 0
        if self._contradicting >= _WINDOWS_TO_RAISE:
            self.is_contradicted = True
        elif self._agreeing >= _WINDOWS_TO_CLEAR:
            self.is_contradicted = False
        self.apart = math.sqrt(apart * total) if self.is_contradicted and contradicts else 0.0
