"""First navigation state and covariance: from a levelling at rest, or from one in motion."""

import math
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.alignment.levelling import inclined_attitudes, turned
from nav_pose_estimator.core.alignment.recent_rows import RecentRows, Row
from nav_pose_estimator.core.alignment.types import AlignmentSettings, Fix, KnownBiases, RestLevel
from nav_pose_estimator.core.earth.ellipsoid import earth_rate_n
from nav_pose_estimator.core.filter.layout import (
    ACCEL_BIAS,
    ALT,
    BASE_STATES,
    D_ACCEL_BIAS,
    D_GYRO_BIAS,
    DPOS,
    DVEL,
    GYRO_BIAS,
    IMU_ACCEL,
    IMU_COLUMNS,
    IMU_GYRO,
    IMU_T,
    LAT,
    NAV_SIZE,
    PHI,
    PREV_FORCE,
    PREV_RATE,
    QUAT,
    TIME,
    VEL,
)
from nav_pose_estimator.core.numerics.rotation import quat_to_matrix, wrap_angle

Array = NDArray[np.float64]

STEEPEST = 0.35
"""rad: with a larger apparent tilt, an acceleration above a third of gravity, the specific force shows no level."""
_SPACING_SD = 0.3  # standard deviation of a heading within the spacing of the hypotheses: about 1 / sqrt(12)
_FAR_SD = 1e3  # m: standard deviation of an unknown position
_REST_SD, _MOTION_SD = 0.5, 10.0  # m/s: standard deviation of a velocity that GNSS does not show, at rest and else
_VELOCITY_SD = 0.2  # m/s: smallest standard deviation of the first velocity
_SHORTEST, _LONGEST = 0.5, 1.2  # s: time between the two GNSS velocities whose difference gives an acceleration


def from_level(level: RestLevel, yaw: float, fix: Fix | None, row: Row, resting: bool) -> tuple[Array, Array]:
    """``nav`` (NAV_SIZE,) and P (15, 15) from a levelling at rest and a yaw [rad], at the time of ``level``.

    ``row`` is the IMU row at that time. Without ``fix`` the position is unknown.
    """
    nav, P = np.zeros(NAV_SIZE), level.P.copy()
    nav[QUAT : QUAT + 4] = turned(level.q, yaw)
    turn = np.eye(BASE_STATES)
    turn[PHI : PHI + 2, PHI : PHI + 2] = [[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]]
    P = turn @ P @ turn.T
    nav[GYRO_BIAS : GYRO_BIAS + 3] = level.rate
    if fix is not None:
        C = quat_to_matrix(nav[QUAT : QUAT + 4])
        nav[GYRO_BIAS : GYRO_BIAS + 3] -= C.T @ earth_rate_n(fix.position[0])
    _place(nav, P, fix, resting)
    _set_memory(nav, level.t, row)
    return nav, P


def in_motion(q: Array, tilt_sd: float, fix: Fix, biases: KnownBiases, row: Row, resting: bool) -> tuple[Array, Array]:
    """``nav`` and P at ``fix`` from an attitude ``q`` (4,) levelled in motion, whose tilt has ``tilt_sd`` [rad]."""
    nav, P = np.zeros(NAV_SIZE), np.zeros((BASE_STATES, BASE_STATES))
    nav[QUAT : QUAT + 4] = q
    nav[GYRO_BIAS : GYRO_BIAS + 3], nav[ACCEL_BIAS : ACCEL_BIAS + 3] = biases.gyro, biases.accel
    for start, sd in ((PHI, tilt_sd), (D_GYRO_BIAS, biases.gyro_sd), (D_ACCEL_BIAS, biases.accel_sd)):
        P[start : start + 3, start : start + 3] = sd**2 * np.eye(3)
    _place(nav, P, fix, resting)
    _set_memory(nav, fix.t, row)
    return nav, P


def inclined(recent: Iterable[Fix], rows: RecentRows, last: Fix, accel_bias: Sequence[float]) -> Array | None:
    """``q_nb`` (72, 4) at ``last`` of an accelerating vehicle, in equal turns about the specific force.

    The acceleration is the change of velocity between ``last`` and a fix of ``recent`` (oldest first) about a second
    before. None without such a fix, or where the specific force does not match the acceleration.
    """
    first = next((fix for fix in recent if _SHORTEST <= last.t - fix.t <= _LONGEST), None)
    if first is None or first.velocity is None or last.velocity is None:
        return None
    between = rows.between(first.t, last.t)
    if len(between) < 3 or between[0, IMU_T] > first.t + _SHORTEST:
        return None
    return inclined_attitudes(between, accel_bias, (last.velocity - first.velocity) / (last.t - first.t))


def heading_prior(settings: AlignmentSettings, yaw: float | None) -> Array | None:
    """Log of the prior weight (K,) of each heading hypothesis, given a magnetic ``yaw`` [rad]; None without one.

    The prior is a Gaussian about the magnetic yaw, mixed with a uniform one: the compass may be wrong by any angle.
    """
    if yaw is None:
        return None
    spacing = 2.0 * math.pi / settings.hypotheses
    sd = math.hypot(settings.mag_heading_sd, _SPACING_SD * spacing)
    away = np.array([wrap_angle(k * spacing - yaw) for k in range(settings.hypotheses)])
    likelihood = np.exp(-0.5 * (away / sd) ** 2)
    uniform = (1.0 - settings.mag_trust) / settings.hypotheses
    return np.log(settings.mag_trust * likelihood / likelihood.sum() + uniform)


def _place(nav: Array, P: Array, fix: Fix | None, resting: bool) -> None:
    """Set position and velocity from ``fix``; without one the position is unknown and the velocity about zero."""
    position_sd, velocity_sd = np.full(3, _FAR_SD), np.full(3, _REST_SD)
    if fix is not None:
        nav[LAT : ALT + 1] = fix.position
        position_sd = fix.position_sd
        if fix.velocity is not None:
            nav[VEL : VEL + 3] = fix.velocity
            velocity_sd = np.maximum(fix.velocity_sd, _VELOCITY_SD)
        elif not resting:
            velocity_sd = np.full(3, _MOTION_SD)
    for start, sd in ((DVEL, velocity_sd), (DPOS, position_sd)):
        P[start : start + 3, start : start + 3] = np.diag(sd**2)


def _set_memory(nav: Array, t: float, row: Row) -> None:
    """Set the time, and the rate and force of the last IMU row, which the strapdown integration starts from."""
    nav[TIME] = t
    nav[PREV_RATE : PREV_RATE + 3] = np.array(row[IMU_GYRO:IMU_ACCEL]) - nav[GYRO_BIAS : GYRO_BIAS + 3]
    nav[PREV_FORCE : PREV_FORCE + 3] = np.array(row[IMU_ACCEL:IMU_COLUMNS]) - nav[ACCEL_BIAS : ACCEL_BIAS + 3]
