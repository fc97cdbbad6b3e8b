"""GNSS of the navigator: reception, position and velocity sensors, and the correction of the filter at a loss."""

from __future__ import annotations

from typing import Any

import numpy as np

from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.observation import Decision, FilterView, Kind, Observation, Use
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.sensors.aiding import Aiding
from nav_pose_estimator.engine.sensors.gnss import lasting_error
from nav_pose_estimator.engine.sensors.gnss.position import GnssPositionSensor
from nav_pose_estimator.engine.sensors.gnss.reception import GnssReception
from nav_pose_estimator.engine.sensors.gnss.velocity import GnssVelocitySensor
from nav_pose_estimator.engine.sensors.sensor import Sensor

_LARGEST_FACTOR = 9.0  # of the covariance: three times the deviation


class GnssLoss(Sensor):
    """No measurement: from its time on the covariance is scaled by what the last innovations have shown, and the
    position lies where the last fixes were on average."""

    kind = Kind("gnss_loss", precedence=2, whole=True)

    def set_parameters(self, parameters: Parameters) -> None:
        """It has no parameters."""

    def decide(self, o: Observation, f: FilterView) -> Decision:
        """By the factor and the shift that were known when the loss was declared."""
        factor, east, north = o.measured
        return Decision(Use.WIDENING, factor, shift=(east, north))


class Gnss:
    """The parts of GNSS, and their common functions."""

    def __init__(self, parameters: Parameters, aiding: Aiding, journal: Journal) -> None:
        self.reception = GnssReception(parameters.gnss, aiding, journal)
        self.velocity = GnssVelocitySensor(parameters, aiding, journal, self.reception)
        self.position = GnssPositionSensor(parameters, aiding, journal, self.reception, self.velocity)
        self.loss = GnssLoss(parameters, aiding, journal)
        self._aiding, self._parameters = aiding, parameters.gnss

    @property
    def sensors(self) -> list[Sensor]:
        """The sensors of GNSS."""
        return [self.velocity, self.position, self.loss]

    def set_parameters(self, parameters: Parameters) -> None:
        """Take new thresholds and noises; the states of gate and guard are kept."""
        self._parameters = parameters.gnss
        self.reception.set_parameters(parameters.gnss)
        for sensor in self.sensors:
            sensor.set_parameters(parameters)

    def begin(self, t: float, origin: tuple[float, float, float]) -> None:
        """The filter starts at ``t`` [s] with a position from GNSS."""
        self.position.origin = origin
        self._aiding.use_fix(t)
        self.reception.refusal = ""

    def go_on(self, last_fix: float, origin: tuple[float, float, float]) -> None:
        """The filter starts without GNSS, whose last position update was at ``last_fix`` [s], before a restart."""
        self.position.origin = origin
        self._aiding.use_fix(last_fix)

    def loss_at(self, t: float, stamp_ns: int) -> Observation:
        """At ``t`` GNSS counts as lost: what the last innovations have shown acts on covariance and position."""
        east, north = (-self.offset).tolist()
        return Observation(t, stamp_ns, self.loss.kind, (self.variance_factor, east, north))

    @property
    def offset(self) -> np.ndarray:
        """Recent mean difference of the filter from the fixes, East and North (2,) [m].

        A receiver's velocity that is wrong by 0.1 m/s for minutes keeps the filter a metre away from the positions.
        These are right on average, and thus the better estimate. The result is limited to the standard deviation of a
        fix, since a larger difference has another cause.
        """
        offset, largest = self.position.record.offset, self._parameters.position_sd
        size = float(np.hypot(*offset))
        return offset if size <= largest else offset * (largest / size)

    @property
    def variance_factor(self) -> float:
        """Factor by which the covariance is too small according to the last innovations, at least 1.

        It is the variance of unit weight of adjustment theory: states and noises are scaled together, so that the gains
        do not change. It matters only for the covariance at a loss of GNSS.
        """
        return min(max(1.0, self.position.record.mean, self.velocity.record.mean), _LARGEST_FACTOR)

    def figures(self) -> dict[str, Any]:
        """Status: NIS per degree of freedom (1 for a consistent filter), noise factors, gate radius, resets."""
        figures = {}
        for sensor in (self.position, self.velocity):
            figures[f"nis.{sensor.kind.name}"] = sensor.record.mean
            figures[f"nis.{sensor.kind.name}.p99"] = sensor.record.p99
            figures[f"innovation.{sensor.kind.name}.lag_1"] = sensor.record.lag_one
        lasting = self.reception.lasting
        if lasting is not None:
            figures |= lasting_error.figures(self._parameters, lasting.variance, self.reception.shown)
        figures["gnss.noise.position_factor"] = self.position.noise.factor
        figures["gnss.noise.velocity_factor"] = self.velocity.noise.factor
        figures["gnss.gate_radius_m"] = self.position.gate_radius
        figures["gnss.resets"] = float(self.position.resets)
        figures["gnss.last_reset_m"] = self.position.last_reset_m
        return figures
