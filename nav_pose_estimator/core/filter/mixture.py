"""Several Gaussians about one vehicle, and the one Gaussian that they make together.

A branch is a pair ``nav`` (NAV_SIZE,), ``P`` (n, n) of ``filter.layout``, one for each hypothesis of what the vehicle
does. Branches differ by small errors, so the mixture is formed in the error state of its strongest member.

Source: H. Blom and Y. Bar-Shalom, "The interacting multiple model algorithm for systems with Markovian switching
coefficients", IEEE Transactions on Automatic Control 33(8), 1988.
"""

import math

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.earth.ellipsoid import cos_latitude, radii
from nav_pose_estimator.core.filter.kalman import has_gyro_matrix, has_wind, inject
from nav_pose_estimator.core.filter.layout import (
    ACCEL_BIAS,
    ALT,
    BASE_STATES,
    D_ACCEL_BIAS,
    D_GYRO_BIAS,
    DPOS,
    DVEL,
    GYRO_BIAS,
    GYRO_MATRIX,
    GYRO_MATRIX_STATES,
    LAT,
    LON,
    OUT_COLUMNS,
    OUT_POS,
    OUT_QUAT,
    OUT_VAR,
    OUT_VEL,
    PHI,
    QUAT,
    VEL,
    WIND,
    WIND_STATES,
)
from nav_pose_estimator.core.numerics.jit import kernel
from nav_pose_estimator.core.numerics.rotation import wrap_angle

Array = NDArray[np.float64]


@kernel
def error_between(nav, other, n):
    """The error (n,) of ``other`` were ``nav`` the truth: ``inject(other, error)`` gives ``nav``."""
    error = np.zeros(n)
    turn = _turn_between(nav[QUAT : QUAT + 4], other[QUAT : QUAT + 4])
    R_M, R_N = radii(other[LAT])
    error[DPOS] = wrap_angle(other[LON] - nav[LON]) * (R_N + other[ALT]) * cos_latitude(other[LAT])
    error[DPOS + 1] = (other[LAT] - nav[LAT]) * (R_M + other[ALT])
    error[DPOS + 2] = other[ALT] - nav[ALT]
    for i in range(3):
        error[PHI + i] = turn[i]
        error[DVEL + i] = other[VEL + i] - nav[VEL + i]
        error[D_GYRO_BIAS + i] = nav[GYRO_BIAS + i] - other[GYRO_BIAS + i]
        error[D_ACCEL_BIAS + i] = nav[ACCEL_BIAS + i] - other[ACCEL_BIAS + i]
    block = BASE_STATES
    if has_wind(n):
        for i in range(WIND_STATES):
            error[block + i] = nav[WIND + i] - other[WIND + i]
        block += WIND_STATES
    if has_gyro_matrix(n):
        for i in range(GYRO_MATRIX_STATES):
            error[block + i] = nav[GYRO_MATRIX + i] - other[GYRO_MATRIX + i]
    return error


@kernel
def _turn_between(q, other):
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


@kernel
def merge(navs, Ps, weights):
    """The Gaussian with mean and covariance of the mixture: ``navs`` (K, NAV_SIZE), ``Ps`` (K, n, n), ``weights`` (K,).

    ``weights`` sum to one. The integrator's memory is that of the strongest branch.
    """
    K, n = Ps.shape[0], Ps.shape[1]
    strongest = 0
    for k in range(1, K):
        if weights[k] > weights[strongest]:
            strongest = k
    nav = navs[strongest].copy()
    errors = np.zeros((K, n))
    mean = np.zeros(n)
    for k in range(K):
        if k != strongest:
            errors[k] = error_between(navs[k], nav, n)
            for i in range(n):
                mean[i] += weights[k] * errors[k, i]
    P = np.zeros((n, n))
    for k in range(K):
        for i in range(n):
            for j in range(n):
                spread = (errors[k, i] - mean[i]) * (errors[k, j] - mean[j])
                P[i, j] += weights[k] * (Ps[k, i, j] + spread)
    inject(nav, mean)
    return nav, P


@kernel
def blend_rows(rows, weights, begin, end, out):
    """Output rows of the mixture, ``begin`` to ``end``: ``rows`` (K, N, OUT_COLUMNS) -> ``out`` (N, OUT_COLUMNS).

    Between two decisions the branches move by the same linear law, so the mean of their rows is the mixture's mean.
    """
    K = rows.shape[0]
    for i in range(begin, end):
        for c in range(OUT_COLUMNS):
            total = 0.0
            for k in range(K):
                total += weights[k] * rows[k, i, c]
            out[i, c] = total
        out[i, OUT_POS + 1] = _mean_longitude(rows[:, i, OUT_POS + 1], weights)
        length = 0.0
        for c in range(OUT_QUAT, OUT_QUAT + 4):
            length += out[i, c] * out[i, c]
        for c in range(OUT_QUAT, OUT_QUAT + 4):
            out[i, c] /= math.sqrt(length)
        R_M, R_N = radii(out[i, OUT_POS])
        metres = (R_N * cos_latitude(out[i, OUT_POS]), R_M, 1.0)
        for k in range(K):
            turn = _turn_between(rows[k, i, OUT_QUAT : OUT_QUAT + 4], out[i, OUT_QUAT : OUT_QUAT + 4])
            position, mean = rows[k, i, OUT_POS : OUT_POS + 3], out[i, OUT_POS : OUT_POS + 3]
            apart = (wrap_angle(position[1] - mean[1]), position[0] - mean[0], position[2] - mean[2])
            for axis in range(3):
                dv = rows[k, i, OUT_VEL + axis] - out[i, OUT_VEL + axis]
                dp = apart[axis] * metres[axis]
                out[i, OUT_VAR + PHI + axis] += weights[k] * turn[axis] * turn[axis]
                out[i, OUT_VAR + DVEL + axis] += weights[k] * dv * dv
                out[i, OUT_VAR + DPOS + axis] += weights[k] * dp * dp


@kernel
def _mean_longitude(longitudes, weights):
    """Weighted mean (weights sum to one) of longitudes (K,) that are near each other, maybe across the date line."""
    shift = 0.0
    for k in range(1, len(longitudes)):
        shift += weights[k] * wrap_angle(longitudes[k] - longitudes[0])
    return wrap_angle(longitudes[0] + shift)


def with_wind(P: Array, cov: Array) -> Array:
    """``P`` without the wind block -> with it, of covariance ``cov`` (2, 2) [m^2/s^2]."""
    kept = [*range(BASE_STATES), *range(BASE_STATES + WIND_STATES, len(P) + WIND_STATES)]
    wider = np.zeros((len(P) + WIND_STATES,) * 2)
    wider[np.ix_(kept, kept)] = P
    wind = slice(BASE_STATES, BASE_STATES + WIND_STATES)
    wider[wind, wind] = cov
    return wider
