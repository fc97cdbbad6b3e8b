"""A stand-in for a fix: a position that was composed of predicted motion since GNSS was lost."""

from __future__ import annotations

import numpy as np

from nav_pose_estimator.core.filter import measurements
from nav_pose_estimator.engine.number_checks import is_covariance, is_within
from nav_pose_estimator.engine.observation import FilterView, Kind, Observation
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import ComposedPosition
from nav_pose_estimator.engine.sensors.sensor import Aid, Linearised

_HIGHEST = 1e5  # m
_NO_LEVER = np.zeros(3)


class ComposedPositionSensor(Aid):
    """Three rows of position, of the IMU itself. The gate of the filter selects them by the nominal state."""

    kind = Kind("composed")
    sample, family = ComposedPosition, "composed"

    def set_parameters(self, parameters: Parameters) -> None:
        """It has none."""

    def observe(self, sample: ComposedPosition, t: float) -> Observation | None:
        """A position that is finite and has a covariance."""
        is_sound = is_within(sample.position[:2], 2.0 * np.pi) and is_within(sample.position[2:], _HIGHEST)
        if not (is_sound and is_covariance(sample.cov, 3)):
            return self._refuse()
        return Observation(t, sample.stamp_ns, self.kind, sample.position, np.array(sample.cov, float))

    def linearise(self, o: Observation, f: FilterView) -> Linearised:
        """As a fix at the IMU."""
        assert o.stated_R is not None
        return *measurements.gnss_position(f.nav, len(f.P), *o.measured, _NO_LEVER), o.stated_R
