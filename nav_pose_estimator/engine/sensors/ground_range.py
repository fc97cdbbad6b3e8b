"""Downward rangefinder: height above flat ground, which is never used as an altitude by itself.

While GNSS is good, the height of the ground and its roughness per metre travelled are learned. Without GNSS the height
is measured relative to that ground. A step (a roof, a wall) fails the gate; a new level that lasts becomes the ground.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from nav_pose_estimator.core.filter import measurements
from nav_pose_estimator.core.filter.layout import ALT, DPOS, QUAT, VEL
from nav_pose_estimator.core.numerics.rotation import quat_to_matrix
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.number_checks import is_within
from nav_pose_estimator.engine.observation import LEFT_OUT, Decision, FilterView, Kind, Observation, Use
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import RangeToGround
from nav_pose_estimator.engine.sensors.aiding import Aiding
from nav_pose_estimator.engine.sensors.sensor import Aid, Linearised, Pacer, shared_error

_PERIOD = 0.2  # s: shortest time between two observations
_FARTHEST = 1e4  # m: a larger distance is rejected
_STEEPEST = 0.5  # rad: with a larger tilt the beam meets the ground too far from the nadir
_GROUND_MEMORY = 5.0  # s: averaging time of the ground's height while GNSS is good
_RELIEF_MEMORY = 60.0  # s: averaging time of the roughness
# m^2 per m travelled: variance of the ground's height, initial and smallest, 1 m and 0.5 m (1 sigma) over 100 m.
_FIRST_RELIEF, _LEAST_RELIEF = 0.01, 0.0025
_NEW_LEVEL = 2.0  # s that a step has to last before it becomes the ground


@dataclass
class _Ground:
    """Estimate of the ground."""

    height: float = math.nan  # m above the ellipsoid
    relief: float = _FIRST_RELIEF  # m^2 per m travelled
    travelled: float = 0.0  # m since the height was last known
    t: float = -math.inf  # s: time of the last observation
    refused_since: float = math.inf  # s: time since which all observations have been rejected
    above: float = math.nan  # m: height above ground, for the status


class GroundRange(Aid):
    """One row: height as the ground's height plus the vertical part of the beam."""

    kind = Kind("range", quiet=True)
    sample, family = RangeToGround, "range"
    vertical_only = True

    def __init__(self, parameters: Parameters, aiding: Aiding, journal: Journal) -> None:
        super().__init__(parameters, aiding, journal)
        self._pacer = Pacer()
        self._ground = _Ground()

    def set_parameters(self, parameters: Parameters) -> None:
        """New noise."""
        self._enabled, self._sd = parameters.aids.range, parameters.aids.range_sd

    def observe(self, sample: RangeToGround, t: float) -> Observation | None:
        """A distance [m], at most five times a second."""
        if not self._enabled or not self._pacer.passes(t, _PERIOD):
            return None
        if not (is_within((sample.distance, sample.field_of_view), _FARTHEST) and sample.distance > 0.0):
            return self._refuse()
        sd = max(self._sd, sample.sd) if math.isfinite(sample.sd) else self._sd
        R = np.array([[sd**2 * shared_error(_PERIOD)]])
        return Observation(t, sample.stamp_ns, self.kind, (sample.distance, sample.field_of_view), R)

    def decide(self, o: Observation, f: FilterView) -> Decision:
        """While GNSS is good learn the ground; without GNSS use the height above it."""
        ground = self._ground
        drop = _vertical_part(o.measured, f.nav)
        self._travel(o.t, math.hypot(f.nav[VEL], f.nav[VEL + 1]))
        if math.isnan(drop):
            return LEFT_OUT
        below = float(f.nav[ALT]) - drop
        ground.above = drop
        if self._aiding.gnss_is_good(o.t):
            self._learn(below)
            return LEFT_OUT
        if o.t - ground.refused_since > _NEW_LEVEL:
            self._journal.count("range.new_ground")
            ground.height, ground.refused_since = below, math.inf
            ground.travelled = float(f.P[DPOS + 2, DPOS + 2]) / ground.relief  # variance of the ground as of the height
        return LEFT_OUT if math.isnan(ground.height) else Decision(Use.GATED, ground.height)

    def _travel(self, t: float, speed: float) -> None:
        self._ground.travelled += speed * min(max(t - self._ground.t, 0.0), 1.0)
        self._ground.t = t

    def _learn(self, below: float) -> None:
        ground = self._ground
        if math.isnan(ground.height):
            ground.height = below
        change = below - ground.height
        if ground.travelled > 1.0:
            seen = max(change**2 / ground.travelled, _LEAST_RELIEF)
            ground.relief += min(_PERIOD / _RELIEF_MEMORY, 1.0) * (min(seen, 1.0) - ground.relief)
        ground.height += _PERIOD / _GROUND_MEMORY * change
        ground.travelled *= 1.0 - _PERIOD / _GROUND_MEMORY

    def linearise(self, o: Observation, f: FilterView) -> Linearised:
        """One row, the height."""
        assert o.stated_R is not None
        assert o.decision is not None
        height = o.decision.reference + _vertical_part(o.measured, f.nav)
        R = o.stated_R + self._ground.relief * self._ground.travelled
        return *measurements.height(f.nav, len(f.P), height), R

    def note(self, o: Observation, f: FilterView, z: np.ndarray, status: int, nis: float) -> None:
        """Count the outcome, and note the time since which observations have been rejected."""
        super().note(o, f, z, status, nis)
        self._ground.refused_since = math.inf if status else min(self._ground.refused_since, o.t)

    def figures(self) -> dict[str, float]:
        """Height above ground [m] as last measured."""
        return {} if math.isnan(self._ground.above) else {"rangefinder.above_ground_m": self._ground.above}


def _vertical_part(measured: tuple[float, float], nav: np.ndarray) -> float:
    """Height [m] above flat ground from a beam along the body's z axis; NaN where the tilt is too large.

    The sensor measures the nearest point within its cone, so a tilt up to half its width has no effect.
    """
    distance, field_of_view = measured
    tilt = math.acos(min(max(float(quat_to_matrix(nav[QUAT : QUAT + 4])[2, 2]), -1.0), 1.0))
    aside = max(tilt - 0.5 * field_of_view, 0.0)
    return distance * math.cos(aside) if tilt < _STEEPEST else math.nan
