"""Error state: correction of the nominal state by an estimated error, and the error between two nominal states.

Velocity and position errors are estimate minus truth; the attitude error phi is defined by C_true = Exp(phi)
C_estimate. The error of a bias or of a state of an optional block is truth minus estimate.
"""

import math

import numpy as np

from nav_pose_estimator.core.earth.ellipsoid import cos_latitude, radii
from nav_pose_estimator.core.filter.blocks import TABLE, state_count
from nav_pose_estimator.core.filter.layout import ALT, D_GYRO_BIAS, DPOS, DVEL, GYRO_BIAS, LAT, LON, PHI, QUAT, VEL
from nav_pose_estimator.core.numerics.jit import inlined, kernel
from nav_pose_estimator.core.numerics.rotation import wrap_angle
from nav_pose_estimator.core.numerics.vectors import load3, load4, q_exp, q_multiply, q_polish, store4

_IMU_BIASES = -1
_ADDED = ((_IMU_BIASES, 6, GYRO_BIAS), *TABLE)
"""Errors of sign truth minus estimate: (constant with the first state, size, place in ``nav``)."""


@inlined
def _first_state(constants, index):
    """First state of an entry of ``_ADDED`` in the error state; negative where the filter does not have it."""
    return D_GYRO_BIAS if index == _IMU_BIASES else int(constants[index])


@kernel
def inject(nav, constants, error):
    """Correct ``nav`` by an estimated ``error`` (n,): C <- Exp(phi) C, v <- v - dv, p <- p - dp, the others added.

    Raises ``ValueError`` for an error of another size: machine code would read beyond the end of the array.
    """
    if len(error) != state_count(constants):
        raise ValueError("the error does not have the states of the filter")
    store4(nav, QUAT, q_polish(q_multiply(q_exp(load3(error, PHI)), load4(nav, QUAT))))
    R_M, R_N = radii(nav[LAT])
    nav[LON] = wrap_angle(nav[LON] - error[DPOS] / ((R_N + nav[ALT]) * cos_latitude(nav[LAT])))
    nav[LAT] -= error[DPOS + 1] / (R_M + nav[ALT])
    nav[ALT] -= error[DPOS + 2]
    for i in range(3):
        nav[VEL + i] -= error[DVEL + i]
    for index, size, place in _ADDED:
        start = _first_state(constants, index)
        if start >= 0:
            for i in range(size):
                nav[place + i] += error[start + i]


@kernel
def error_between(nav, other, constants):
    """Error (n,) of ``other`` if ``nav`` is the truth: ``inject(other, constants, error)`` gives ``nav``."""
    error = np.zeros(state_count(constants))
    turn = turn_between(nav[QUAT : QUAT + 4], other[QUAT : QUAT + 4])
    R_M, R_N = radii(other[LAT])
    error[DPOS] = wrap_angle(other[LON] - nav[LON]) * (R_N + other[ALT]) * cos_latitude(other[LAT])
    error[DPOS + 1] = (other[LAT] - nav[LAT]) * (R_M + other[ALT])
    error[DPOS + 2] = other[ALT] - nav[ALT]
    for i in range(3):
        error[PHI + i] = turn[i]
        error[DVEL + i] = other[VEL + i] - nav[VEL + i]
    for index, size, place in _ADDED:
        start = _first_state(constants, index)
        if start >= 0:
            for i in range(size):
                error[start + i] = nav[place + i] - other[place + i]
    return error


@kernel
def turn_between(q, other):
    """Rotation vector [rad] in n that turns the attitude ``other`` (4,) into ``q`` (4,): Exp(phi) = q conj(other)."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    a, b, c, d = other[0], -other[1], -other[2], -other[3]
    scalar = w * a - x * b - y * c - z * d
    turn = (w * b + x * a + y * d - z * c, w * c - x * d + y * a + z * b, w * d + x * c - y * b + z * a)
    sine = math.sqrt(turn[0] * turn[0] + turn[1] * turn[1] + turn[2] * turn[2])
    factor = 2.0 if scalar >= 0.0 else -2.0
    if sine > 1e-9:
        factor = 2.0 * math.atan2(sine, abs(scalar)) / sine * (1.0 if scalar >= 0.0 else -1.0)
    return factor * turn[0], factor * turn[1], factor * turn[2]
