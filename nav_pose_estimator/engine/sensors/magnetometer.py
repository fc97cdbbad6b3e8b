"""Magnetometer: a levelled heading. Its offset is learned while GNSS shows the heading; in an outage it holds it."""

from __future__ import annotations

import math

import numpy as np

from nav_pose_estimator.core.filter import measurements
from nav_pose_estimator.core.filter.layout import PHI
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.number_checks import is_within
from nav_pose_estimator.engine.observation import LEFT_OUT, Decision, FilterView, Kind, Observation, Use
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import MagSample
from nav_pose_estimator.engine.sensors.aiding import Aiding
from nav_pose_estimator.engine.sensors.sensor import Aid, Linearised, Pacer, shared_error

_LARGEST_FIELD = 1e6  # in any unit
_KNOWN_HEADING = 0.2  # rad: a heading that GNSS motion shows no better cannot teach the offset
_OFFSET_MEMORY = 100.0  # s


class Magnetometer(Aid):
    """The direction of the horizontal field, against declination and the offset that was learned."""

    kind = Kind("magnetic_heading", quiet=True)
    sample, family = MagSample, "mag"

    def __init__(self, parameters: Parameters, aiding: Aiding, journal: Journal) -> None:
        super().__init__(parameters, aiding, journal)
        self._pacer = Pacer()
        self._offset = math.nan  # rad: magnetic minus filter heading
        self._since = 0.0

    def set_parameters(self, parameters: Parameters) -> None:
        """New noise, period and declination."""
        aids = parameters.aids
        self._enabled, self._period, self._declination = aids.magnetometer, aids.magnetometer_period, aids.declination
        self._variance = aids.magnetometer_sd**2 * shared_error(aids.magnetometer_period)

    def observe(self, sample: MagSample, t: float) -> Observation | None:
        """A field in b, in any unit, at most every ``aids.magnetometer_period``."""
        if not self._enabled or not self._pacer.passes(t, self._period):
            return None
        if not is_within(sample.field, _LARGEST_FIELD) or not any(sample.field):
            return self._refuse()
        return Observation(t, sample.stamp_ns, self.kind, tuple(sample.field))

    def decide(self, o: Observation, f: FilterView) -> Decision:
        """While GNSS shows the heading learn the offset; otherwise let the field hold the heading."""
        if self._aiding.gnss_is_good(o.t) and math.sqrt(f.P[PHI + 2, PHI + 2]) < _KNOWN_HEADING:
            self._learn(o, f)
            return LEFT_OUT
        return LEFT_OUT if math.isnan(self._offset) else Decision(Use.GATED, self._offset)

    def _learn(self, o: Observation, f: FilterView) -> None:
        z, _ = measurements.magnetic_heading(f.nav, len(f.P), *o.measured, self._declination)
        if math.isnan(self._offset):
            self._offset, self._since = float(z[0]), o.t
        share = self._period / min(max(o.t - self._since, 1.0), _OFFSET_MEMORY)
        self._offset += min(share, 1.0) * math.remainder(float(z[0]) - self._offset, 2.0 * math.pi)

    def linearise(self, o: Observation, f: FilterView) -> Linearised:
        """One row, phi_z. A tilt that is wrong lets the vertical field pass for a horizontal one."""
        assert o.decision is not None
        tilt_variance = f.P[PHI, PHI] + f.P[PHI + 1, PHI + 1]
        z, H = measurements.magnetic_heading(f.nav, len(f.P), *o.measured, self._declination + o.decision.reference)
        return z, H, np.array([[self._variance + 4.0 * tilt_variance]])
