"""The true motion of a vehicle, and the measurements of an ideal IMU.

A ``Motion`` is velocity, acceleration, attitude and angular rate as functions of time in the tangent frame t, with
East-North-Up axes at the origin and fixed to the Earth. In that frame the measurements of an ideal inertial sensor are

    f_b    = C_bt (dv_t/dt + 2 w_ie_t x v_t - g_t)
    w_ib_b = w_tb_b + C_bt w_ie_t

(Groves, Principles of GNSS, Inertial and Multisensor Integrated Navigation Systems, 2nd ed., section 5.3; without a
transport rate, because the frame does not rotate relative to the Earth). An IMU delivers their means over the sample
interval, which are computed by Gauss-Legendre quadrature with three nodes, with an error of order dt^6.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from nav_pose_estimator.core.earth.ellipsoid import (
    earth_rate_n,
    ecef_to_enu_matrix,
    enu_to_lla,
    gravity_many,
    lla_to_enu,
)
from nav_pose_estimator.core.numerics.rotation import (
    quat_conjugate_many,
    quat_from_euler_many,
    quat_multiply_many,
    quat_normalize_many,
    quat_rotate_many,
)

_CHUNK = 50_000
"""Number of intervals that are processed at once, which limits the memory for long motions."""


class Kinematics(NamedTuple):
    """State of motion at N times in the tangent frame t."""

    v_t: np.ndarray  # (N, 3) m/s
    a_t: np.ndarray  # (N, 3) dv_t/dt, m/s^2
    q_tb: np.ndarray  # (N, 4) scalar first
    w_tb_b: np.ndarray  # (N, 3) angular rate of b relative to t, in b, rad/s


Motion = Callable[[np.ndarray], Kinematics]


class Origin(NamedTuple):
    """Geodetic position where a motion begins."""

    lat: float  # rad
    lon: float  # rad
    alt: float  # m above the ellipsoid


@dataclass(frozen=True)
class Truth:
    """The motion at N equidistant times and the readings of an ideal IMU, one row each.

    ``gyro`` and ``accel`` are the means of w_ib_b and f_b over the interval that ends at ``t``, also for row 0, because
    the motion is known from one interval earlier. ``wind_n`` is the velocity of the air over ground.
    """

    t: np.ndarray  # (N,) s
    lat: np.ndarray  # (N,) rad
    lon: np.ndarray  # (N,) rad
    alt: np.ndarray  # (N,) m
    v_n: np.ndarray  # (N, 3) m/s, East-North-Up
    q_nb: np.ndarray  # (N, 4)
    wind_n: np.ndarray  # (N, 3) m/s
    gyro: np.ndarray  # (N, 3) rad/s
    accel: np.ndarray  # (N, 3) m/s^2

    def __len__(self) -> int:
        return len(self.t)

    @property
    def dt(self) -> float:
        """Sample interval [s]."""
        return (self.t[-1] - self.t[0]) / (len(self.t) - 1)

    def at(self, times: np.ndarray) -> "Truth":
        """The motion at other ``times`` within the recording, by linear interpolation (error below a dt^2 / 8)."""
        row = np.clip(np.searchsorted(self.t, times, side="right") - 1, 0, len(self) - 2)
        weight = (times - self.t[row]) / (self.t[row + 1] - self.t[row])
        columns = {}
        for item in fields(self):
            values = getattr(self, item.name)
            w = weight.reshape((-1,) + (1,) * (values.ndim - 1))
            after = values[row + 1]
            if item.name == "q_nb":  # q and -q are the same attitude: interpolate to the nearer one
                after = after * np.where(np.sum(values[row] * after, axis=1) < 0.0, -1.0, 1.0)[:, None]
            columns[item.name] = values[row] * (1.0 - w) + after * w
        columns["t"] = np.asarray(times, dtype=float)
        columns["q_nb"] = quat_normalize_many(columns["q_nb"])
        return Truth(**columns)

    def position_enu(self, origin: Origin) -> np.ndarray:
        """Position (N, 3) [m] in the tangent frame of ``origin``."""
        return lla_to_enu(self.lat, self.lon, self.alt, *origin)


def sample_times(duration: float, rate: float) -> np.ndarray:
    """IMU times 0, dt ... ``duration`` [s], preceded by the begin of the first interval at -dt = -1 / ``rate``."""
    return np.arange(-1, round(duration * rate) + 1) / rate


def truth_of_motion(motion: Motion, times: np.ndarray, origin: Origin, wind_n: np.ndarray | None = None) -> Truth:
    """Integrate ``motion`` over equidistant ``times`` [s]; the interval of row 0 begins at the first one.

    The position at the first time is ``origin``. ``wind_n`` (len(times), 3) [m/s] is only copied.
    """
    parts = []
    p_start = np.zeros(3)
    for first in range(0, len(times) - 1, _CHUNK):
        part, p_start = _integrate(motion, times[first : first + _CHUNK + 1], origin, p_start)
        parts.append(part)
    columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    if wind_n is None:
        wind_n = np.zeros((len(times), 3))
    return Truth(t=times[1:], wind_n=wind_n[1:], **columns)


_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(3)


def _integrate(
    motion: Motion, edges: np.ndarray, origin: Origin, p_start: np.ndarray
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Columns of ``Truth`` for the intervals between ``edges``, and the position (3,) in t at the last edge."""
    half = 0.5 * np.diff(edges)[:, None]
    inside = motion((0.5 * (edges[:-1] + edges[1:])[:, None] + half * _NODES).ravel())
    p_t = np.concatenate([p_start[None], p_start + np.cumsum(2.0 * half * _mean(inside.v_t), axis=0)])
    lat, lon, alt = enu_to_lla(p_t, *origin)

    g_t = _gravity_t(lat, lon, alt, origin)
    share = 0.5 * (1.0 + _NODES)[:, None]
    g_inside = (g_t[:-1, None] * (1.0 - share) + g_t[1:, None] * share).reshape(-1, 3)
    w_ie_t = earth_rate_n(origin.lat)
    q_bt = quat_conjugate_many(inside.q_tb)
    force = quat_rotate_many(q_bt, inside.a_t + 2.0 * np.cross(w_ie_t, inside.v_t) - g_inside)
    rate = inside.w_tb_b + quat_rotate_many(q_bt, w_ie_t)

    ends = motion(edges[1:])
    q_nt = _level_turn(lat[1:], lon[1:], origin)
    columns = {
        "lat": lat[1:],
        "lon": lon[1:],
        "alt": alt[1:],
        "v_n": quat_rotate_many(q_nt, ends.v_t),
        "q_nb": quat_multiply_many(q_nt, ends.q_tb),
        "gyro": _mean(rate),
        "accel": _mean(force),
    }
    return columns, p_t[-1]


def _mean(values: np.ndarray) -> np.ndarray:
    """Means over the intervals (N, 3) of values at their quadrature nodes (3 N, 3)."""
    return np.einsum("j,njk->nk", 0.5 * _WEIGHTS, values.reshape(-1, 3, 3))


def _gravity_t(lat: np.ndarray, lon: np.ndarray, alt: np.ndarray, origin: Origin) -> np.ndarray:
    """Gravity (N, 3) [m/s^2] in the tangent frame, with the direction of the local vertical."""
    up_e = np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)], axis=-1)
    return -gravity_many(lat, alt)[:, None] * (up_e @ ecef_to_enu_matrix(origin.lat, origin.lon).T)


def _level_turn(lat: np.ndarray, lon: np.ndarray, origin: Origin) -> np.ndarray:
    """Quaternions q_nt (N, 4) from the tangent frame of ``origin`` to the local level frames."""
    return quat_multiply_many(quat_conjugate_many(_q_en(lat, lon)), _q_en(origin.lat, origin.lon))


def _q_en(lat: np.ndarray | float, lon: np.ndarray | float) -> np.ndarray:
    """Quaternion (..., 4) from the local level frame to the Earth-fixed frame."""
    about_pole = quat_from_euler_many(0.0, 0.0, np.asarray(lon) + 0.5 * np.pi)
    return quat_multiply_many(about_pole, quat_from_euler_many(0.5 * np.pi - np.asarray(lat), 0.0, 0.0))
