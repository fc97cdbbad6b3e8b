"""Zero-velocity updates: while the IMU is still, unless the navigator contradicts rest."""

from __future__ import annotations

import math

import numpy as np

from nav_pose_estimator.core.filter import measurements
from nav_pose_estimator.core.filter.layout import DVEL, GYRO_BIAS, TIME, VEL
from nav_pose_estimator.engine.observation import FilterView, Kind, Observation
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.sensors.sensor import Linearised, Sensor

_RATE = 0.01  # rad/s: largest mean angular rate at rest beside the estimated bias (the Earth's included)
_SPEED = 0.7  # m/s: the estimated speed plus two standard deviations must be smaller


class Rest(Sensor):
    """Three rows: zero velocity (Groves, second edition, section 15.3)."""

    kind = Kind("zero_velocity")
    all_or_nothing = True  # an unlikely zero velocity is rejected, not inflated
    bounds_drift = True

    def set_parameters(self, parameters: Parameters) -> None:
        """New noise."""
        self._R = np.eye(3) * parameters.aids.zero_velocity_sd**2

    def observe(self, mean_rate: np.ndarray, f: FilterView, stamp_ns: int) -> Observation | None:
        """The observation for an IMU that is still with ``mean_rate`` (3,) [rad/s]; None where rest is not certain.

        A still IMU does not exclude a steady turn or a steady cruise. So the bias has to explain the rate, and the
        navigator's velocity has to be small with certainty. With an uncertain velocity there is no update: that is
        safe, although an update would help most then.
        """
        if math.dist(mean_rate.tolist(), f.nav[GYRO_BIAS : GYRO_BIAS + 3].tolist()) > _RATE:
            return self._withhold("rate")
        speed_sd = math.sqrt(f.P[DVEL : DVEL + 3, DVEL : DVEL + 3].trace())
        if math.hypot(*f.nav[VEL : VEL + 3].tolist()) + 2.0 * speed_sd > _SPEED:
            return self._withhold("speed")
        return Observation(float(f.nav[TIME]), stamp_ns, self.kind, None)

    def _withhold(self, why: str) -> None:
        self._journal.count(f"zero_velocity.withheld.{why}")

    def linearise(self, o: Observation, f: FilterView) -> Linearised:
        """Three rows, the velocity."""
        return *measurements.zero_velocity(f.nav, len(f.P)), self._R
