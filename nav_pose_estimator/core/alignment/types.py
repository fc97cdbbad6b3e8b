"""Settings, inputs and results of the start-up alignment."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.filter.measurement_noise import NoiseModel

Array = NDArray[np.float64]
VERTICAL_SHARE = 1.7
"""Usual ratio of vertical to horizontal deviation of a fix (VDOP over HDOP)."""
_VERTICAL_VELOCITY_SHARE = 1.5  # the same of its velocity
_UNKNOWN_CLIMB_SD = 30.0  # m/s: standard deviation of a missing vertical velocity
_VELOCITY_FLOOR = 0.1  # m/s: smallest standard deviation that a GNSS velocity is given
_SLOW_SPEED = 1.5  # m/s: below it receivers hold or smooth the velocity
_SLOW_SD = 1.0  # m/s: additional standard deviation of the velocity at standstill, falling to 0 at ``_SLOW_SPEED``
_VELOCITY_CORRELATION = 0.3  # s: correlation time of the velocity error
_SHARED_ELSEWHERE = ("gyro_noise", "accel_noise", "declination", "lever_arm", "known")


@dataclass(frozen=True, slots=True)
class KnownBiases:
    """IMU biases (3,) in b that a running navigator has estimated; each deviation is that of the worst axis."""

    gyro: tuple[float, float, float]  # rad/s
    accel: tuple[float, float, float]  # m/s^2
    gyro_sd: float
    accel_sd: float


@dataclass(frozen=True, slots=True)
class AlignmentSettings:
    """Settings of the alignment; deviations are one sigma."""

    gyro_noise: float  # rad/s/sqrt(Hz)
    accel_noise: float  # m/s^2/sqrt(Hz)
    declination: float  # rad, east positive
    lever_arm: tuple[float, ...]  # m, antenna from the IMU, body frame
    static_window: float  # s at rest over which the levelling averages
    rest_gyro_sd: float  # rad/s, thresholds of the rest detector
    rest_accel_sd: float  # m/s^2
    rest_rate: float  # rad/s
    rest_speed: float  # m/s, GNSS speed above which there is no rest
    gyro_bias_sd: float  # rad/s, before any estimate
    accel_bias_sd: float  # m/s^2
    tilt_sd: float  # rad, of a level found in motion
    hypotheses: int
    heading_sd: float  # rad, required accuracy of the heading
    min_time: float  # s of GNSS before the hypotheses may give a result
    mag_heading_sd: float  # rad, of an uncalibrated magnetic heading
    mag_trust: float  # probability that a plausible magnetometer is within ``mag_heading_sd``
    known: KnownBiases | None = None  # of the run before; None after power-on

    @classmethod
    def shared(cls) -> tuple[str, ...]:
        """Names of the settings that are the alignment's own parameters (the others come from other rooms)."""
        return tuple(item.name for item in fields(cls) if item.name not in _SHARED_ELSEWHERE)


@dataclass(frozen=True, slots=True)
class Alignment:
    """A first state: ``nav`` (NAV_SIZE,) of ``layout`` valid at ``t`` [s], covariance ``P`` (15, 15), and its method.

    Without ``has_position`` only attitude and gyroscope bias are valid.
    """

    t: float
    nav: Array
    P: Array
    method: str
    has_position: bool = True
    from_magnetometer: bool = False
    """Whether the heading comes from the magnetometer alone."""
    continues: bool = False
    """Whether the heading continues that of a navigator before a restart, carried by its gyroscope or magnetometer."""
    last_fix: float | None = None
    """Time [s] of the last GNSS position update, where this start itself used none."""
    unseen: float = 0.0
    """Seconds without IMU data before this start that no fix has bridged since."""
    nis: float = 1.0
    """Mean NIS per degree of freedom of the heading hypothesis that won; 1 where there was none."""


@dataclass(frozen=True, slots=True)
class Fix:
    """A GNSS fix: time [s], position [rad, rad, m], velocity (3,) ENU [m/s] or None, standard deviations (3,)."""

    t: float
    position: tuple[float, float, float]
    velocity: Array | None
    position_sd: Array
    velocity_sd: Array

    def __deepcopy__(self, _memo: dict) -> "Fix":
        """It is shared by all copies: its arrays are never written to."""
        return self


class FixNoise(NamedTuple):
    """Noise models of a receiver's position and velocity; the navigator continues with the same two."""

    position: NoiseModel
    velocity: NoiseModel


@dataclass(frozen=True, slots=True)
class RestLevel:
    """Result of a levelling at rest: attitude (4,) at yaw zero, mean rate (3,) [rad/s], covariance (15, 15)."""

    t: float
    q: Array
    rate: Array
    P: Array


def fix_velocity(vel_enu: Sequence[float] | None, sd: float, period: float) -> tuple[Array | None, Array]:
    """Velocity (3,) or None, and its deviations (3,) [m/s], inflated for fixes ``period`` [s] apart.

    Errors of a GNSS velocity are correlated over ``_VELOCITY_CORRELATION``. A filter that takes them as independent
    needs a larger variance: it is multiplied by 1 + correlation time / period.
    """
    spread = max(sd, _VELOCITY_FLOOR) * np.array([1.0, 1.0, _VERTICAL_VELOCITY_SHARE])
    if vel_enu is None or not (math.isfinite(vel_enu[0]) and math.isfinite(vel_enu[1])):
        return None, spread
    velocity = np.array(vel_enu, dtype=float)
    if not math.isfinite(velocity[2]):
        velocity[2], spread[2] = 0.0, _UNKNOWN_CLIMB_SD
    slow = max(1.0 - math.hypot(*velocity) / _SLOW_SPEED, 0.0)
    return velocity, np.hypot(spread, _SLOW_SD * slow) * math.sqrt(1.0 + _VELOCITY_CORRELATION / period)
