"""Pseudo-GNSS: a position composed of the motion predicted since GNSS was lost, used like a fix."""

from __future__ import annotations

import numpy as np

from nav_pose_estimator.core.filter import measurements
from nav_pose_estimator.engine.number_checks import is_covariance, is_within
from nav_pose_estimator.engine.observation import FilterView, Kind, Observation
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import ComposedPosition
from nav_pose_estimator.engine.sensors.sensor import Aid, Linearised

_HIGHEST = 1e5  # m: a larger height is rejected
_NO_LEVER = np.zeros(3)


class ComposedPositionSensor(Aid):
    """Three rows: position of the IMU itself, behind the filter's gate."""

    kind = Kind("composed")
    sample, family = ComposedPosition, "composed"

    def set_parameters(self, parameters: Parameters) -> None:
        """It has no parameters."""

    def observe(self, sample: ComposedPosition, t: float) -> Observation | None:
        """The observation of a finite position with a valid covariance."""
        is_sound = is_within(sample.position[:2], 2.0 * np.pi) and is_within(sample.position[2:], _HIGHEST)
        if not (is_sound and is_covariance(sample.cov, 3)):
            return self._refuse()
        return Observation(t, sample.stamp_ns, self.kind, sample.position, np.array(sample.cov, float))

    def linearise(self, o: Observation, f: FilterView) -> Linearised:
        """Three rows, as of a fix with zero lever arm."""
        assert o.stated_R is not None
        return *measurements.gnss_position(f.nav, len(f.P), *o.measured, _NO_LEVER), o.stated_R
