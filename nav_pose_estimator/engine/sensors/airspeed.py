"""Airspeed of a pitot tube on a fixed-wing vehicle: a velocity observation with wind and scale as states.

While GNSS is good the filter estimates wind and scale of the sensor; without GNSS the remaining drift is the change of
the wind. The states are added with the first usable airspeed, so that the filter of a vehicle without the sensor is
unchanged.

Source: A. Cho, J. Kim, S. Lee, C. Kee, "Wind estimation and airspeed calibration using a UAV with a single-antenna GPS
receiver and pitot tube", IEEE Transactions on Aerospace and Electronic Systems 47(1), 2011 (wind and scale as states;
here in the navigator's own filter, and with the condition of no sideslip).
"""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from nav_pose_estimator.core.filter import measurements
from nav_pose_estimator.core.filter.blocks import AIRSPEED, WIND, Block, GaussMarkov
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.observation import FilterView, Kind, Observation
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import Airspeed
from nav_pose_estimator.engine.sensors.aiding import Aiding
from nav_pose_estimator.engine.sensors.sensor import Aid, Linearised, Pacer, shared_error

_PERIOD = 0.2  # s: shortest time between two observations
_HOLDS = 3.0  # s after its last use for which an airspeed bounds the drift
_FASTEST = 400.0  # m/s: a larger airspeed is rejected
_SCALE_SD = 0.1  # initial standard deviation of the scale error
_SIDESLIP = 0.06  # rad: standard deviation of the sideslip angle in coordinated flight with gusts
_SIDESLIP_FLOOR = 0.7  # m/s: floor of the sideslip velocity's standard deviation


class AirspeedSensor(Aid):
    """Two rows: the airspeed, and zero sideslip."""

    kind = Kind("airspeed")
    sample, family = Airspeed, "airspeed"
    bounds_drift = True
    blocks: ClassVar[dict[Block, GaussMarkov]] = {WIND: GaussMarkov(walk=0.02), AIRSPEED: GaussMarkov(walk=1e-4)}

    def __init__(self, parameters: Parameters, aiding: Aiding, journal: Journal) -> None:
        super().__init__(parameters, aiding, journal)
        self._pacer = Pacer()
        self._last_used = -math.inf  # s

    def set_parameters(self, parameters: Parameters) -> None:
        """New noise and limits."""
        aids = parameters.aids
        self._enabled, self._sd, self._slowest = aids.airspeed, aids.airspeed_sd, aids.airspeed_min
        self.first_sd = {WIND: aids.wind_sd, AIRSPEED: _SCALE_SD}

    def observe(self, sample: Airspeed, t: float) -> Observation | None:
        """The observation of a true airspeed [m/s]; below ``aids.airspeed_min`` a pitot tube is useless."""
        if not self._enabled:
            return None
        if not -_FASTEST < sample.speed < _FASTEST:
            return self._refuse()
        if sample.speed < self._slowest:
            return self._refuse("slow")
        if not self._pacer.passes(t, _PERIOD):
            return None
        sd = max(self._sd, sample.sd) if math.isfinite(sample.sd) else self._sd
        sideslip = max(_SIDESLIP * sample.speed, _SIDESLIP_FLOOR)
        R = np.diag([sd**2, sideslip**2]) * shared_error(_PERIOD)
        return Observation(t, sample.stamp_ns or 0, self.kind, sample.speed, R)

    def note(self, o: Observation, f: FilterView, z: np.ndarray, status: int, nis: float) -> None:
        """Count the outcome, and note the time of the last use."""
        super().note(o, f, z, status, nis)
        if status:
            self._last_used = o.t

    def bounds_at(self, t: float) -> bool:
        """Whether the drift at ``t`` [s] is bounded by airspeeds."""
        return t - self._last_used < _HOLDS

    def linearise(self, o: Observation, f: FilterView) -> Linearised:
        """Two rows: airspeed and sideslip."""
        assert o.stated_R is not None
        wind, scale = WIND.states(f.constants).start, AIRSPEED.states(f.constants).start
        return *measurements.airspeed(f.nav, len(f.P), wind, scale, o.measured), o.stated_R
