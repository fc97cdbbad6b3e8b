"""Levelling and magnetic heading: attitude from gravity and the Earth's magnetic field.

Sources: Groves, Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems, 2nd ed., section 5.6.2
(levelling), 6.1.1 (magnetic heading); International Geomagnetic Reference Field, 13th generation (the dipole's axis).
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.filter.layout import BASE_STATES, D_ACCEL_BIAS, D_GYRO_BIAS, PHI
from nav_pose_estimator.core.numerics.rotation import (
    euler_from_quat,
    quat_from_euler,
    quat_from_rotvec,
    quat_multiply,
    quat_rotate,
    quat_to_matrix,
    wrap_angle,
)
from nav_pose_estimator.core.numerics.units import STANDARD_GRAVITY

Array = NDArray[np.float64]
Vector = Sequence[float] | Array

_GEOMAGNETIC_POLE = math.radians(80.65), math.radians(-72.68)  # latitude, longitude of the dipole's axis, 2020
_FIELD_STRENGTH = 18e-6, 75e-6  # T: 22 to 67 on the Earth's surface, and some error of calibration
_UNITS = {"millitesla": 1e-3, "gauss": 1e-4, "microtesla": 1e-6, "milligauss": 1e-7, "nanotesla": 1e-9}  # in T
_SAME_FORCE = 0.25  # relative difference of IMU and GNSS force that is accepted: GNSS velocities lag behind the IMU
_TURN = math.radians(5.0)  # step of ``inclined_attitudes`` about the specific force
_OUTSIDE_TILT_SD = 0.03  # rad: floor of the tilt deviation of another estimator, whose own is optimistic in motion
_OUTSIDE_MEMORY = 2.0  # s for which outside attitudes are kept: a fix may arrive that late
_OUTSIDE_AGE = 0.05  # s: largest time difference between an outside attitude and the instant that asks for it
LARGEST_FIELD = 1e6
"""A published field beyond this, in any unit, is not used: its square would overflow in a filter."""
_COMPASS_WINDOW = 1.0  # s of magnetometer data that are averaged for one heading
_DIP_TOLERANCE = math.radians(25.0)  # the dip of the dipole itself differs from the true one by up to 20 deg


def level_attitude(force: Vector) -> Array:
    """``q_nb`` (4,) at yaw zero that turns the mean specific force ``force`` (3,) in b to Up."""
    x, y, z = (float(f) for f in force)
    return quat_from_euler(math.atan2(y, z), math.atan2(-x, math.hypot(y, z)), 0.0)


def turned(q_nb: Array, yaw: float) -> Array:
    """``q_nb`` turned by ``yaw`` [rad] about Up, counter-clockwise."""
    return quat_multiply(quat_from_rotvec(np.array([0.0, 0.0, yaw])), q_nb)


def level_covariance(q_nb: Array, rate_sd: float, gyro_bias_sd: float, accel_bias_sd: float, seconds: float) -> Array:
    """Covariance (15, 15) of a levelling over ``seconds`` at rest; rows of velocity, position and heading are zero.

    Levelling turns an accelerometer bias b into a tilt: ``C_hat f`` is vertical, so phi = (-(C b)_y, (C b)_x) / g.
    ``rate_sd`` is the standard deviation of the rate's mean over one second [rad/s], ``gyro_bias_sd`` that of the
    gyroscope bias after a long rest [rad/s].
    """
    C = quat_to_matrix(q_nb)
    tilt = np.zeros((3, 3))
    tilt[0], tilt[1] = -C[1] / STANDARD_GRAVITY, C[0] / STANDARD_GRAVITY
    P = np.zeros((BASE_STATES, BASE_STATES))
    phi, gyro, accel = (slice(i, i + 3) for i in (PHI, D_GYRO_BIAS, D_ACCEL_BIAS))
    P[accel, accel] = accel_bias_sd**2 * np.eye(3)
    P[phi, accel] = tilt * accel_bias_sd**2
    P[accel, phi] = P[phi, accel].T
    P[phi, phi] = tilt @ tilt.T * accel_bias_sd**2 + np.diag([1e-6, 1e-6, 0.0])
    P[gyro, gyro] = (gyro_bias_sd**2 + rate_sd**2 / max(seconds, 1.0)) * np.eye(3)
    return P


def level_in_motion(rows: Array) -> Array:
    """``q_nb`` (4,) at yaw zero and at the last of the IMU ``rows`` (N, 7), for a moving vehicle.

    The force is averaged in a frame that the gyroscope keeps fixed, so that turns do not blur it. The mean
    acceleration over the rows remains as a tilt error: 6 deg for 1 m/s^2.
    """
    return level_attitude(summed_force(rows))


def summed_force(rows: Array) -> Array:
    """Sum (3,) of the specific forces of IMU ``rows`` (N, 7), turned by the gyroscope into the axes of the last row."""
    q = np.array([1.0, 0.0, 0.0, 0.0])  # attitude of each row in the frame of the last one
    total = rows[-1, 4:7].copy()
    for i in range(len(rows) - 1, 0, -1):
        step = quat_from_rotvec(-rows[i, 1:4] * (rows[i, 0] - rows[i - 1, 0]))
        q = quat_multiply(q, step)
        total += quat_rotate(q, rows[i - 1, 4:7])
    return total


def unlevel(rows: Array, accel_bias: Vector) -> float:
    """Angle [rad] between the vertical and the mean force of IMU ``rows`` (N, 7), inferred from the force's norm.

    A horizontal acceleration a is perpendicular to gravity: |f|^2 = g^2 + a^2, and the force leans by atan(a / g).
    """
    excess = float(np.linalg.norm(summed_force(rows) / len(rows) - np.asarray(accel_bias))) / STANDARD_GRAVITY
    return math.acos(1.0 / excess) if excess > 1.0 else 0.0


def inclined_attitudes(rows: Array, accel_bias: Vector, acceleration: Array) -> Array | None:
    """``q_nb`` (72, 4) at the last of the IMU ``rows`` (N, 7), in steps of 5 deg about the specific force.

    An accelerating vehicle cannot be levelled by its specific force alone. With its mean ``acceleration`` (3,) ENU
    [m/s^2] from GNSS the force is known in n as well: acceleration less gravity. That fixes the attitude up to a
    rotation about the force. None where the two forces differ too much in magnitude.
    """
    force_b = summed_force(rows) / len(rows) - np.asarray(accel_bias)
    force_n = acceleration + np.array([0.0, 0.0, STANDARD_GRAVITY])
    size = float(np.linalg.norm(force_n))
    if abs(float(np.linalg.norm(force_b)) - size) > _SAME_FORCE * max(size, STANDARD_GRAVITY):
        return None
    horizontal = math.hypot(force_n[0], force_n[1])
    axis = np.array([-force_n[1], force_n[0], 0.0]) / max(horizontal, 1e-9)
    incline = quat_from_rotvec(axis * math.atan2(horizontal, force_n[2]))
    level = level_attitude(force_b)
    return np.array([quat_multiply(incline, turned(level, k * _TURN)) for k in range(round(2.0 * math.pi / _TURN))])


@dataclass(init=False, eq=False, slots=True)
class OutsideLevels:
    """Attitudes of another estimator with the deviation of their tilt, kept for as long as a fix may be late."""

    _levels: deque[tuple[float, tuple[float, ...], float]]  # plain numbers: shared by copies

    def __init__(self) -> None:
        self._levels = deque()

    def add(self, t: float, q_nb: Vector, tilt_sd: float) -> None:
        """Add an attitude (4,) at ``t`` [s] with the tilt deviation ``tilt_sd`` [rad]; an invalid one is ignored."""
        q = np.array(q_nb, dtype=float)
        norm = float(np.linalg.norm(q))
        if not (0.9 < norm < 1.1 and 0.0 <= tilt_sd < math.inf):
            return
        q /= norm
        yaw = euler_from_quat(q)[2]
        self._levels.append((t, tuple(turned(q, -yaw).tolist()), max(tilt_sd, _OUTSIDE_TILT_SD)))
        while self._levels[0][0] < t - _OUTSIDE_MEMORY:
            self._levels.popleft()

    def near(self, t: float, tilt_sd: float) -> tuple[Array, float] | None:
        """(``q_nb`` at yaw zero, tilt deviation [rad]) nearest to ``t`` [s]; None unless better than ``tilt_sd``."""
        known = [level for level in self._levels if abs(level[0] - t) < _OUTSIDE_AGE and level[2] < tilt_sd]
        if not known:
            return None
        _, q_nb, tilt_sd = min(known, key=lambda level: abs(level[0] - t))
        return np.array(q_nb), tilt_sd


def magnetic_yaw(q_level: Array, field: Vector, declination: float) -> float:
    """Yaw [rad], counter-clockwise from East, that turns the field (3,) in b into the magnetic meridian.

    ``q_level`` is the attitude at yaw zero, ``declination`` [rad] positive when magnetic North lies East of North.
    """
    x, y, _ = quat_rotate(q_level, np.asarray(field, dtype=float))
    return wrap_angle(0.5 * math.pi - declination - math.atan2(y, x))


def field_doubt(q_level: Array, field: Vector, lat: float | None, lon: float | None) -> str:
    """Why the field (3,) [T] in b cannot be the Earth's, one clause for the user; empty when it is plausible.

    Its strength must occur on Earth. Where the position is known, its dip must be near that of the geomagnetic dipole,
    tan(dip) = 2 tan(geomagnetic latitude).
    """
    strength = math.hypot(*field)
    if not _FIELD_STRENGTH[0] <= strength <= _FIELD_STRENGTH[1]:
        unit = likely_unit(strength)
        hint = f" (is it in {unit}? tesla is expected)" if unit else ""
        return f"a magnetic field of {strength * 1e6:.3g} uT, which is not the Earth's{hint}"
    x, y, z = quat_rotate(q_level, np.asarray(field, dtype=float))
    if math.hypot(x, y) < 0.05 * strength:
        return "a vertical magnetic field"
    if lat is None or lon is None:
        return ""
    dip = math.atan2(-z, math.hypot(x, y))
    expected = dipole_dip(lat, lon)
    if abs(dip - expected) <= _DIP_TOLERANCE:
        return ""
    return f"a magnetic dip of {math.degrees(dip):.0f} deg, where about {math.degrees(expected):.0f} deg are expected"


def likely_unit(strength: float) -> str:
    """The unit in which ``strength`` would be that of the Earth's field; empty where no unit fits."""
    fits = (name for name, tesla in _UNITS.items() if _FIELD_STRENGTH[0] <= strength * tesla <= _FIELD_STRENGTH[1])
    return next(fits, "")


def dipole_dip(lat: float, lon: float) -> float:
    """Dip of the geomagnetic dipole [rad], positive down; the true field differs by up to 20 deg."""
    pole_lat, pole_lon = _GEOMAGNETIC_POLE
    sine = math.sin(lat) * math.sin(pole_lat) + math.cos(lat) * math.cos(pole_lat) * math.cos(lon - pole_lon)
    return math.atan2(2.0 * sine, math.sqrt(max(1.0 - sine * sine, 0.0)))


@dataclass(init=False, eq=False, slots=True)
class Compass:
    """Magnetic heading from the mean field of the last second, with a check of its plausibility."""

    declination: float
    doubt: str
    """Why the last ``yaw`` was None, one clause."""
    _fields: deque[tuple[float, Vector]]

    def __init__(self, declination: float) -> None:
        self.declination = declination
        self._fields = deque()
        self.doubt = "no magnetometer"

    def add(self, t: float, field: Vector) -> None:
        """Add a field (3,) [T] in b at ``t`` [s]; a field with a missing or absurd axis is ignored."""
        if not all(abs(part) <= LARGEST_FIELD for part in field):  # false for NaN
            return
        self._fields.append((t, field))
        while self._fields[0][0] < t - _COMPASS_WINDOW:
            self._fields.popleft()

    def yaw(
        self, now: float, q_level: Array, lat: float | None, lon: float | None, window: float = _COMPASS_WINDOW
    ) -> float | None:
        """Yaw [rad] of a body whose attitude at yaw zero is ``q_level`` (4,); None when the field is implausible.

        The field is averaged within ``window`` [s] of ``now`` [s].
        """
        field = self.field(now, window)
        if field is None:
            self.doubt = "no magnetometer"
            return None
        self.doubt = field_doubt(q_level, field, lat, lon)
        return None if self.doubt else magnetic_yaw(q_level, field, self.declination)

    def field(self, now: float, window: float) -> Array | None:
        """Mean field (3,) [T] in b within ``window`` [s] of ``now`` [s]; None without data."""
        recent = [field for t, field in self._fields if abs(t - now) <= window]
        return np.mean(np.array(recent, dtype=float), axis=0) if recent else None
