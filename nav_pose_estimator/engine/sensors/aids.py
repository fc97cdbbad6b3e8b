"""Aids besides GNSS: magnetometer, barometer, velocity sensor, and rest. From samples to observations."""

import copy
import math

import numpy as np

from nav_pose_estimator.core.earth.atmosphere import pressure_height
from nav_pose_estimator.core.filter import measurements
from nav_pose_estimator.core.filter.kalman import gated_correct
from nav_pose_estimator.core.filter.layout import ALT, DVEL, GYRO_BIAS, PHI, TIME, VEL
from nav_pose_estimator.core.filter.vertical_channel import gated_height
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.navigator.timeline import Observation
from nav_pose_estimator.engine.number_checks import is_covariance, is_within
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import BodyVelocity, MagSample, PressureSample
from nav_pose_estimator.engine.sensors.imu import rotation_from_rpy

_LINEARISE = {
    "height": measurements.height,
    "magnetic_heading": measurements.magnetic_heading,
    "body_velocity": measurements.body_velocity,
    "zero_velocity": measurements.zero_velocity,
}
_LARGEST_SPEED = 1e3  # m/s
_LARGEST_FIELD = 1e6  # in any unit
_CORRELATION = 5.0  # s: magnetic headings and barometric heights closer than this share their error
_BOUNDING = frozenset(("body_velocity", "zero_velocity"))
UNEVENTFUL = frozenset(_LINEARISE) - _BOUNDING
"""Kinds of observation that never change the mode."""
_REST_RATE = 0.01  # rad/s: at rest nothing but bias and the Earth is left of the mean angular rate
_REST_SPEED = 0.7  # m/s: the navigator must be sure, by two deviations, to be slower than that


class AidInput:
    """Turns aid samples into observations and applies them when their time has come."""

    def __init__(self, parameters: Parameters, gates: list[tuple[float, float]], journal: Journal) -> None:
        self._journal = journal
        self.set_parameters(parameters, gates)
        self._last: dict[str, float] = {}
        self.last_bounding = -math.inf  # when the drift was last bounded by something other than GNSS
        self._baro_offset = math.nan  # barometric minus filter height
        self._baro_since = 0.0
        self._mag_offset = math.nan  # magnetic minus filter heading
        self._mag_since = 0.0

    def set_parameters(self, parameters: Parameters, gates: list[tuple[float, float]]) -> None:
        """New noises and periods; what was learned of offsets stays."""
        self._parameters, self._gates = parameters.aids, gates
        self._velocity_axes = rotation_from_rpy(parameters.aids.body_velocity_rpy)

    def copy(self, journal: Journal) -> "AidInput":
        """An independent copy that reports to ``journal``."""
        twin = copy.copy(self)
        twin._journal = journal
        twin._last = dict(self._last)
        return twin

    # --- arrival: (time of validity, kind, arguments) or None --------------------------------------------------------

    def magnetometer(self, sample: MagSample, t: float) -> tuple | None:
        """A levelled heading, at most every ``magnetometer_period``."""
        if not self._parameters.magnetometer or not self._is_due("magnetic_heading", t):
            return None
        if not is_within(sample.field, _LARGEST_FIELD) or not any(sample.field):
            return self._refuse("mag.rejected.value")
        return t, "magnetic_heading", sample.field

    def barometer(self, sample: PressureSample, t: float) -> tuple | None:
        """A height against the reference that is learned while GNSS is good."""
        if not self._parameters.barometer or not self._is_due("height", t):
            return None
        if not 1_000.0 < sample.pressure < 120_000.0:
            return self._refuse("baro.rejected.value")
        return t, "height", (pressure_height(sample.pressure),)

    def body_velocity(self, sample: BodyVelocity, t: float) -> tuple | None:
        """A velocity over ground in the sensor's axes."""
        if not self._parameters.body_velocity:
            return None
        measured = [value for value in sample.velocity if not math.isnan(value)]
        if not measured or not is_within(measured, _LARGEST_SPEED):
            return self._refuse("body_velocity.rejected.value")
        known = sample.cov is not None and is_covariance(sample.cov, 3)
        if sample.cov is not None and not known:
            self._journal.count("body_velocity.covariance.flawed")
        floor = self._parameters.body_velocity_sd**2
        R = np.array(sample.cov, float) if known else np.diag([floor] * 3)
        R[np.diag_indices(3)] = np.maximum(np.diag(R), floor)
        for axis in range(3):
            if not math.isfinite(sample.velocity[axis]):
                R[axis, axis] = 1e6  # an axis that is not measured says nothing
        velocity = self._velocity_axes @ np.nan_to_num(np.array(sample.velocity))
        R = self._velocity_axes @ R @ self._velocity_axes.T
        lever = np.array(self._parameters.body_velocity_lever)
        return t - self._parameters.body_velocity_delay, "body_velocity", (velocity, lever, R)

    def rest(self, mean_rate: np.ndarray, nav: np.ndarray, P: np.ndarray) -> tuple | None:
        """No velocity, where the IMU is still with ``mean_rate`` (3,) [rad/s] and the filter does not object.

        An IMU feels neither a steady turn nor a steady cruise: the bias has to explain the rate, and the navigator has
        to know that it is slow. One that has lost its velocity learns nothing here, safe rather than helpful.
        """
        if math.dist(mean_rate, nav[GYRO_BIAS : GYRO_BIAS + 3]) > _REST_RATE:
            return self._refuse("zero_velocity.withheld.rate")
        speed_sd = math.sqrt(P[DVEL : DVEL + 3, DVEL : DVEL + 3].trace())
        if math.hypot(*nav[VEL : VEL + 3]) + 2.0 * speed_sd > _REST_SPEED:
            return self._refuse("zero_velocity.withheld.speed")
        return float(nav[TIME]), "zero_velocity", (np.eye(3) * self._parameters.zero_velocity_sd**2,)

    # --- application -------------------------------------------------------------------------------------------------

    def apply(self, o: Observation, nav: np.ndarray, P: np.ndarray, constants: np.ndarray, aided: bool) -> None:
        """Let one observation act. ``aided``: GNSS is good at its time, so references may be learned."""
        if o.kind == "height":
            prepared = self._prepare_height(o, nav, P, aided)
        elif o.kind == "magnetic_heading":
            prepared = self._prepare_heading(o, nav, P, aided)
        else:
            prepared = o.arguments[:-1], o.arguments[-1]
        if prepared is None:
            return
        arguments, R = prepared
        z, H = _LINEARISE[o.kind](nav, len(P), *arguments)
        if o.kind == "height":
            status, _ = gated_height(nav, P, constants, float(z[0]), float(R[0, 0]), *self._gates[0])
        else:
            soft, hard = self._gates[len(z) - 1]
            # a rest that is unlikely is none, and not one that counts for less
            status, _ = gated_correct(nav, P, constants, z, H, R, soft, soft if o.kind == "zero_velocity" else hard)
        if o.memory.get("counted"):
            return
        o.memory["counted"] = True
        self._journal.count(f"{o.kind}.{('rejected', 'used', 'inflated')[status]}")
        if status and o.kind in _BOUNDING:
            self.last_bounding = max(self.last_bounding, o.t)

    def _prepare_height(self, o: Observation, nav: np.ndarray, P: np.ndarray, aided: bool) -> tuple | None:
        """Learn the reference while GNSS is good; without GNSS use it."""
        if aided and "offset" not in o.memory:
            difference = o.arguments[0] - float(nav[ALT])
            if math.isnan(self._baro_offset):
                self._baro_offset, self._baro_since = difference, o.t
            share = self._parameters.barometer_period / min(
                max(o.t - self._baro_since, self._parameters.barometer_period), self._parameters.barometer_tau
            )
            self._baro_offset += min(share, 1.0) * (difference - self._baro_offset)
        o.memory.setdefault("offset", self._baro_offset)
        offset = o.memory["offset"]
        if aided or math.isnan(offset):
            return None
        # heights closer than the correlation time of wind and pressure share their error
        R = self._parameters.barometer_sd**2 * (1.0 + _CORRELATION / max(self._parameters.barometer_period, 0.1))
        return (o.arguments[0] - offset,), np.array([[R]])

    def _prepare_heading(self, o: Observation, nav: np.ndarray, P: np.ndarray, aided: bool) -> tuple | None:
        """While GNSS shows the heading learn the magnetometer's offset; otherwise let it hold the heading."""
        field = tuple(o.arguments)
        heading_sd = math.sqrt(P[PHI + 2, PHI + 2])
        if aided and heading_sd < 0.2 and "offset" not in o.memory:
            z, _ = measurements.magnetic_heading(nav, len(P), *field, self._parameters.declination)
            if math.isnan(self._mag_offset):
                self._mag_offset, self._mag_since = float(z[0]), o.t
            share = self._parameters.magnetometer_period / min(max(o.t - self._mag_since, 1.0), 100.0)
            self._mag_offset += min(share, 1.0) * math.remainder(float(z[0]) - self._mag_offset, 2.0 * math.pi)
        o.memory.setdefault("offset", self._mag_offset)
        offset = o.memory["offset"]
        if math.isnan(offset) or (aided and heading_sd < 0.2):
            return None
        tilt_var = P[PHI, PHI] + P[PHI + 1, PHI + 1]
        R = self._parameters.magnetometer_sd**2 * (1.0 + _CORRELATION / max(self._parameters.magnetometer_period, 0.1))
        return (*field, self._parameters.declination + offset), np.array([[R + 4.0 * tilt_var]])

    def _is_due(self, kind: str, t: float) -> bool:
        period = {
            "magnetic_heading": self._parameters.magnetometer_period,
            "height": self._parameters.barometer_period,
        }[kind]
        if t - self._last.get(kind, -math.inf) < period - 1e-6:
            return False
        self._last[kind] = t
        return True

    def _refuse(self, name: str) -> None:
        self._journal.count(name)
