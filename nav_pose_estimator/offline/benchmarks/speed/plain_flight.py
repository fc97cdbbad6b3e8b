"""A flight by simple formulas (rest, acceleration, then circles) for the speed benchmark and tests."""

import math

import numpy as np

from nav_pose_estimator.core.earth.atmosphere import height_pressure
from nav_pose_estimator.core.earth.ellipsoid import enu_to_lla, gravity_many
from nav_pose_estimator.engine.samples import (
    GnssFix,
    GnssVelocity,
    ImuBlock,
    MagSample,
    PressureSample,
    Sample,
    known_stamp,
)
from nav_pose_estimator.offline.flights.interleaving import interleaved

ORIGIN = (math.radians(48.0), math.radians(11.0), 500.0)
REST, RUN_UP, ACCELERATION, TURN_RATE = 10.0, 5.0, 2.0, 0.2  # s, s, m/s^2, rad/s
FIELD_EN_U = (0.0, 2.0e-5, -4.0e-5)  # T


def motion(t: np.ndarray) -> tuple[np.ndarray, ...]:
    """Position ENU (N, 3), velocity ENU (N, 3), yaw (N,), specific force FLU (N, 3), angular rate FLU (N, 3)."""
    run = np.clip(t - REST, 0.0, RUN_UP)
    turning = np.maximum(t - REST - RUN_UP, 0.0)
    speed, top = ACCELERATION * run, ACCELERATION * RUN_UP
    yaw = TURN_RATE * turning
    radius = top / TURN_RATE
    east = 0.5 * ACCELERATION * run**2 + radius * np.sin(yaw)
    north = radius * (1.0 - np.cos(yaw))
    zero = np.zeros_like(t)
    velocity = np.stack([speed * np.cos(yaw), speed * np.sin(yaw), zero], axis=1)
    force, rate = np.zeros((2, len(t), 3))
    force[:, 0] = np.where((t > REST) & (t <= REST + RUN_UP), ACCELERATION, 0.0)
    force[:, 1] = np.where(turning > 0.0, top * TURN_RATE, 0.0)
    force[:, 2] = gravity_many(ORIGIN[0], ORIGIN[2])
    rate[:, 2] = np.where(turning > 0.0, TURN_RATE, 0.0)
    return np.stack([east, north, zero], axis=1), velocity, yaw, force, rate


def samples(
    seconds: float, imu_hz: float = 200.0, gnss_hz: float = 1.0, delay: float = 0.0, seed: int = 1, epoch_s: int = 10**9
) -> list[Sample]:
    """The flight as samples in order of arrival: IMU in blocks between the others, fixes ``delay`` [s] late."""
    rng = np.random.default_rng(seed)
    imu = _imu(seconds, imu_hz, rng, epoch_s)
    others = [*_gnss(seconds, gnss_hz, delay, rng, epoch_s), *_compass(seconds, rng, epoch_s)]
    return _in_order(imu, others)


def full_set(seconds: float, imu_hz: float = 200.0, seed: int = 1, epoch_s: int = 10**9) -> list[Sample]:
    """The flight with 5 Hz of fixes and velocities and 10 Hz of magnetometer and barometer, at stamps of the IMU.

    This case is expensive, because a sample at the time of an IMU sample must be processed before the next one, so that
    blocks cannot be joined.
    """
    rng = np.random.default_rng(seed)
    imu = _imu(seconds, imu_hz, rng, epoch_s)
    compass = _compass(seconds, rng, epoch_s, behind=0.0)
    noise = rng.normal(0.0, 3.0, len(compass)).tolist()  # Pa
    level = height_pressure(ORIGIN[2])
    pressures = [PressureSample(mag.stamp_ns, level + error) for mag, error in zip(compass, noise, strict=True)]
    return _in_order(imu, [*_gnss(seconds, 5.0, 0.0, rng, epoch_s), *compass, *pressures])


def _imu(seconds: float, imu_hz: float, rng: np.random.Generator, epoch_s: int) -> ImuBlock:
    t = np.arange(1, int(seconds * imu_hz) + 1) / imu_hz
    _, _, _, force, rate = motion(t)
    force += rng.normal(0.0, 0.02, force.shape)
    rate += rng.normal(0.0, 0.001, rate.shape)
    return ImuBlock(np.round(t * 1e9).astype(np.int64) + epoch_s * 10**9, rate, force)


def _in_order(imu: ImuBlock, others: list[Sample]) -> list[Sample]:
    others = sorted(others, key=known_stamp)
    rows = np.searchsorted(imu.stamps_ns, list(map(known_stamp, others)), side="right")
    return interleaved(imu, others, rows)


def _gnss(seconds: float, rate_hz: float, delay: float, rng: np.random.Generator, epoch_s: int) -> list[Sample]:
    t = np.arange(1, int((seconds - delay) * rate_hz) + 1) / rate_hz
    position, velocity, _, _, _ = motion(t)
    lat, lon, alt = enu_to_lla(position + rng.normal(0.0, [0.5, 0.5, 1.0], position.shape), *ORIGIN)
    velocity = velocity + rng.normal(0.0, 0.05, velocity.shape)
    out: list[Sample] = []
    for i, stamp in enumerate((np.round((t + delay) * 1e9).astype(np.int64) + epoch_s * 10**9).tolist()):
        out.append(GnssFix(stamp, float(lat[i]), float(lon[i]), float(alt[i])))
        out.append(GnssVelocity(stamp, tuple(velocity[i].tolist())))
    return out


def _compass(
    seconds: float, rng: np.random.Generator, epoch_s: int, rate_hz: float = 10.0, behind: float = 1e-4
) -> list[MagSample]:
    t = np.arange(1, int(seconds * rate_hz) + 1) / rate_hz + behind
    yaw = motion(t)[2]
    east, north, up = FIELD_EN_U
    field = np.stack([np.cos(yaw) * east + np.sin(yaw) * north, np.cos(yaw) * north - np.sin(yaw) * east], axis=1)
    field = np.column_stack([field, np.full(len(t), up)]) + rng.normal(0.0, 1e-7, (len(t), 3))
    stamps = (np.round(t * 1e9).astype(np.int64) + epoch_s * 10**9).tolist()
    return [MagSample(stamp, tuple(row)) for stamp, row in zip(stamps, field.tolist(), strict=True)]
