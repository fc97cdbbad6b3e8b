"""What the aligner has to know, and what it gives."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.filter.measurement_noise import NoiseModel

Array = NDArray[np.float64]
_VELOCITY_FLOOR = 0.1  # m/s
_SLOW_SPEED = 1.5  # m/s: receivers hold or smooth the velocity of a slow antenna
_SLOW_SD = 1.0  # m/s at standstill
_VELOCITY_CORRELATION = 0.3  # s: fixes closer than this share their velocity error
_SHARED_ELSEWHERE = ("gyro_noise", "accel_noise", "declination", "lever_arm", "known")


@dataclass(frozen=True, slots=True)
class KnownBiases:
    """What a navigator has just known of its IMU, body frame; each deviation is that of the worst axis."""

    gyro: tuple[float, float, float]  # rad/s
    accel: tuple[float, float, float]  # m/s^2
    gyro_sd: float
    accel_sd: float


@dataclass(frozen=True, slots=True)
class AlignmentSettings:
    """What the aligner has to know; deviations are one sigma."""

    gyro_noise: float  # rad/s/sqrt(Hz)
    accel_noise: float  # m/s^2/sqrt(Hz)
    declination: float  # rad, east positive
    lever_arm: tuple[float, ...]  # m, antenna from the IMU, body frame
    static_window: float  # s at rest that level the filter
    rest_gyro_sd: float  # rad/s, thresholds of the rest detector
    rest_accel_sd: float  # m/s^2
    rest_rate: float  # rad/s
    rest_speed: float  # m/s, GNSS speed above which there is no rest
    gyro_bias_sd: float  # rad/s, before anything is known
    accel_bias_sd: float  # m/s^2
    tilt_sd: float  # rad, of a level found in motion
    hypotheses: int
    heading_sd: float  # rad, the heading must be this good
    min_time: float  # s of GNSS before the hypotheses may decide
    mag_heading_sd: float  # rad, of a magnetic heading before the first flight
    mag_trust: float  # probability that a plausible magnetometer is within that
    known: KnownBiases | None = None  # from just before; None after switching on

    @classmethod
    def shared(cls) -> tuple[str, ...]:
        """Names of the settings that belong to the alignment alone."""
        return tuple(item.name for item in fields(cls) if item.name not in _SHARED_ELSEWHERE)


@dataclass(frozen=True, slots=True)
class Alignment:
    """A first state: ``nav`` (NAV_SIZE,) of ``layout`` valid at ``t``, covariance ``P`` (15, 15), and how it came.

    Without ``has_position`` only attitude and gyroscope bias mean something.
    """

    t: float
    nav: Array
    P: Array
    method: str
    has_position: bool = True
    from_magnetometer: bool = False
    """Whether nothing but the magnetometer tells the heading."""
    continues: bool = False
    """Whether the heading is what a navigator knew before a restart, or what a magnetometer told that it knew."""
    last_fix: float | None = None
    """When GNSS corrected the position last, where that is not by this start itself [s]."""
    unseen: float = 0.0
    """Seconds without IMU data before this start, where no fix has shown since where the vehicle went."""
    nis: float = 1.0
    """Mean NIS per degree of freedom of the heading hypothesis that won; 1 where there was none."""


@dataclass(frozen=True, slots=True)
class Fix:
    """A fix as the aligner takes it: position [rad, rad, m], velocity ENU [m/s] or None, deviations (3,)."""

    t: float
    position: tuple[float, float, float]
    velocity: Array | None
    position_sd: Array
    velocity_sd: Array


class FixNoise(NamedTuple):
    """How noisy a receiver's positions and velocities are taken to be; the navigator goes on with the same two."""

    position: NoiseModel
    velocity: NoiseModel


@dataclass(frozen=True, slots=True)
class RestLevel:
    """What a rest has taught: attitude at heading zero and mean rate, with their covariance (15, 15)."""

    t: float
    q: Array
    rate: Array
    P: Array


def fix_velocity(vel_enu: Sequence[float] | None, sd: float, period: float) -> tuple[Array | None, Array]:
    """Velocity (3,) or None, and the deviations (3,) that make its errors look independent from fix to fix."""
    spread = max(sd, _VELOCITY_FLOOR) * np.array([1.0, 1.0, 1.5])
    if vel_enu is None or not (math.isfinite(vel_enu[0]) and math.isfinite(vel_enu[1])):
        return None, spread
    velocity = np.array(vel_enu, dtype=float)
    if not math.isfinite(velocity[2]):
        velocity[2], spread[2] = 0.0, 30.0
    slow = max(1.0 - math.hypot(*velocity) / _SLOW_SPEED, 0.0)
    return velocity, np.hypot(spread, _SLOW_SD * slow) * math.sqrt(1.0 + _VELOCITY_CORRELATION / period)
