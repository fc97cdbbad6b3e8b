"""Arithmetic of 3-vectors and quaternions as tuples of floats, for use inside kernels.

Compiled code keeps a tuple in registers, and plain Python handles it faster than a numpy array of three. Every argument
may also be an array of that length. Quaternions are scalar first (Hamilton).
"""

import math

from nav_pose_estimator.core.numerics.jit import inlined

SMALL_ANGLE_SQUARED = 0.04
"""rad^2: below it, five terms of the series of exp are exact to float64, and cheaper than sin and cos."""


@inlined
def load3(array, start):
    """The three numbers of ``array`` from ``start`` on."""
    return float(array[start]), float(array[start + 1]), float(array[start + 2])


@inlined
def load4(array, start):
    """The four numbers of ``array`` from ``start`` on."""
    return float(array[start]), float(array[start + 1]), float(array[start + 2]), float(array[start + 3])


@inlined
def store3(array, start, v):
    """Write ``v`` (3,) into ``array`` from ``start`` on."""
    array[start] = v[0]
    array[start + 1] = v[1]
    array[start + 2] = v[2]


@inlined
def store4(array, start, q):
    """Write ``q`` (4,) into ``array`` from ``start`` on."""
    array[start] = q[0]
    array[start + 1] = q[1]
    array[start + 2] = q[2]
    array[start + 3] = q[3]


@inlined
def add(a, b):
    """a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inlined
def add_scaled(a, s, b):
    """a + s b."""
    return a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]


@inlined
def scale(s, a):
    """s a."""
    return s * a[0], s * a[1], s * a[2]


@inlined
def cross(a, b):
    """a x b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inlined
def dot(a, b):
    """a . b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def less_product(v, array, start):
    """v - M v, with the matrix M (3, 3) row by row in ``array`` from ``start`` on."""
    a, b, c = load3(array, start), load3(array, start + 3), load3(array, start + 6)
    return (
        v[0] - a[0] * v[0] - a[1] * v[1] - a[2] * v[2],
        v[1] - b[0] * v[0] - b[1] * v[1] - b[2] * v[2],
        v[2] - c[0] * v[0] - c[1] * v[1] - c[2] * v[2],
    )


@inlined
def q_multiply(a, b):
    """Hamilton product of two quaternions."""
    return (
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )


@inlined
def q_rotate(q, v):
    """``q v q*``: ``v`` rotated by the unit quaternion ``q``."""
    u = (q[1], q[2], q[3])
    t = cross(u, v)
    t = (t[0] + t[0], t[1] + t[1], t[2] + t[2])
    return add(add_scaled(v, q[0], t), cross(u, t))


@inlined
def q_rotate_back(q, v):
    """``q* v q``: the inverse of ``q_rotate``."""
    return q_rotate((q[0], -q[1], -q[2], -q[3]), v)


@inlined
def q_exp(v):
    """Quaternion of the rotation vector ``v`` [rad]."""
    angle_squared = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
    if angle_squared < SMALL_ANGLE_SQUARED:
        x = 0.25 * angle_squared
        w = 1.0 - x / 2.0 * (1.0 - x / 12.0 * (1.0 - x / 30.0 * (1.0 - x / 56.0)))
        s = 0.5 * (1.0 - x / 6.0 * (1.0 - x / 20.0 * (1.0 - x / 42.0 * (1.0 - x / 72.0))))
    else:
        angle = math.sqrt(angle_squared)
        w = math.cos(0.5 * angle)
        s = math.sin(0.5 * angle) / angle
    return w, s * v[0], s * v[1], s * v[2]


@inlined
def q_polish(q):
    """Normalise a quaternion of almost unit length by one Newton step, without a square root.

    Exact to rounding where the length is wrong by up to 1e-8; repeated steps converge.
    """
    s = 1.5 - 0.5 * (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return s * q[0], s * q[1], s * q[2], s * q[3]


@inlined
def q_columns(q):
    """The three columns of the rotation matrix of the unit quaternion ``q_nb``: the axes of b, resolved in n."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    return (
        (w * w + x * x - y * y - z * z, 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)),
        (2.0 * (x * y - w * z), w * w - x * x + y * y - z * z, 2.0 * (y * z + w * x)),
        (2.0 * (x * z + w * y), 2.0 * (y * z - w * x), w * w - x * x - y * y + z * z),
    )
