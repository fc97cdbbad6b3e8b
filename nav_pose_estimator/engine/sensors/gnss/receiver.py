"""GNSS of the navigator: reception, position and velocity sensors, and the correction of the filter at a loss."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from nav_pose_estimator.core.filter import bias_noise, measurements
from nav_pose_estimator.core.filter.kalman import innovation
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.observation import Decision, FilterView, Kind, Observation, Use
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.sensors.aiding import Aiding
from nav_pose_estimator.engine.sensors.gnss import lasting_error
from nav_pose_estimator.engine.sensors.gnss.position import GnssPositionSensor
from nav_pose_estimator.engine.sensors.gnss.reception import GnssReception
from nav_pose_estimator.engine.sensors.gnss.velocity import GnssVelocitySensor
from nav_pose_estimator.engine.sensors.sensor import Linearised, Sensor

_LARGEST_FACTOR = 9.0  # of the covariance: three times the deviation
_RECENT = (1.0, 3.0)  # s of averaged innovations; the longer average may cancel in manoeuvres to and fro
_LASTING_SD = 0.3  # m/s: error that a receiver's velocities may have in common over that time
_CHANCE_LIMIT = 4.0  # largest NIS of that mean that may be chance; its expectation is two
_LARGEST_WIDENING = 100.0  # factor on the covariance of the motion


class LossEvidence(NamedTuple):
    """What the last innovations before a loss of GNSS have shown of the filter.

    ``factor`` by which its covariance is too small; estimate minus measurement, East and North, of positions (2,) [m]
    and of velocities (2,) [m/s].
    """

    factor: float
    position: np.ndarray
    velocity: np.ndarray

    @property
    def positions_agree(self) -> bool:
        """Whether position and velocity errors have the same direction: a filter that is too fast is ahead.

        A wrong velocity of the receiver would have moved the filter in the opposite direction.
        """
        return float(self.velocity @ self.position) > 0.0


class GnssLoss(Sensor):
    """No measurement: it scales the covariance by what the last innovations have shown, and moves the position to the
    mean of the last fixes.

    A velocity error that lasted for seconds and exceeds the stated deviation is due to a tilt error. The covariance of
    the motion is then enlarged until it covers the disagreement. Where the positions agree with it, the velocities
    correct the filter once more; else the error may be the receiver's.
    """

    kind = Kind("gnss_loss", precedence=2, whole=True)

    def set_parameters(self, parameters: Parameters) -> None:
        """It has no parameters."""

    def decide(self, o: Observation, f: FilterView) -> Decision:
        """By what was known when the loss was declared."""
        evidence = o.measured
        stated = evidence.factor * bias_noise.overstatement(f.nav) * f.P
        z, H, R = self.linearise(o, f)
        square = innovation(stated, z, H, R)
        is_inconsistent = square > _CHANCE_LIMIT
        widening = min(square / len(z), _LARGEST_WIDENING) if is_inconsistent else 1.0
        east, north = (-evidence.position).tolist()
        once_more = is_inconsistent and evidence.positions_agree
        return Decision(Use.WIDENING, evidence.factor, widening=widening, shift=(east, north), once_more=once_more)

    def linearise(self, o: Observation, f: FilterView) -> Linearised:
        """The mean innovation of the last velocities, of one second or of three, whichever is larger."""
        _, H = measurements.horizontal_velocity(f.nav, len(f.P), 0.0, 0.0)
        return o.measured.velocity.copy(), H, _LASTING_SD**2 * np.eye(2)


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
        """At ``t`` GNSS counts as lost: what the last innovations have shown acts on the filter."""
        last, velocity = self.velocity.misfit, np.zeros(2)
        is_noise = self.reception.velocity_scatter.is_on
        if last is not None and not is_noise and last.t > self._aiding.fix_used - max(_RECENT):
            velocity = max((self.velocity.record.mean_of_last(seconds) for seconds in _RECENT), key=np.linalg.norm)
        return Observation(t, stamp_ns, self.loss.kind, LossEvidence(self.variance_factor, self.offset, velocity))

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
            figures |= lasting_error.figures(self._parameters, lasting.variance, self.reception.identified)
        figures["gnss.noise.position_factor"] = self.position.noise.factor
        figures["gnss.noise.velocity_factor"] = self.velocity.noise.factor
        figures["gnss.gate_radius_m"] = self.position.gate_radius
        figures["gnss.resets"] = float(self.position.resets)
        figures["gnss.last_reset_m"] = self.position.last_reset_m
        return figures
