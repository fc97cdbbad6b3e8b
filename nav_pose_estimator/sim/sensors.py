"""Sensor models: samples from the true motion with biases, noise, latency and rounding.

Each sensor has a function and an independent random generator.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from nav_pose_estimator.core.earth.atmosphere import height_pressure
from nav_pose_estimator.core.earth.ellipsoid import gravity, radii_many
from nav_pose_estimator.core.numerics.rotation import quat_conjugate_many, quat_rotate_many
from nav_pose_estimator.engine.samples import (
    Airspeed,
    BodyVelocity,
    GnssFix,
    GnssVelocity,
    ImuBlock,
    MagSample,
    PressureSample,
    RangeToGround,
    Sample,
    SatelliteCount,
)
from nav_pose_estimator.sim.imu_grades import ImuGrade
from nav_pose_estimator.sim.noise import gauss_markov, white_noise
from nav_pose_estimator.sim.trajectories import Truth


class Timed(NamedTuple):
    """A sample with its time of arrival, which is later than its stamp by the transport delay."""

    arrival_ns: int
    sample: Sample


@dataclass(frozen=True)
class ImuData:
    """Samples of an IMU and its errors: measured = (I + M) true + bias + noise."""

    block: ImuBlock
    gyro_bias: np.ndarray  # (N, 3) rad/s
    accel_bias: np.ndarray  # (N, 3) m/s^2
    gyro_matrix: np.ndarray  # (3, 3)
    accel_matrix: np.ndarray  # (3, 3)


def imu(truth: Truth, grade: ImuGrade, rng: np.random.Generator, start_ns: int) -> ImuData:
    """Samples of an IMU of ``grade`` at all N rows of ``truth``."""
    n, dt = len(truth), truth.dt
    warm = grade.warm_up * -np.expm1(-(truth.t - truth.t[0]) / grade.warm_up_tau)
    halves = []
    for values, noise, sd, tau, turn_on, matrix_sd, resolution, per_kelvin in (
        (truth.gyro, grade.gyro_noise, grade.gyro_bias_sd, grade.gyro_bias_tau, grade.gyro_turn_on_sd,
         grade.gyro_matrix_sd, grade.gyro_resolution, grade.gyro_per_kelvin),
        (truth.accel, grade.accel_noise, grade.accel_bias_sd, grade.accel_bias_tau, grade.accel_turn_on_sd,
         grade.accel_matrix_sd, grade.accel_resolution, grade.accel_per_kelvin),
    ):  # fmt: skip
        bias = turn_on * rng.standard_normal(3) + np.outer(warm, per_kelvin * rng.standard_normal(3))
        matrix = matrix_sd * rng.standard_normal((3, 3))
        bias = bias + gauss_markov(rng, n, dt, sd, tau)
        measured = values + values @ matrix.T + bias + white_noise(rng, n, dt, noise)
        if resolution > 0.0:
            # drivers scale the integers of the sensor in single precision
            measured = np.float32(np.round(measured / resolution) * resolution).astype(float)
        halves.append((measured, bias, matrix))
    (gyro, gyro_bias, gyro_matrix), (accel, accel_bias, accel_matrix) = halves
    block = ImuBlock(to_ns(truth.t, start_ns), gyro, accel)
    return ImuData(block, gyro_bias, accel_bias, gyro_matrix, accel_matrix)


@dataclass(frozen=True)
class Gnss:
    """A single-frequency receiver: correlated and white position errors, Doppler velocity, satellite count."""

    rate: float = 5.0  # Hz
    position_sd: tuple[float, float, float] = (0.5, 0.5, 0.9)  # m, Gauss-Markov: East, North, Up
    position_tau: float = 60.0  # s
    position_noise: tuple[float, float, float] = (0.25, 0.25, 0.4)  # m, white
    velocity_noise: tuple[float, float, float] = (0.1, 0.1, 0.15)  # m/s, white
    satellites: float = 14.0  # mean
    satellites_sd: float = 1.2
    satellites_tau: float = 40.0  # s
    drops: tuple[tuple[float, float, int], ...] = ()  # (start s, length s, count that remains)
    latency: float = 0.0  # s: stamp minus time of validity, unknown to the driver
    transport: float = 0.001  # s: arrival minus stamp
    lever_arm: tuple[float, float, float] = (0.0, 0.0, 0.0)  # m, antenna from the IMU in the body
    velocity: bool = True  # whether there is a velocity
    accuracy: bool = True  # whether covariances are given
    stated: float = 1.0  # ratio of the stated to the true standard deviation
    worse: tuple[tuple[float, float, float], ...] = ()  # (start s, length s, factor on the errors), not in covariances
    outliers: tuple[float, float] = (0.0, 1.0)  # fraction of epochs with larger errors, and the factor on them


def gnss(truth: Truth, model: Gnss, rng: np.random.Generator, start_ns: int) -> list[Timed]:
    """Samples of fix, velocity and satellite count, in this order as from MAVROS; the count has no stamp."""
    t = sensor_times(truth, model.rate)
    at = truth.at(t)
    lever = np.array(model.lever_arm)
    position_error = gauss_markov(rng, len(t), 1.0 / model.rate, np.array(model.position_sd), model.position_tau)
    position_error += rng.standard_normal((len(t), 3)) * model.position_noise
    velocity_error = rng.standard_normal((len(t), 3)) * model.velocity_noise
    count = _satellites(model, rng, t)
    unstated = _unstated_factor(model, rng, t)
    position_error, velocity_error = position_error * unstated, velocity_error * unstated
    # with fewer satellites the errors grow as the square root of the usual number over the present one
    poor = np.sqrt(model.satellites / np.maximum(count, 1.0))
    arm_n = quat_rotate_many(at.q_nb, lever)
    lat, lon, alt = moved(at, arm_n + position_error * poor[:, None])
    velocity = at.v_n + quat_rotate_many(at.q_nb, np.cross(at.gyro, lever)) + velocity_error * poor[:, None]

    stamps = to_ns(t + model.latency, start_ns)
    arrivals = to_ns(t + model.latency + model.transport, start_ns)
    position_var = (np.square(model.position_sd) + np.square(model.position_noise)) * model.stated**2
    velocity_var = np.square(model.velocity_noise) * model.stated**2
    stream: list[Timed] = []
    for i in range(len(t)):
        stamp, arrival, n = int(stamps[i]), int(arrivals[i]), int(count[i])
        cov = np.diag(position_var) * poor[i] ** 2 if model.accuracy and n else None
        fix = GnssFix(stamp, float(lat[i]), float(lon[i]), float(alt[i]), 0, cov)
        stream.append(Timed(arrival, fix if n else GnssFix(stamp, np.nan, np.nan, np.nan, -1)))
        if model.velocity and n:
            cov = np.diag(velocity_var) * poor[i] ** 2 if model.accuracy else None
            stream.append(Timed(arrival + 50_000, GnssVelocity(stamp, tuple(velocity[i].tolist()), cov)))
        stream.append(Timed(arrival + 100_000, SatelliteCount(None, n)))
    return stream


def _unstated_factor(model: Gnss, rng: np.random.Generator, t: np.ndarray) -> np.ndarray:
    """Factor (N, 1) on the errors that is not included in the stated covariances."""
    factor = np.ones((len(t), 1))
    for start, length, times in model.worse:
        factor[(t >= start) & (t < start + length)] *= times
    share, times = model.outliers
    if share > 0.0:
        factor[rng.random(len(t)) < share] *= times
    return factor


def _satellites(model: Gnss, rng: np.random.Generator, t: np.ndarray) -> np.ndarray:
    """Number of satellites (N,): a Gauss-Markov process, limited during the drops of the model."""
    wander = gauss_markov(rng, len(t), 1.0 / model.rate, model.satellites_sd, model.satellites_tau, axes=1)[:, 0]
    count = np.clip(np.round(model.satellites + wander), 0.0, 32.0)
    for start, length, left in model.drops:
        inside = (t >= start) & (t < start + length)
        count[inside] = np.minimum(count[inside], left)
    return count


@dataclass(frozen=True)
class Magnetometer:
    """A calibrated magnetometer with residual errors, and the local magnetic field."""

    rate: float = 10.0  # Hz
    strength: float = 48e-6  # T
    declination: float = 0.0  # rad, east positive
    inclination: float = 1.10  # rad, down positive
    noise: float = 0.3e-6  # T per sample
    hard_iron_sd: float = 0.4e-6  # T per axis
    soft_iron_sd: float = 0.01  # standard deviation of each element of the matrix error
    heading_sd: float = 0.03  # rad: error of the mounting about the vertical axis of the body
    disturbances: tuple[tuple[float, float, tuple[float, float, float]], ...] = ()  # (start s, length s, field ENU T)
    transport: float = 0.0005  # s: arrival minus stamp


def magnetometer(truth: Truth, model: Magnetometer, rng: np.random.Generator, start_ns: int) -> list[Timed]:
    """Samples of the magnetic field in b."""
    t = sensor_times(truth, model.rate)
    at = truth.at(t)
    level = model.strength * np.cos(model.inclination)
    field = np.tile(
        [level * np.sin(model.declination), level * np.cos(model.declination),
         -model.strength * np.sin(model.inclination)],
        (len(t), 1),
    )  # fmt: skip
    for start, length, extra in model.disturbances:
        field[(t >= start) & (t < start + length)] += extra
    body = quat_rotate_many(quat_conjugate_many(at.q_nb), field)
    hard = model.hard_iron_sd * rng.standard_normal(3)
    matrix = np.eye(3) + model.soft_iron_sd * rng.standard_normal((3, 3))
    turn = model.heading_sd * rng.standard_normal()
    c, s = np.cos(turn), np.sin(turn)
    matrix = matrix @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    body = body @ matrix.T + hard + model.noise * rng.standard_normal(body.shape)
    return _timed(t, model.transport, start_ns, body, lambda stamp, value: MagSample(stamp, tuple(value)))


@dataclass(frozen=True)
class Barometer:
    """A barometer with an offset and a drift, by weather and temperature."""

    rate: float = 10.0  # Hz
    noise: float = 2.0  # Pa per sample
    offset_sd: float = 150.0  # Pa: deviation from the standard atmosphere
    drift: float = 0.3  # Pa/sqrt(s), random walk
    resolution: float = 0.25  # Pa
    transport: float = 0.0005  # s: arrival minus stamp
    variance: bool = True  # whether the variance of the noise is given


def barometer(truth: Truth, model: Barometer, rng: np.random.Generator, start_ns: int) -> list[Timed]:
    """Samples of the static pressure."""
    t = sensor_times(truth, model.rate)
    pressure = height_pressure(truth.at(t).alt) + model.offset_sd * rng.standard_normal()
    pressure += np.cumsum(rng.standard_normal(len(t)) * model.drift / np.sqrt(model.rate))
    pressure += model.noise * rng.standard_normal(len(t))
    if model.resolution > 0.0:
        pressure = np.round(pressure / model.resolution) * model.resolution
    variance = model.noise**2 if model.variance else None
    return _timed(t, model.transport, start_ns, pressure, lambda stamp, value: PressureSample(stamp, value, variance))


@dataclass(frozen=True)
class DepthGauge:
    """A pressure sensor of an underwater vehicle that starts at the surface; with an offset by tide and weather."""

    rate: float = 5.0  # Hz
    density: float = 1025.0  # kg/m^3
    noise: float = 200.0  # Pa per sample
    offset_sd: float = 2000.0  # Pa, constant
    drift: float = 5.0  # Pa/sqrt(s), random walk
    transport: float = 0.0005  # s: arrival minus stamp


def depth_gauge(truth: Truth, model: DepthGauge, rng: np.random.Generator, start_ns: int) -> list[Timed]:
    """Samples of the absolute pressure of the water."""
    t = sensor_times(truth, model.rate)
    depth = truth.alt[0] - truth.at(t).alt
    pressure = height_pressure(0.0) + model.density * gravity(truth.lat[0], truth.alt[0]) * depth
    pressure += model.offset_sd * rng.standard_normal()
    pressure += np.cumsum(rng.standard_normal(len(t)) * model.drift / np.sqrt(model.rate))
    pressure += model.noise * rng.standard_normal(len(t))
    return _timed(t, model.transport, start_ns, pressure, PressureSample)


@dataclass(frozen=True)
class Pitot:
    """A pitot tube along the x axis of b, with the true airspeed as output and a scale error."""

    rate: float = 10.0  # Hz
    noise: float = 0.4  # m/s per sample
    scale_sd: float = 0.03
    transport: float = 0.0005  # s: arrival minus stamp


def airspeed(truth: Truth, model: Pitot, rng: np.random.Generator, start_ns: int) -> list[Timed]:
    """Samples of the true airspeed, by the flow along the x axis of b."""
    t = sensor_times(truth, model.rate)
    at = truth.at(t)
    flow = quat_rotate_many(quat_conjugate_many(at.q_nb), at.v_n - at.wind_n)[:, 0]
    measured = np.maximum(flow, 0.0) * (1.0 + model.scale_sd * rng.standard_normal())
    measured = measured + model.noise * rng.standard_normal(len(t))
    return _timed(t, model.transport, start_ns, measured, Airspeed)


@dataclass(frozen=True)
class Rangefinder:
    """A downward laser rangefinder over ground that is flat except for ``roughness``."""

    rate: float = 20.0  # Hz
    noise: float = 0.03  # m per sample
    roughness: float = 0.05  # m
    farthest: float = 60.0  # m: maximum range
    transport: float = 0.0005  # s: arrival minus stamp


def ground_range(truth: Truth, model: Rangefinder, rng: np.random.Generator, start_ns: int) -> list[Timed]:
    """Samples of the distance along the beam to the ground, at the initial height; none beyond the maximum range."""
    t = sensor_times(truth, model.rate)
    at = truth.at(t)
    down = -quat_rotate_many(at.q_nb, np.array([0.0, 0.0, -1.0]))[:, 2]
    height = at.alt - truth.alt[0] + 0.2 + model.roughness * rng.standard_normal(len(t))
    distance = height / np.maximum(down, 0.1) + model.noise * rng.standard_normal(len(t))
    seen = (distance > 0.05) & (distance < model.farthest) & (down > 0.5)
    return _timed(t[seen], model.transport, start_ns, distance[seen], RangeToGround)


@dataclass(frozen=True)
class Wheels:
    """Wheel odometry: the speed along the x axis of b; the lateral and vertical velocities are given as zero."""

    rate: float = 20.0  # Hz
    noise: float = 0.05  # m/s per sample
    scale_sd: float = 0.01  # by the radius of the tyres
    transport: float = 0.0005  # s: arrival minus stamp


def wheels(truth: Truth, model: Wheels, rng: np.random.Generator, start_ns: int) -> list[Timed]:
    """Samples of the velocity in b."""
    t = sensor_times(truth, model.rate)
    at = truth.at(t)
    speed = quat_rotate_many(quat_conjugate_many(at.q_nb), at.v_n)[:, 0] * (
        1.0 + model.scale_sd * rng.standard_normal()
    )
    speed = speed + model.noise * rng.standard_normal(len(t))
    cov = np.diag([model.noise**2, 0.1**2, 0.1**2])
    return _timed(t, model.transport, start_ns, speed, lambda stamp, value: BodyVelocity(stamp, (value, 0.0, 0.0), cov))


def sensor_times(truth: Truth, rate: float) -> np.ndarray:
    """Sample times of a sensor of ``rate`` [Hz] within the recording, starting after half a sample interval."""
    return np.arange(0.5 / rate + truth.t[0], truth.t[-1], 1.0 / rate)


def _timed(
    t: np.ndarray, transport: float, start_ns: int, values: np.ndarray, make: Callable[[int, Any], Sample]
) -> list[Timed]:
    """Samples ``make(stamp, value)`` of ``values`` (N, ...) at ``t`` (N,) [s]; they arrive ``transport`` [s] later."""
    stamps, arrivals = to_ns(t, start_ns).tolist(), to_ns(t + transport, start_ns).tolist()
    rows = zip(arrivals, stamps, values.tolist(), strict=True)
    return [Timed(arrival, make(stamp, value)) for arrival, stamp, value in rows]


def to_ns(t: np.ndarray, start_ns: int) -> np.ndarray:
    """Stamps (N,) int64 of times [s] since ``start_ns``."""
    return start_ns + np.round(np.asarray(t) * 1e9).astype(np.int64)


def moved(truth: Truth, offset_n: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Latitude, longitude [rad] and height [m] (N,) of ``truth``, moved by ``offset_n`` (N, 3) [m] ENU."""
    R_M, R_N = radii_many(truth.lat)
    lat = truth.lat + offset_n[:, 1] / (R_M + truth.alt)
    lon = truth.lon + offset_n[:, 0] / ((R_N + truth.alt) * np.cos(truth.lat))
    return lat, lon, truth.alt + offset_n[:, 2]
