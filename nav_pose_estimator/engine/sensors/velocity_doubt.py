"""Doubt about a body velocity without GNSS: the position error that it may have caused.

Once the filter has followed a velocity with a wrong size or an offset, the innovations are zero again. What remains as
evidence is the change itself: the updates have added a velocity that the IMU did not feel. From then on either of the
two may be right, and the position error grows with the difference. A sensor that no motion has confirmed yet, or whose
scale is not known, causes an error that grows with the speed.
"""

from __future__ import annotations

import math

import numpy as np

from nav_pose_estimator.engine.imu.doubt import Doubt
from nav_pose_estimator.engine.imu.plausibility import G

_MEMORY = 3.0  # s over which the changes by updates are summed
_LEAST = 0.25  # m/s: smallest sum that counts as unfelt; sound sensors reach 0.1
_NOISES = 1.2  # the same in RMS innovations; sensors three times as noisy as stated reach 1.0
_SLOW = 200.0  # innovations over which the RMS is averaged
_FEW = 10  # innovations before the RMS is meaningful
_OUTLIER = 3.0  # RMS: larger innovations count as this
_REFUSED = 1.0  # s of refusals in a row that show a contradiction as well


class VelocityDoubt:
    """Sum of the unfelt changes since GNSS was lost, and the possible position error; all horizontal, ENU."""

    def __init__(self) -> None:
        self._t, self._recent, self._jump = -math.inf, np.zeros(2), np.zeros(2)  # s, m/s, m/s
        self._square, self._count = 0.0, 0.0  # mean square of the innovations [(m/s)^2], and their number
        self._way = 0.0  # m
        self._told = 0.0  # m/s: the jump for which velocity and tilt have become less certain
        self._used = -math.inf  # s: last update that was not refused

    @property
    def jump(self) -> float:
        """Velocity [m/s] that the updates have added and the IMU did not feel; 0 while there is no doubt."""
        return math.hypot(*self._jump.tolist())

    def end(self) -> None:
        """GNSS is good: nothing is in doubt."""
        if self._way or self._jump.any() or self._recent.any():
            self._recent, self._jump, self._way, self._told = np.zeros(2), np.zeros(2), 0.0, 0.0

    def update(self, t: float, change: np.ndarray, innovation: float, is_aided: bool, is_refused: bool) -> bool:
        """Process an update at ``t`` [s] that has changed the velocity by ``change`` (2,) [m/s], 0 where refused.

        ``innovation``: its norm [m/s]. Returns True for the first unfelt change of an outage.
        """
        usual = math.sqrt(self._square)
        bounded = min(innovation, _OUTLIER * usual) if self._count > _FEW else innovation
        self._count = min(self._count + 1.0, _SLOW)
        self._square += (bounded**2 - self._square) / self._count
        if not is_refused:
            self._used = t
        if is_aided:
            return False
        self._recent = self._recent * math.exp(-max(t - self._t, 0.0) / _MEMORY) + change
        self._t = t
        size, least = math.hypot(*self._recent.tolist()), max(_LEAST, _NOISES * usual)
        if t - self._used > _REFUSED and not self._jump.any():  # it has pulled the velocity up to the first refusal
            self._jump = self._recent * max(least / size, 1.0) if size else np.array([least, 0.0])
            return True
        if size <= least:
            return False
        is_first = not self._jump.any()
        self._jump, self._recent = self._jump + self._recent, np.zeros(2)
        return is_first

    def second(self, unknown: float) -> Doubt | None:
        """Possible error by another second, None without any; ``unknown`` [m/s]: by axes and scale of the sensor.

        The updates have turned an unfelt change into velocity and into tilt.
        """
        before, self._way = self._way, self._way + self.jump + unknown
        fresh, self._told = max(self.jump - self._told, 0.0), max(self.jump, self._told)
        if self._way <= before:
            return None
        return Doubt(tilt=fresh / (G * _MEMORY), speed=fresh, way=math.sqrt(self._way**2 - before**2))
