"""Rest: an IMU that is still means that the velocity is zero, unless the navigator contradicts it."""

from __future__ import annotations

import math

import numpy as np

from nav_pose_estimator.core.filter import measurements
from nav_pose_estimator.core.filter.layout import DVEL, GYRO_BIAS, TIME, VEL
from nav_pose_estimator.engine.observation import FilterView, Kind, Observation
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.sensors.sensor import Linearised, Sensor

_RATE = 0.01  # rad/s: at rest nothing but bias and the Earth is left of the mean angular rate
_SPEED = 0.7  # m/s: the navigator must be sure, by two deviations, to be slower than that


class Rest(Sensor):
    """Zero velocity (Groves, second edition, section 15.3)."""

    kind = Kind("zero_velocity")
    all_or_nothing = True  # an unlikely rest is not a rest
    bounds_drift = True

    def set_parameters(self, parameters: Parameters) -> None:
        """New noise."""
        self._R = np.eye(3) * parameters.aids.zero_velocity_sd**2

    def observe(self, mean_rate: np.ndarray, f: FilterView, stamp_ns: int) -> Observation | None:
        """The observation where the IMU is still with ``mean_rate`` (3,) [rad/s]; None where something speaks against.

        An IMU feels neither a steady turn nor a steady cruise: the bias has to explain the rate, and the navigator has
        to know that it is slow. One that has lost its velocity learns nothing here, safe rather than helpful.
        """
        if math.dist(mean_rate, f.nav[GYRO_BIAS : GYRO_BIAS + 3]) > _RATE:
            return self._withhold("rate")
        speed_sd = math.sqrt(f.P[DVEL : DVEL + 3, DVEL : DVEL + 3].trace())
        if math.hypot(*f.nav[VEL : VEL + 3]) + 2.0 * speed_sd > _SPEED:
            return self._withhold("speed")
        return Observation(float(f.nav[TIME]), stamp_ns, self.kind, None)

    def _withhold(self, why: str) -> None:
        self._journal.count(f"zero_velocity.withheld.{why}")

    def linearise(self, o: Observation, f: FilterView) -> Linearised:
        """Three rows, the velocity."""
        return *measurements.zero_velocity(f.nav, len(f.P)), self._R
