"""Barometer: a height against a reference that is learned while GNSS is good."""

from __future__ import annotations

import math

import numpy as np

from nav_pose_estimator.core.earth.atmosphere import pressure_height
from nav_pose_estimator.core.filter import measurements
from nav_pose_estimator.core.filter.layout import ALT
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.observation import LEFT_OUT, Decision, FilterView, Kind, Observation, Use
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import PressureSample
from nav_pose_estimator.engine.sensors.aiding import Aiding
from nav_pose_estimator.engine.sensors.sensor import Aid, Linearised, Pacer, shared_error

_LOWEST, _HIGHEST = 1_000.0, 120_000.0  # Pa: 31 km up, and below any place on Earth


class Barometer(Aid):
    """Pressure altitude, less how much it differed from the height of GNSS."""

    kind = Kind("height", quiet=True)
    sample, family = PressureSample, "baro"
    vertical_only = True

    def __init__(self, parameters: Parameters, aiding: Aiding, journal: Journal) -> None:
        super().__init__(parameters, aiding, journal)
        self._pacer = Pacer()
        self._offset = math.nan  # m: barometric minus filter height
        self._since = 0.0

    def set_parameters(self, parameters: Parameters) -> None:
        """New noise, period and time constant."""
        aids = parameters.aids
        self._enabled, self._period, self._tau = aids.barometer, aids.barometer_period, aids.barometer_tau
        self._R = np.array([[aids.barometer_sd**2 * shared_error(aids.barometer_period)]])

    def observe(self, sample: PressureSample, t: float) -> Observation | None:
        """A pressure [Pa], at most every ``aids.barometer_period``."""
        if not self._enabled or not self._pacer.passes(t, self._period):
            return None
        if not _LOWEST < sample.pressure < _HIGHEST:
            return self._refuse()
        return Observation(t, sample.stamp_ns, self.kind, pressure_height(sample.pressure))

    def decide(self, o: Observation, f: FilterView) -> Decision:
        """Learn the reference while GNSS is good; without GNSS use it."""
        if self._aiding.gnss_is_good(o.t):
            self._learn(o, float(f.nav[ALT]))
            return LEFT_OUT
        return LEFT_OUT if math.isnan(self._offset) else Decision(Use.GATED, self._offset)

    def _learn(self, o: Observation, height: float) -> None:
        difference = o.measured - height
        if math.isnan(self._offset):
            self._offset, self._since = difference, o.t
        share = self._period / min(max(o.t - self._since, self._period), self._tau)
        self._offset += min(share, 1.0) * (difference - self._offset)

    def linearise(self, o: Observation, f: FilterView) -> Linearised:
        """One row, the height."""
        assert o.decision is not None
        return *measurements.height(f.nav, len(f.P), o.measured - o.decision.reference), self._R
