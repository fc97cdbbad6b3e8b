"""Doubt about the IMU as an observation: additional variance after samples that cannot be trusted."""

from __future__ import annotations

import numpy as np

from nav_pose_estimator.core.filter.layout import D_ACCEL_BIAS, D_GYRO_BIAS, DPOS, DVEL, PHI
from nav_pose_estimator.engine.imu.doubt import Doubt
from nav_pose_estimator.engine.observation import Decision, FilterView, Kind, Observation, Use
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.sensors.sensor import Sensor

_STATES = np.concatenate([np.arange(first, first + 3) for first in (PHI, DVEL, D_GYRO_BIAS, D_ACCEL_BIAS, DPOS)])


class ImuDoubt(Sensor):
    """Adds independent variances to the covariance; it corrects no state."""

    kind = Kind("imu_doubt", precedence=0)

    def set_parameters(self, parameters: Parameters) -> None:
        """It has no parameters."""

    def observe(self, doubt: Doubt, t: float, stamp_ns: int) -> Observation:
        """The ``doubt`` about the second up to ``t`` [s]."""
        self._journal.count("imu_doubt.used")
        return Observation(t, stamp_ns, self.kind, doubt)

    def decide(self, o: Observation, f: FilterView) -> Decision:
        """It always takes effect."""
        return Decision(Use.DOUBTED)

    def settle(self, o: Observation, f: FilterView) -> None:
        """Add the variances."""
        variances = np.repeat(np.square(o.measured[:5]), 3)
        variances[-1] = 0.0  # Up: the position error is horizontal
        f.P[_STATES, _STATES] += variances
