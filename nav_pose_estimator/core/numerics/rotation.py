"""Rotations: unit quaternions (Hamilton, scalar first), rotation vectors, matrices and Euler angles.

The plain names are kernels for one rotation, callable from Python and from other kernels. The names that end in
``_many`` are their numpy forms for arrays with leading dimensions. ``q_nb`` and ``C_nb`` transform vectors from b to n:
``v_n = C_nb v_b``.

Euler angles follow REP-103 (FLU body, ENU navigation frame): yaw about Up, counter-clockwise from East, then pitch,
then roll. They are used for display and initial attitudes, never for integration.

Source: J. Sola, "Quaternion kinematics for the error-state Kalman filter" (2017), chapters 1 and 2.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nav_pose_estimator.core.numerics.jit import kernel
from nav_pose_estimator.core.numerics.vectors import q_columns, q_exp, q_multiply, q_rotate

Array = NDArray[np.float64]


# --- kernels for one rotation --------------------------------------------------------------------------------------
@kernel
def quat_multiply(a, b):
    """Hamilton product (4,): the rotation ``b`` followed by the rotation ``a``."""
    return np.array(q_multiply(a, b))


@kernel
def quat_conjugate(q):
    """The inverse (4,) of a unit quaternion."""
    return np.array((q[0], -q[1], -q[2], -q[3]))


@kernel
def quat_normalize(q):
    """``q`` (4,) at unit length; the identity if its length is zero or not finite."""
    length = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    if not (0.0 < length < math.inf):
        return np.array((1.0, 0.0, 0.0, 0.0))
    return np.array((q[0] / length, q[1] / length, q[2] / length, q[3] / length))


@kernel
def quat_from_rotvec(v):
    """Quaternion (4,) of the rotation vector ``v`` (3,) [rad]."""
    return np.array(q_exp(v))


@kernel
def quat_to_matrix(q):
    """Rotation matrix C (3, 3) of the unit quaternion ``q``."""
    columns = q_columns(q)
    C = np.empty((3, 3))
    for j in range(3):
        column = columns[j]
        for i in range(3):
            C[i, j] = column[i]
    return C


@kernel
def quat_rotate(q, v):
    """``v`` (3,) rotated by the unit quaternion ``q``: with ``q_nb``, from b to n."""
    return np.array(q_rotate(q, v))


@kernel
def euler_from_quat(q):
    """(roll, pitch, yaw) [rad] of the unit quaternion ``q_nb``; at pitch +-90 deg, roll is set to 0."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    sin_pitch = 2.0 * (w * y - x * z)
    cos_pitch = math.hypot(w * w + x * x - y * y - z * z, 2.0 * (x * y + w * z))
    pitch = math.atan2(sin_pitch, cos_pitch)
    if cos_pitch < 1e-9:
        return 0.0, pitch, math.atan2(2.0 * (w * z - x * y), w * w - x * x + y * y - z * z)
    roll = math.atan2(2.0 * (y * z + w * x), w * w - x * x - y * y + z * z)
    yaw = math.atan2(2.0 * (x * y + w * z), w * w + x * x - y * y - z * z)
    return roll, pitch, yaw


@kernel
def yaw_of(q):
    """Yaw [rad] of quaternion ``q`` (4,), as of ``euler_from_quat``."""
    return euler_from_quat(q)[2]


@kernel
def quat_from_euler(roll, pitch, yaw):
    """Unit quaternion ``q_nb`` (4,) of roll, pitch, yaw [rad]."""
    cr, sr = math.cos(0.5 * roll), math.sin(0.5 * roll)
    cp, sp = math.cos(0.5 * pitch), math.sin(0.5 * pitch)
    cy, sy = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
    return np.array(
        (
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        )
    )


@kernel
def skew(v):
    """The matrix [v x] (3, 3): ``skew(v) @ u = v x u``."""
    return np.array(((0.0, -v[2], v[1]), (v[2], 0.0, -v[0]), (-v[1], v[0], 0.0)))


@kernel
def wrap_angle(a):
    """The angle ``a`` [rad] wrapped to [-pi, pi); NaN where it is not finite."""
    if not math.isfinite(a):
        return math.nan  # without numba, math.floor raises
    return a - 2.0 * math.pi * math.floor((a + math.pi) / (2.0 * math.pi))


# --- numpy forms for arrays ----------------------------------------------------------------------------------------
def quat_multiply_many(a: ArrayLike, b: ArrayLike) -> Array:
    """Hamilton products of ``a`` (..., 4) and ``b`` (..., 4)."""
    aw, ax, ay, az = np.moveaxis(np.asarray(a, dtype=float), -1, 0)
    bw, bx, by, bz = np.moveaxis(np.asarray(b, dtype=float), -1, 0)
    return np.stack(
        (
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ),
        axis=-1,
    )


def quat_conjugate_many(q: ArrayLike) -> Array:
    """Inverses of unit quaternions ``q`` (..., 4)."""
    return np.asarray(q, dtype=float) * (1.0, -1.0, -1.0, -1.0)


def quat_normalize_many(q: ArrayLike) -> Array:
    """``q`` (..., 4) at unit length; the identity where its length is zero or not finite."""
    q = np.asarray(q, dtype=float)
    length = np.linalg.norm(q, axis=-1, keepdims=True)
    usable = (length > 0.0) & np.isfinite(length)
    return np.where(usable, q / np.where(usable, length, 1.0), (1.0, 0.0, 0.0, 0.0))


def quat_from_rotvec_many(v: ArrayLike) -> Array:
    """Quaternions (..., 4) of the rotation vectors ``v`` (..., 3) [rad]."""
    v = np.asarray(v, dtype=float)
    half_angle = 0.5 * np.linalg.norm(v, axis=-1, keepdims=True)
    return np.concatenate((np.cos(half_angle), 0.5 * np.sinc(half_angle / np.pi) * v), axis=-1)


def quat_rotate_many(q: ArrayLike, v: ArrayLike) -> Array:
    """Vectors ``v`` (..., 3) rotated by the unit quaternions ``q`` (..., 4); leading dimensions are broadcast."""
    q, v = np.asarray(q, dtype=float), np.asarray(v, dtype=float)
    u = q[..., 1:]
    t = 2.0 * np.cross(u, v)
    return v + q[..., :1] * t + np.cross(u, t)


def euler_from_quat_many(q: ArrayLike) -> Array:
    """(roll, pitch, yaw) (..., 3) [rad] of unit quaternions ``q`` (..., 4); at pitch +-90 deg, roll is set to 0."""
    w, x, y, z = np.moveaxis(np.asarray(q, dtype=float), -1, 0)
    c00, c10 = w * w + x * x - y * y - z * z, 2.0 * (x * y + w * z)
    cos_pitch = np.hypot(c00, c10)
    steep = cos_pitch < 1e-9
    roll = np.where(steep, 0.0, np.arctan2(2.0 * (y * z + w * x), w * w - x * x - y * y + z * z))
    yaw = np.where(steep, np.arctan2(2.0 * (w * z - x * y), w * w - x * x + y * y - z * z), np.arctan2(c10, c00))
    return np.stack((roll, np.arctan2(2.0 * (w * y - x * z), cos_pitch), yaw), axis=-1)


def quat_from_euler_many(roll: ArrayLike, pitch: ArrayLike, yaw: ArrayLike) -> Array:
    """Unit quaternions (..., 4) of roll, pitch, yaw (...) [rad], broadcast against each other."""
    roll, pitch, yaw = np.broadcast_arrays(roll, pitch, yaw)
    cr, sr = np.cos(0.5 * roll), np.sin(0.5 * roll)
    cp, sp = np.cos(0.5 * pitch), np.sin(0.5 * pitch)
    cy, sy = np.cos(0.5 * yaw), np.sin(0.5 * yaw)
    return np.stack(
        (
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ),
        axis=-1,
    )


def wrap_angle_many(a: ArrayLike) -> Array:
    """Angles ``a`` (...) [rad] wrapped to [-pi, pi)."""
    a = np.asarray(a, dtype=float)
    return a - 2.0 * np.pi * np.floor((a + np.pi) / (2.0 * np.pi))


def rotvec_from_quat_many(q: ArrayLike) -> Array:
    """Rotation vectors (..., 3) [rad] of the unit quaternions ``q`` (..., 4), of length at most pi."""
    q = np.asarray(q, dtype=float)
    q = np.where(q[..., :1] < 0.0, -q, q)
    length = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    small = length < 1e-150
    factor = np.where(small, 2.0, 2.0 * np.arctan2(length, q[..., :1]) / np.where(small, 1.0, length))
    return factor * q[..., 1:]
