"""Heading monitor: heading error by correlation of GNSS velocity changes with the specific force, independent of P.

A filter can be consistent with a wrong heading for a while, because a tilt error of a/g looks like an acceleration a.
But the tilt error is constant over seconds, and the accelerations are not. Per window of six seconds, two sequences are
compared, each with its mean over the window removed: the horizontal changes of GNSS velocity from second to second, and
the specific force integrated with the gyroscope from the navigator's attitude at the beginning of the window. As
complex numbers u and h, East + i North, the angle of sum u conj(h) is the heading error, by linear regression, and the
correlation coefficient is its quality. The sums fade from window to window, and follow the rotations of the heading by
the filter's updates.

On thirteen recorded flights the angle was at most 29 deg where it counts, except one of 42 deg just after a launch.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass, field

import numpy as np

from nav_pose_estimator.core.alignment.motion_history import correlation, rotation_of
from nav_pose_estimator.core.numerics.jit import kernel
from nav_pose_estimator.core.numerics.rotation import quat_multiply, yaw_of
from nav_pose_estimator.core.numerics.vectors import load3, q_rotate
from nav_pose_estimator.core.numerics.wahba import best_rotation

_MEMORY = 0.7  # forgetting factor of the sums from one window to the next
_EXCITED = 0.6  # m/s: smallest root of the sum of squared changes that counts; GNSS velocities scatter by 0.1 to 0.2
_COHERENT = 0.7  # smallest correlation coefficient that counts
_WRONG = math.radians(40.0)  # heading error that counts as wrong
_REMEMBERED = 12  # s for which attitudes and rotations are kept
_PROOF = 2  # consecutive windows with a wrong heading that establish it


@dataclass(eq=False)
class HeadingMonitor:
    """``error`` [rad]: correction of the navigator's heading, counter-clockwise; 0 unless an error is established."""

    error: float = field(default=0.0, init=False)
    _attitudes: dict[int, np.ndarray] = field(default_factory=dict, init=False)  # (4,) of the navigator, by second
    _turned: dict[int, float] = field(default_factory=dict, init=False)  # rad: total turn by the filter's updates
    level: np.ndarray | None = field(default=None, init=False)
    """Attitude (4,) at the last whole second from IMU and GNSS velocity alone, when an error is established."""
    _rotations: dict[int, np.ndarray] = field(default_factory=dict, init=False)  # (4,) over the second that ends there
    _cross: complex = field(default=0j, init=False)  # sum of u conj(h), turned by ``_turned`` [(m/s)^2]
    _gnss_power: float = field(default=0.0, init=False)  # sum of |u|^2 [(m/s)^2]
    _imu_power: float = field(default=0.0, init=False)  # sum of |h|^2 [(m/s)^2]
    _wrong: int = field(default=0, init=False)  # consecutive windows with a wrong heading

    def forget(self) -> None:
        """Forget everything: the attitude was reset, or the clock changed."""
        self._attitudes.clear()
        self._turned.clear()
        self._rotations.clear()
        self._cross, self._gnss_power, self._imu_power, self._wrong, self.error = 0j, 0.0, 0.0, 0, 0.0

    def attitude(self, k: int, q_nb: np.ndarray) -> None:
        """Store the navigator's attitude (4,) at the whole second ``k``."""
        self._attitudes[k] = q_nb
        for known in (self._attitudes, self._turned, self._rotations):
            known.pop(k - _REMEMBERED, None)

    def add_rotation(self, k: int, angles: np.ndarray, bias: np.ndarray) -> None:
        """Store the rotation over the second that ends at ``k``, given as parts (N, 3) [rad].

        The parts contain the gyroscope's ``bias`` (3,) [rad/s]. What the heading turned beyond that rotation is due to
        the filter's updates.
        """
        rotation = self._rotations[k] = rotation_of(angles, bias)
        before, now = self._attitudes.get(k - 1), self._attitudes.get(k)
        if before is None or now is None:
            self._turned = {k: 0.0}
            return
        turned = math.remainder(_turn_beyond(rotation, before, now), 2.0 * math.pi)
        self._turned[k] = self._turned.get(k - 1, 0.0) + turned

    def compare(self, begin: int, impulses: np.ndarray, forces: np.ndarray) -> None:
        """Evaluate the window that begins at second ``begin``.

        ``impulses`` (S, 3) [m/s] are the specific force integrated over each second, in the axes of b at ``begin``;
        ``forces`` (S, 3) [m/s] the same in ENU according to GNSS velocity.
        """
        q, turned = self._attitudes.get(begin), self._turned.get(begin)
        if q is None or turned is None:
            return
        along, across, gnss, imu = _regression(q, impulses, forces)
        self._cross = _MEMORY * self._cross + complex(along, across) * cmath.rect(1.0, turned)
        self._gnss_power = _MEMORY * self._gnss_power + gnss
        self._imu_power = _MEMORY * self._imu_power + imu
        angle = math.remainder(cmath.phase(self._cross) - self._turned[max(self._turned)], 2.0 * math.pi)
        excited = min(self._gnss_power, self._imu_power) > _EXCITED**2
        coherent = abs(self._cross) > _COHERENT * math.sqrt(self._gnss_power * self._imu_power)
        self._wrong = self._wrong + 1 if excited and coherent and abs(angle) > _WRONG else 0
        self.error = angle if self._wrong >= _PROOF else 0.0
        if self.error:
            self.level = self._propagated(begin, np.array(best_rotation(correlation(impulses, forces))[0]))

    def _propagated(self, begin: int, q_nb: np.ndarray) -> np.ndarray | None:
        """``q_nb`` (4,) at second ``begin``, propagated to the last second by the gyroscope; None across a gap."""
        for k in range(begin + 1, max(self._turned) + 1):
            if k not in self._rotations:
                return None
            q_nb = quat_multiply(q_nb, self._rotations[k])
        return q_nb


@kernel
def _turn_beyond(rotation, before, now):
    """Heading [rad] of the attitude ``now`` (4,) relative to that of ``before`` (4,) followed by ``rotation`` (4,)."""
    return yaw_of(now) - yaw_of(quat_multiply(before, rotation))


@kernel
def _regression(q_nb, impulses, forces):
    """Real and imaginary part of the sum of u conj(h), sum of abs(u)^2, sum of abs(h)^2.

    u and h: horizontal components, East + i North, of ``forces`` (S, 3) in n and of ``impulses`` (S, 3) in b rotated by
    ``q_nb`` (4,), with their means removed.
    """
    count = len(forces)
    imu, mean = np.empty((count, 2)), np.zeros(4)
    for k in range(count):
        imu[k, 0], imu[k, 1], _ = q_rotate(q_nb, load3(impulses[k], 0))
        for axis in range(2):
            mean[axis] += forces[k, axis] / count
            mean[2 + axis] += imu[k, axis] / count
    along = across = gnss_power = imu_power = 0.0
    for k in range(count):
        east, north = forces[k, 0] - mean[0], forces[k, 1] - mean[1]
        x, y = imu[k, 0] - mean[2], imu[k, 1] - mean[3]
        along += east * x + north * y
        across += north * x - east * y
        gnss_power += east * east + north * north
        imu_power += x * x + y * y
    return along, across, gnss_power, imu_power
