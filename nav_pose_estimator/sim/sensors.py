"""What the sensors make of the truth: biases, noise, latency, rounding. One function and one random stream each."""

from dataclasses import dataclass
from typing import NamedTuple

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
    """A sample and when it arrives. Sensors that are late arrive late; their stamps say when they measured."""

    arrival_ns: int
    sample: Sample


@dataclass(frozen=True)
class ImuData:
    """What an IMU delivered, and the errors that an estimator should find: measured = (I + M) true + bias + noise."""

    block: ImuBlock
    gyro_bias: np.ndarray  # (N, 3) rad/s
    accel_bias: np.ndarray  # (N, 3) m/s^2
    gyro_matrix: np.ndarray  # (3, 3)
    accel_matrix: np.ndarray  # (3, 3)


def imu(truth: Truth, grade: ImuGrade, rng: np.random.Generator, start_ns: int) -> ImuData:
    """An IMU of ``grade`` at every row of ``truth``; arrays of N rows."""
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
            # Drivers scale the sensor's integers in single precision.
            measured = np.float32(np.round(measured / resolution) * resolution).astype(float)
        halves.append((measured, bias, matrix))
    (gyro, gyro_bias, gyro_matrix), (accel, accel_bias, accel_matrix) = halves
    block = ImuBlock(to_ns(truth.t, start_ns), gyro, accel)
    return ImuData(block, gyro_bias, accel_bias, gyro_matrix, accel_matrix)


@dataclass(frozen=True)
class Gnss:
    """A single-frequency receiver: correlated position errors, white noise, Doppler velocity, a count of satellites."""

    rate: float = 5.0  # Hz
    position_sd: tuple[float, float, float] = (0.5, 0.5, 0.9)  # m, Gauss-Markov: East, North, Up
    position_tau: float = 60.0  # s
    position_noise: tuple[float, float, float] = (0.25, 0.25, 0.4)  # m, white
    velocity_noise: tuple[float, float, float] = (0.1, 0.1, 0.15)  # m/s, white
    satellites: float = 14.0  # mean
    satellites_sd: float = 1.2
    satellites_tau: float = 40.0  # s
    drops: tuple[tuple[float, float, int], ...] = ()  # (start s, length s, count that remains)
    latency: float = 0.0  # s: stamp minus time of validity, what the driver does not know
    transport: float = 0.001  # s: arrival minus stamp
    lever_arm: tuple[float, float, float] = (0.0, 0.0, 0.0)  # m, antenna from the IMU in the body
    velocity: bool = True  # the receiver gives a velocity
    accuracy: bool = True  # it says how accurate it is
    stated: float = 1.0  # deviation that it states over the true one
    worse: tuple[tuple[float, float, float], ...] = ()  # (start s, length s, factor on the errors): nothing tells it
    outliers: tuple[float, float] = (0.0, 1.0)  # share of epochs whose errors are larger, by this factor


def gnss(truth: Truth, model: Gnss, rng: np.random.Generator, start_ns: int) -> list[Timed]:
    """Fix, velocity and satellite count, in this order, as MAVROS sends them; the count has no stamp."""
    t = sensor_times(truth, model.rate)
    at = truth.at(t)
    lever = np.array(model.lever_arm)
    position_error = gauss_markov(rng, len(t), 1.0 / model.rate, np.array(model.position_sd), model.position_tau)
    position_error += rng.standard_normal((len(t), 3)) * model.position_noise
    velocity_error = rng.standard_normal((len(t), 3)) * model.velocity_noise
    count = _satellites(model, rng, t)
    untold = _untold(model, rng, t)
    position_error, velocity_error = position_error * untold, velocity_error * untold
    # Fewer satellites, poorer geometry: errors grow as the root of what is missing.
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


def _untold(model: Gnss, rng: np.random.Generator, t: np.ndarray) -> np.ndarray:
    """Factor (N, 1) on the errors of which the stated accuracy knows nothing."""
    factor = np.ones((len(t), 1))
    for start, length, times in model.worse:
        factor[(t >= start) & (t < start + length)] *= times
    share, times = model.outliers
    if share > 0.0:
        factor[rng.random(len(t)) < share] *= times
    return factor


def _satellites(model: Gnss, rng: np.random.Generator, t: np.ndarray) -> np.ndarray:
    """Number of satellites (N,): it wanders, and falls where the model says so."""
    wander = gauss_markov(rng, len(t), 1.0 / model.rate, model.satellites_sd, model.satellites_tau, axes=1)[:, 0]
    count = np.clip(np.round(model.satellites + wander), 0.0, 32.0)
    for start, length, left in model.drops:
        inside = (t >= start) & (t < start + length)
        count[inside] = np.minimum(count[inside], left)
    return count


@dataclass(frozen=True)
class Magnetometer:
    """A calibrated magnetometer: what the calibration left over, and the field of the place."""

    rate: float = 10.0  # Hz
    strength: float = 48e-6  # T
    declination: float = 0.0  # rad, east positive
    inclination: float = 1.10  # rad, down positive
    noise: float = 0.3e-6  # T per sample
    hard_iron_sd: float = 0.4e-6  # T per axis
    soft_iron_sd: float = 0.01  # deviation of each element of the matrix error
    heading_sd: float = 0.03  # rad: mounting about the vertical axis of the body
    disturbances: tuple[tuple[float, float, tuple[float, float, float]], ...] = ()  # (start s, length s, field ENU T)
    transport: float = 0.0005  # s: arrival minus stamp


def magnetometer(truth: Truth, model: Magnetometer, rng: np.random.Generator, start_ns: int) -> list[Timed]:
    """Magnetic field in the body."""
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
    stamps, arrivals = to_ns(t, start_ns).tolist(), to_ns(t + model.transport, start_ns).tolist()
    rows = zip(arrivals, stamps, body.tolist(), strict=True)
    return [Timed(arrival, MagSample(stamp, tuple(values))) for arrival, stamp, values in rows]


@dataclass(frozen=True)
class Barometer:
    """A barometer whose reference drifts with the weather and with its own warmth."""

    rate: float = 10.0  # Hz
    noise: float = 2.0  # Pa per sample
    offset_sd: float = 150.0  # Pa: weather against the standard atmosphere
    drift: float = 0.3  # Pa/sqrt(s), random walk
    resolution: float = 0.25  # Pa
    transport: float = 0.0005  # s: arrival minus stamp
    variance: bool = True  # the driver knows the noise


def barometer(truth: Truth, model: Barometer, rng: np.random.Generator, start_ns: int) -> list[Timed]:
    """Static pressure."""
    t = sensor_times(truth, model.rate)
    pressure = height_pressure(truth.at(t).alt) + model.offset_sd * rng.standard_normal()
    pressure += np.cumsum(rng.standard_normal(len(t)) * model.drift / np.sqrt(model.rate))
    pressure += model.noise * rng.standard_normal(len(t))
    if model.resolution > 0.0:
        pressure = np.round(pressure / model.resolution) * model.resolution
    stamps, arrivals = to_ns(t, start_ns).tolist(), to_ns(t + model.transport, start_ns).tolist()
    variance = model.noise**2 if model.variance else None
    rows = zip(arrivals, stamps, pressure.tolist(), strict=True)
    return [Timed(arrival, PressureSample(stamp, value, variance)) for arrival, stamp, value in rows]


@dataclass(frozen=True)
class DepthGauge:
    """A pressure sensor of a vehicle in water whose surface lies where the motion begins, but for tide and weather."""

    rate: float = 5.0  # Hz
    density: float = 1025.0  # kg/m^3
    noise: float = 200.0  # Pa per sample
    offset_sd: float = 2000.0  # Pa, constant
    drift: float = 5.0  # Pa/sqrt(s), random walk
    transport: float = 0.0005  # s: arrival minus stamp


def depth_gauge(truth: Truth, model: DepthGauge, rng: np.random.Generator, start_ns: int) -> list[Timed]:
    """Absolute pressure of the water."""
    t = sensor_times(truth, model.rate)
    depth = truth.alt[0] - truth.at(t).alt
    pressure = height_pressure(0.0) + model.density * gravity(truth.lat[0], truth.alt[0]) * depth
    pressure += model.offset_sd * rng.standard_normal()
    pressure += np.cumsum(rng.standard_normal(len(t)) * model.drift / np.sqrt(model.rate))
    pressure += model.noise * rng.standard_normal(len(t))
    stamps, arrivals = to_ns(t, start_ns).tolist(), to_ns(t + model.transport, start_ns).tolist()
    rows = zip(arrivals, stamps, pressure.tolist(), strict=True)
    return [Timed(arrival, PressureSample(stamp, value)) for arrival, stamp, value in rows]


@dataclass(frozen=True)
class Pitot:
    """A pitot tube along the body's x axis: true airspeed with a scale error."""

    rate: float = 10.0  # Hz
    noise: float = 0.4  # m/s per sample
    scale_sd: float = 0.03
    transport: float = 0.0005  # s: arrival minus stamp


def airspeed(truth: Truth, model: Pitot, rng: np.random.Generator, start_ns: int) -> list[Timed]:
    """True airspeed, of the flow along the nose."""
    t = sensor_times(truth, model.rate)
    at = truth.at(t)
    flow = quat_rotate_many(quat_conjugate_many(at.q_nb), at.v_n - at.wind_n)[:, 0]
    measured = np.maximum(flow, 0.0) * (1.0 + model.scale_sd * rng.standard_normal())
    measured = measured + model.noise * rng.standard_normal(len(t))
    stamps, arrivals = to_ns(t, start_ns).tolist(), to_ns(t + model.transport, start_ns).tolist()
    rows = zip(arrivals, stamps, measured.tolist(), strict=True)
    return [Timed(arrival, Airspeed(stamp, value)) for arrival, stamp, value in rows]


@dataclass(frozen=True)
class Rangefinder:
    """A laser that looks down on ground that is flat but for ``roughness``."""

    rate: float = 20.0  # Hz
    noise: float = 0.03  # m per sample
    roughness: float = 0.05  # m
    farthest: float = 60.0  # m
    transport: float = 0.0005  # s: arrival minus stamp


def ground_range(truth: Truth, model: Rangefinder, rng: np.random.Generator, start_ns: int) -> list[Timed]:
    """Distance along the beam to the ground at the height where the motion begins; nothing beyond reach."""
    t = sensor_times(truth, model.rate)
    at = truth.at(t)
    down = -quat_rotate_many(at.q_nb, np.array([0.0, 0.0, -1.0]))[:, 2]
    height = at.alt - truth.alt[0] + 0.2 + model.roughness * rng.standard_normal(len(t))
    distance = height / np.maximum(down, 0.1) + model.noise * rng.standard_normal(len(t))
    seen = (distance > 0.05) & (distance < model.farthest) & (down > 0.5)
    stamps, arrivals = to_ns(t, start_ns), to_ns(t + model.transport, start_ns)
    rows = zip(arrivals[seen].tolist(), stamps[seen].tolist(), distance[seen].tolist(), strict=True)
    return [Timed(arrival, RangeToGround(stamp, value)) for arrival, stamp, value in rows]


@dataclass(frozen=True)
class Wheels:
    """Speed of the wheels along the body's x axis; what wheels cannot do, sideways and up, is stated as zero."""

    rate: float = 20.0  # Hz
    noise: float = 0.05  # m/s per sample
    scale_sd: float = 0.01  # tyres
    transport: float = 0.0005  # s: arrival minus stamp


def wheels(truth: Truth, model: Wheels, rng: np.random.Generator, start_ns: int) -> list[Timed]:
    """Velocity in the body, as the odometry of a car states it."""
    t = sensor_times(truth, model.rate)
    at = truth.at(t)
    speed = quat_rotate_many(quat_conjugate_many(at.q_nb), at.v_n)[:, 0] * (
        1.0 + model.scale_sd * rng.standard_normal()
    )
    speed = speed + model.noise * rng.standard_normal(len(t))
    cov = np.diag([model.noise**2, 0.1**2, 0.1**2])
    stamps, arrivals = to_ns(t, start_ns).tolist(), to_ns(t + model.transport, start_ns).tolist()
    rows = zip(arrivals, stamps, speed.tolist(), strict=True)
    return [Timed(arrival, BodyVelocity(stamp, (value, 0.0, 0.0), cov)) for arrival, stamp, value in rows]


def sensor_times(truth: Truth, rate: float) -> np.ndarray:
    """Times of a sensor of ``rate`` [Hz] within the recording; no two sensors of different rate start together."""
    return np.arange(0.5 / rate + truth.t[0], truth.t[-1], 1.0 / rate)


def to_ns(t: np.ndarray, start_ns: int) -> np.ndarray:
    """Stamps (N,) int64 of times [s] since ``start_ns``."""
    return start_ns + np.round(np.asarray(t) * 1e9).astype(np.int64)


def moved(truth: Truth, offset_n: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Latitude, longitude, height (N,) of the positions of ``truth`` moved by ``offset_n`` (N, 3) [m]."""
    R_M, R_N = radii_many(truth.lat)
    lat = truth.lat + offset_n[:, 1] / (R_M + truth.alt)
    lon = truth.lon + offset_n[:, 0] / ((R_N + truth.alt) * np.cos(truth.lat))
    return lat, lon, truth.alt + offset_n[:, 2]
