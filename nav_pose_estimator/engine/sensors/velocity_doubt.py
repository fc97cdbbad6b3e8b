"""Doubt about a body velocity without GNSS: the position error that it may have caused.

Once the filter has followed a velocity with a wrong size or an offset, the innovations are zero again. What remains as
evidence is the change itself: the updates have added a velocity without a force on the IMU. From then on either of the
two may be right, and the position error grows with the difference. A sensor that no motion has confirmed yet, or whose
scale is not known, causes an error that grows with the displacement.
"""

from __future__ import annotations

import math

import numpy as np

from nav_pose_estimator.engine.imu.doubt import Doubt
from nav_pose_estimator.engine.imu.plausibility import G

_MEMORY = 3.0  # s over which the changes by updates are summed
_LEAST = 0.25  # m/s: smallest sum that contradicts the IMU; sound sensors reach 0.1
_NOISES = 1.2  # the same in RMS innovations; sensors three times as noisy as stated reach 1.0
_SLOW = 200.0  # innovations over which the RMS is averaged
_EXPECTED = 3.0  # the same in standard deviations of what the filter expected, as after a pause of the sensor
_FEW = 10  # innovations before the RMS is meaningful
_OUTLIER = 3.0  # RMS: larger innovations count as this
_REFUSED = 1.0  # s of refusals in a row that show a contradiction as well


class VelocityDoubt:
    """Sum of the changes since GNSS was lost, and the possible position error; all horizontal, ENU."""

    def __init__(self) -> None:
        self._t, self._recent, self._jump = -math.inf, np.zeros(2), np.zeros(2)  # s, m/s, m/s
        self._square, self._count = 0.0, 0.0  # mean square of the innovations [(m/s)^2], and their number
        self._displacement, self._error_by_jumps, self._error = 0j, 0.0, 0.0  # m; the last: by all causes
        self._reported = 0.0  # m/s: the jump for which velocity and tilt have become less certain
        self._expected = 0.0  # (m/s)^2: variance that the recent updates have removed
        self._refused_since = math.inf  # s: first of the refusals in a row

    @property
    def jump(self) -> float:
        """Velocity [m/s] that the updates have added and the IMU did not measure; 0 while there is no doubt."""
        return math.hypot(*self._jump.tolist())

    def end(self) -> None:
        """GNSS is good: nothing is in doubt."""
        if self._displacement or self._error or self._jump.any() or self._recent.any():
            self._recent, self._jump, self._reported = np.zeros(2), np.zeros(2), 0.0
            self._displacement, self._error_by_jumps, self._error = 0j, 0.0, 0.0
            self._expected, self._refused_since = 0.0, math.inf

    def update(self, t: float, change: np.ndarray, removed: float, innovation: float, is_refused: bool) -> bool:
        """Process an update without GNSS at ``t`` [s] that has changed the velocity by ``change`` (2,) [m/s].

        ``removed`` [(m/s)^2]: by how much it has reduced the variance of the velocity, which is that of the change.
        Both are zero where the update is refused. ``innovation``: its norm [m/s]. Returns True for the first such
        change of an outage that contradicts the IMU.
        """
        usual = self.learn(innovation)
        self._refused_since = min(self._refused_since, t) if is_refused else math.inf
        decay, self._t = math.exp(-max(t - self._t, 0.0) / _MEMORY), t
        self._recent, self._expected = decay * self._recent + change, decay * self._expected + max(removed, 0.0)
        size = math.hypot(*self._recent.tolist())
        least = max(_LEAST, _NOISES * usual, _EXPECTED * math.sqrt(self._expected))
        if t - self._refused_since > _REFUSED and not self._jump.any():
            # it has pulled the velocity up to the first refusal
            self._jump = self._recent * max(least / size, 1.0) if size else np.array([least, 0.0])
            return True
        if size <= least:
            return False
        is_first = not self._jump.any()
        self._jump, self._recent = self._jump + self._recent, np.zeros(2)
        return is_first

    def learn(self, innovation: float) -> float:
        """Learn the usual size of an ``innovation`` [m/s], in RMS; returns that before it."""
        usual = math.sqrt(self._square)
        bounded = min(innovation, _OUTLIER * usual) if self._count > _FEW else innovation
        self._count = min(self._count + 1.0, _SLOW)
        self._square += (bounded**2 - self._square) / self._count
        return usual

    def second(self, velocity: complex, possible: float) -> Doubt | None:
        """Possible error by another second, None without any.

        ``velocity`` [m/s]: by the sensor, East + i North; ``possible``: its error by axes and scale, relative to it.
        Such an error is in proportion to the displacement, not to the length of the path.
        The updates have turned such a change into velocity and into tilt.
        """
        self._displacement, self._error_by_jumps = self._displacement + velocity, self._error_by_jumps + self.jump
        before, self._error = self._error, max(self._error, self._error_by_jumps + possible * abs(self._displacement))
        fresh, self._reported = max(self.jump - self._reported, 0.0), max(self.jump, self._reported)
        if self._error <= before:
            return None
        return Doubt(tilt=fresh / (G * _MEMORY), speed=fresh, position=math.sqrt(self._error**2 - before**2))
