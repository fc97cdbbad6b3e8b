"""Motions given by formulas, and the IMU that would have flown them: the exact inverse of navigation.

Latitude, longitude, height and the Euler angles are lines plus sums of sines; velocity, acceleration and rates are
their exact derivatives. IMU values are means over the intervals by Gauss-Legendre quadrature, or instantaneous.
"""

from dataclasses import dataclass, field

import numpy as np

from nav_pose_estimator.core.earth.ellipsoid import (
    E2,
    OMEGA,
    gravity_many,
    radii_many,
)
from nav_pose_estimator.core.filter.layout import (
    ALT,
    BASE_STATES,
    DPOS,
    DVEL,
    IMU_COLUMNS,
    LAT,
    LON,
    NAV_SIZE,
    PHI,
    PREV_ACCEL,
    PREV_FORCE,
    PREV_RATE,
    QUAT,
    TIME,
    VEL,
)
from nav_pose_estimator.core.numerics.rotation import (
    quat_conjugate_many,
    quat_from_euler_many,
    quat_multiply_many,
    quat_rotate_many,
)
from rotations import rotation_vectors

NODES, WEIGHTS = np.polynomial.legendre.leggauss(5)


def earth_rate(lat: np.ndarray) -> np.ndarray:
    """w_ie_n (..., 3) [rad/s]: rotation of the Earth resolved in n."""
    return np.stack((np.zeros_like(lat), OMEGA * np.cos(lat), OMEGA * np.sin(lat)), axis=-1)


def transport_rate(lat: np.ndarray, h: np.ndarray, v_n: np.ndarray) -> np.ndarray:
    """w_en_n (..., 3) [rad/s]: turn of a level frame that moves over the Earth with velocity ``v_n`` (..., 3)."""
    R_M, R_N = radii_many(lat)
    east = v_n[..., 0] / (R_N + h)
    return np.stack((-v_n[..., 1] / (R_M + h), east, east * np.tan(lat)), axis=-1)


@dataclass
class Signal:
    """``start + slope t + sum of amplitude sin(rate t + phase)`` with its derivatives."""

    start: float = 0.0
    slope: float = 0.0
    waves: list[tuple[float, float, float]] = field(default_factory=list)

    def __call__(self, t: np.ndarray, derivative: int = 0) -> np.ndarray:
        value = (self.start + self.slope * t, np.full_like(t, self.slope), np.zeros_like(t))[derivative]
        for amplitude, rate, phase in self.waves:
            value = value + amplitude * rate**derivative * np.sin(rate * t + phase + derivative * np.pi / 2)
        return value


@dataclass
class Motion:
    """A formula for each of the six coordinates."""

    lat: Signal
    lon: Signal
    alt: Signal
    roll: Signal = field(default_factory=Signal)
    pitch: Signal = field(default_factory=Signal)
    yaw: Signal = field(default_factory=Signal)

    def velocity(self, t: np.ndarray) -> np.ndarray:
        lat, h = self.lat(t), self.alt(t)
        R_M, R_N = radii_many(lat)
        return np.stack((self.lon(t, 1) * (R_N + h) * np.cos(lat), self.lat(t, 1) * (R_M + h), self.alt(t, 1)), -1)

    def acceleration(self, t: np.ndarray) -> np.ndarray:
        """Derivative of the components of ``velocity``."""
        lat, h = self.lat(t), self.alt(t)
        lat_dot, lon_dot, h_dot = self.lat(t, 1), self.lon(t, 1), self.alt(t, 1)
        s, c = np.sin(lat), np.cos(lat)
        R_M, R_N = radii_many(lat)
        R_M_dot = 3.0 * R_M * E2 * s * c / (1.0 - E2 * s * s) * lat_dot
        east = self.lon(t, 2) * (R_N + h) * c + lon_dot * (h_dot * c - (R_M + h) * s * lat_dot)
        north = self.lat(t, 2) * (R_M + h) + lat_dot * (R_M_dot + h_dot)
        return np.stack((east, north, self.alt(t, 2)), -1)

    def q_nb(self, t: np.ndarray) -> np.ndarray:
        return quat_from_euler_many(self.roll(t), self.pitch(t), self.yaw(t))

    def rate_nb_b(self, t: np.ndarray) -> np.ndarray:
        roll, pitch = self.roll(t), self.pitch(t)
        d_roll, d_pitch, d_yaw = self.roll(t, 1), self.pitch(t, 1), self.yaw(t, 1)
        sr, cr, sp, cp = np.sin(roll), np.cos(roll), np.sin(pitch), np.cos(pitch)
        return np.stack((d_roll - d_yaw * sp, d_pitch * cr + d_yaw * cp * sr, -d_pitch * sr + d_yaw * cp * cr), -1)

    def imu(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Instantaneous angular rate w_ib_b and specific force f_b (..., 3)."""
        lat, h, v = self.lat(t), self.alt(t), self.velocity(t)
        w_ie, w_en = earth_rate(lat), transport_rate(lat, h, v)
        f_n = self.acceleration(t) + np.cross(2.0 * w_ie + w_en, v)
        f_n[..., 2] += gravity_many(lat, h)
        q_bn = quat_conjugate_many(self.q_nb(t))
        return self.rate_nb_b(t) + quat_rotate_many(q_bn, w_ie + w_en), quat_rotate_many(q_bn, f_n)

    def imu_rows(self, times: np.ndarray, point_sampled: bool = False) -> np.ndarray:
        """IMU rows (N, 7) at ``times[1:]``: means since the time before, or instantaneous values."""
        rows = np.empty((len(times) - 1, IMU_COLUMNS))
        rows[:, 0] = times[1:]
        if point_sampled:
            rows[:, 1:4], rows[:, 4:] = self.imu(times[1:])
            return rows
        middle, half = 0.5 * (times[1:] + times[:-1]), 0.5 * np.diff(times)
        rate, force = self.imu(middle[:, None] + half[:, None] * NODES)
        rows[:, 1:4] = np.einsum("nkj,k->nj", rate, 0.5 * WEIGHTS)
        rows[:, 4:] = np.einsum("nkj,k->nj", force, 0.5 * WEIGHTS)
        return rows

    def nav(self, t: float) -> np.ndarray:
        """The nominal state at ``t`` without error, its memory filled."""
        at = np.array([float(t)])
        nav = np.zeros(NAV_SIZE)
        nav[TIME] = t
        nav[[LAT, LON, ALT]] = self.lat(at)[0], self.lon(at)[0], self.alt(at)[0]
        nav[VEL : VEL + 3] = self.velocity(at)[0]
        nav[QUAT : QUAT + 4] = self.q_nb(at)[0]
        nav[PREV_ACCEL : PREV_ACCEL + 3] = self.acceleration(at)[0]
        rate, force = self.imu(at)
        nav[PREV_RATE : PREV_RATE + 3], nav[PREV_FORCE : PREV_FORCE + 3] = rate[0], force[0]
        return nav

    def error(self, t, lat, lon, alt, v_n, q_nb) -> np.ndarray:
        """Errors (..., 9) of an estimate: misalignment [rad], velocity [m/s], position East, North, Up [m]."""
        t = np.asarray(t, dtype=float)
        true_lat, true_alt = self.lat(t), self.alt(t)
        R_M, R_N = radii_many(true_lat)
        e = np.empty((*t.shape, 9))
        e[..., PHI : PHI + 3] = rotation_vectors(quat_multiply_many(self.q_nb(t), quat_conjugate_many(q_nb)))
        e[..., DVEL : DVEL + 3] = v_n - self.velocity(t)
        e[..., DPOS] = (lon - self.lon(t)) * (R_N + true_alt) * np.cos(true_lat)
        e[..., DPOS + 1] = (lat - true_lat) * (R_M + true_alt)
        e[..., DPOS + 2] = alt - true_alt
        return e

    def error_of(self, nav: np.ndarray) -> np.ndarray:
        """``error`` (9,) of a nominal state."""
        return self.error(nav[TIME], nav[LAT], nav[LON], nav[ALT], nav[VEL : VEL + 3], nav[QUAT : QUAT + 4])


def times_of(duration: float, rate: float) -> np.ndarray:
    """0 to ``duration`` [s] at ``rate`` [Hz]."""
    return np.arange(round(duration * rate) + 1) / rate


def metres(lat: float = 0.8, alt: float = 100.0) -> tuple[float, float]:
    """Radians of latitude and of longitude per metre."""
    R_M, R_N = radii_many(lat)
    return 1.0 / (R_M + alt), 1.0 / ((R_N + alt) * np.cos(lat))


def aerobatics() -> Motion:
    """Up to 4 g and 5 rad/s at once on all axes; comes back to its start every 60 s."""
    north, east = metres()
    w = 2.0 * np.pi
    return Motion(
        lat=Signal(0.8, waves=[(40.0 * north, w / 7.5, 0.3), (1.5 * north, w / 1.5, 1.0)]),
        lon=Signal(0.2, waves=[(40.0 * east, w / 10.0, 1.2), (1.5 * east, w / 1.2, 2.0)]),
        alt=Signal(100.0, waves=[(15.0, w / 6.0, 0.0)]),
        roll=Signal(waves=[(0.8, w / 2.0, 0.0), (0.1, w / 0.4, 0.5)]),
        pitch=Signal(0.1, waves=[(0.6, w / 3.0, 1.0)]),
        yaw=Signal(0.5, slope=w / 6.0, waves=[(0.5, w / 4.0, 2.0)]),
    )


def survey() -> Motion:
    """A lively flight of a drone: turns, accelerations of 2 m/s^2 and tilts that make all fifteen states observable."""
    north, east = metres()
    w = 2.0 * np.pi
    return Motion(
        lat=Signal(0.8, slope=3.0 * north, waves=[(60.0 * north, w / 40.0, 0.0), (5.0 * north, w / 9.0, 0.0)]),
        lon=Signal(0.2, waves=[(60.0 * east, w / 32.0, 1.0), (5.0 * east, w / 11.0, 0.0)]),
        alt=Signal(100.0, waves=[(6.0, w / 20.0, 0.0)]),
        roll=Signal(waves=[(0.25, w / 9.0, 0.4)]),
        pitch=Signal(waves=[(0.25, w / 11.0, 0.0)]),
        yaw=Signal(0.5, waves=[(1.5, w / 25.0, 0.0)]),
    )


def rest(lat: float = 0.8) -> Motion:
    """Standing on the rotating Earth, tilted and turned."""
    return Motion(Signal(lat), Signal(0.2), Signal(100.0), Signal(0.1), Signal(-0.2), Signal(0.7))


def zero_covariance() -> np.ndarray:
    """P (15, 15) for tests that do not look at it."""
    return np.zeros((BASE_STATES, BASE_STATES))
