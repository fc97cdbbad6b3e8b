"""Have the changes of velocity that GNSS tells anything to do with those that the IMU feels?

A base station, another vehicle, a frozen or a replayed receiver may be sound in itself: its positions go where its
velocities say. But the vehicle moves otherwise, and a filter that has to follow explains the difference as tilt. So
over each window of seconds the impulses of the specific force, turned by the best rotation, are compared with the
forces that GNSS velocity tells: what varies in both, and what varies in their difference. A constant difference is
tilt, bias or scale. On thirteen recorded flights, with and without their latency, the difference was below half of what
varies, or the IMU felt too little, in all but two windows in a row: a blow (launch, crash) is in two.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from nav_pose_estimator.core.alignment import motion_history

_MOVES = 0.01  # of the squared force varies: about 1 m/s^2
_MOVES_AT_ALL = 0.002  # ... and so much will do to show that both agree
_RESTS = 0.1  # of what varies in the IMU's force, of a receiver that stands still
_UNLIKE, _ALIKE = 0.5, 0.25  # of what varies, by which they differ
_PROOF, _TAKEN_BACK = 3, 2  # windows in a row


@dataclass(eq=False)
class MotionAgreement:
    """Tell it every window in which both are known."""

    apart: float = field(default=0.0, init=False)
    """m/s by which velocities differ after a window in which they tell other motions; 0 unless that is proved."""
    share: float = field(default=0.0, init=False)
    """Of what varies in the force that the last window left unexplained."""
    moves: bool = field(default=False, init=False)
    """Whether the IMU moved in the last window."""
    only_imu_moves: bool = field(default=False, init=False)
    """Whether the IMU moved in the last window, and GNSS hardly, as ever since the start."""
    is_contradicted: bool = field(default=False, init=False)
    """Whether GNSS and IMU tell different motions beyond doubt."""
    _unlike: int = field(default=0, init=False)
    _alike: int = field(default=0, init=False)
    _has_agreed: bool = field(default=False, init=False)

    def forget_time(self) -> None:
        """Windows do not follow one another; what is proved stays proved."""
        self._unlike = self._alike = 0
        self.apart = 0.0

    def compare(self, impulses: np.ndarray, forces: np.ndarray) -> None:
        """A window: ``impulses`` (S, 3) [m/s] in the axes of its beginning, ``forces`` (S, 3) as GNSS tells them."""
        total = float(np.vdot(forces, forces))
        imu, apart = (part / total for part in motion_history.unexplained(impulses, forces))
        gnss = motion_history.varying(forces) / total
        moves = max(gnss, imu)
        self.share = apart / moves if moves > 0.0 else 0.0
        self._has_agreed = self._has_agreed or (imu > 0.5 * _MOVES_AT_ALL and apart < _UNLIKE * moves)
        self.only_imu_moves = not self._has_agreed and imu > _MOVES and gnss < _RESTS * imu
        self.moves = imu > _MOVES_AT_ALL
        unlike = imu > _MOVES and apart > _UNLIKE * moves
        self._unlike = self._unlike + 1 if unlike else 0
        self._alike = self._alike + 1 if self.moves and apart < _ALIKE * moves else 0
        if self._unlike >= _PROOF:
            self.is_contradicted = True
        elif self._alike >= _TAKEN_BACK:
            self.is_contradicted = False
        self.apart = math.sqrt(apart * total) if self.is_contradicted and unlike else 0.0
