"""A navigator that is on its own and faster than the vehicle has ever been: what that says of its attitude.

A gyroscope whose bias steps or ramps in an outage turns gravity into acceleration, and no covariance knows of it. What
shows is the speed: it grows without end, while vehicles seldom go much faster than before. An excess of speed dv after
the time t comes from a tilt of about 2 dv / (g t) if the bias has stepped, and from a way of dv t / 3.
"""

from __future__ import annotations

import math

from nav_pose_estimator.engine.imu.doubt import Doubt
from nav_pose_estimator.engine.imu.plausibility import G

_FACTOR, _MORE, _LEAST = 1.3, 3.0, 8.0  # m/s, a speed beyond the largest so far is unusual
_CREDIBLE = 2.0  # deviations of the speed that explain one
_AGAIN = 1.2  # ... by which it has to grow to count again
_SHORTEST = 1.0  # s


class SpeedDoubt:
    """Tell it the horizontal speed of the navigator every second."""

    def __init__(self) -> None:
        self._largest = 0.0  # m/s, while GNSS was good
        self._told = 0.0  # m/s, of this outage
        self._speed = 0.0

    @property
    def reason(self) -> str:
        """Why the solution is less certain, a clause; empty where it is not."""
        if not self._told:
            return ""
        return (
            f"the navigator's own speed has reached {self._speed:.0f} m/s, and the vehicle {self._largest:.0f} m/s at "
            "most while GNSS was there: the gyroscope's bias may have changed"
        )

    def aided(self, speed: float) -> None:
        """With GNSS [m/s]."""
        self._largest, self._told = max(self._largest, speed), 0.0

    def unaided(self, speed: float, sd: float, seconds: float) -> Doubt | None:
        """Without GNSS for ``seconds``: a ``speed`` and its deviation [m/s]; None where it is nothing unusual."""
        excess = speed - max(_FACTOR * self._largest, self._largest + _MORE, _LEAST)
        if excess <= max(_CREDIBLE * sd, _AGAIN * self._told):
            return None
        added = math.sqrt(excess**2 - self._told**2)
        self._told, self._speed = excess, speed
        t = max(seconds, _SHORTEST)
        return Doubt(tilt=2.0 * added / (G * t), speed=added, gyro_bias=2.0 * added / (G * t * t), way=added * t / 3.0)
