"""Detection of an implausible speed in an outage, and the uncertainty of attitude and velocity that it implies.

A gyroscope bias that steps or ramps in an outage tilts the attitude; gravity then appears as acceleration, and the
covariance does not show it. The speed does: it grows without limit, while vehicles seldom fly much faster than before.
An excess speed dv at the time t after a step of the bias corresponds to a tilt of about 2 dv / (g t) and to a position
error of dv t / 3.
"""

from __future__ import annotations

import math

from nav_pose_estimator.engine.imu.doubt import Doubt
from nav_pose_estimator.engine.imu.plausibility import G

# A speed is implausible above 1.3 times the largest one with GNSS, above that one plus 3 m/s, and above 8 m/s.
_FACTOR, _MORE, _LEAST = 1.3, 3.0, 8.0
_CREDIBLE = 2.0  # standard deviations of the speed by which an excess is explained
_GROWTH = 1.2  # factor by which an excess has to grow before it is reported again
_SHORTEST = 1.0  # s: floor of the time without GNSS in the formulas


class SpeedDoubt:
    """The test. It receives the navigator's horizontal speed every second."""

    def __init__(self) -> None:
        self._largest = 0.0  # m/s: largest speed while GNSS was good
        self._reported = 0.0  # m/s: largest excess reported in this outage
        self._speed = 0.0  # m/s: speed at that report

    @property
    def reason(self) -> str:
        """Why the solution is less certain, one clause for the user; empty where it is not."""
        if not self._reported:
            return ""
        return (
            f"the estimated speed has reached {self._speed:.0f} m/s, but the vehicle flew at most {self._largest:.0f} "
            "m/s while GNSS was available: the gyroscope's bias may have changed"
        )

    def aided(self, speed: float) -> None:
        """Note the ``speed`` [m/s] while GNSS aids the navigator."""
        self._largest, self._reported = max(self._largest, speed), 0.0

    def unaided(self, speed: float, sd: float, seconds: float) -> Doubt | None:
        """Test a ``speed`` and its deviation [m/s] after ``seconds`` without GNSS; None where it is plausible."""
        excess = speed - max(_FACTOR * self._largest, self._largest + _MORE, _LEAST)
        if excess <= max(_CREDIBLE * sd, _GROWTH * self._reported):
            return None
        added = math.sqrt(excess**2 - self._reported**2)
        self._reported, self._speed = excess, speed
        t = max(seconds, _SHORTEST)
        return Doubt(
            tilt=2.0 * added / (G * t), speed=added, gyro_bias=2.0 * added / (G * t * t), position=added * t / 3.0
        )
