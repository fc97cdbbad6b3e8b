"""Moment matching of a Gaussian mixture of filters: the single Gaussian with its mean and covariance.

A branch is a pair ``nav`` (NAV_SIZE,), ``P`` (n, n) of ``filter.layout``, one per hypothesis about the vehicle's
motion. Branches differ by small errors, so the mixture is formed in the error state about the branch of the largest
weight.

Source: H. Blom and Y. Bar-Shalom, "The interacting multiple model algorithm for systems with Markovian switching
coefficients", IEEE Transactions on Automatic Control 33(8), 1988.
"""

import math

import numpy as np

from nav_pose_estimator.core.earth.ellipsoid import cos_latitude, radii
from nav_pose_estimator.core.filter.error_state import error_between, inject, turn_between
from nav_pose_estimator.core.filter.layout import (
    DPOS,
    DVEL,
    OUT_COLUMNS,
    OUT_POS,
    OUT_QUAT,
    OUT_VAR,
    OUT_VEL,
    PHI,
)
from nav_pose_estimator.core.numerics.jit import kernel
from nav_pose_estimator.core.numerics.rotation import wrap_angle


@kernel
def merge(navs, Ps, constants, weights):
    """(nav, P) with the mean and covariance of the mixture: ``navs`` (K, NAV_SIZE), ``Ps`` (K, n, n), ``weights`` (K,).

    ``constants`` are those of every branch; ``weights`` sum to one. The memory of the integrator is taken from the
    strongest branch.
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
            error = error_between(navs[k], nav, constants)
            for i in range(n):
                errors[k, i] = error[i]
                mean[i] += weights[k] * error[i]
    P = np.zeros((n, n))
    for k in range(K):
        for i in range(n):
            for j in range(n):
                spread = (errors[k, i] - mean[i]) * (errors[k, j] - mean[j])
                P[i, j] += weights[k] * (Ps[k, i, j] + spread)
    inject(nav, constants, mean)
    return nav, P


@kernel
def blend_rows(rows, weights, begin, end, out):
    """Output rows ``begin`` to ``end`` of the mixture: ``rows`` (K, N, OUT_COLUMNS) -> ``out`` (N, OUT_COLUMNS).

    Between two updates the branches propagate by the same linear model, so the mean of their rows is the mixture's
    mean.
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
            turn = turn_between(rows[k, i, OUT_QUAT : OUT_QUAT + 4], out[i, OUT_QUAT : OUT_QUAT + 4])
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
    """Weighted mean (weights sum to one) of longitudes (K,) that are close, possibly across the antimeridian."""
    shift = 0.0
    for k in range(1, len(longitudes)):
        shift += weights[k] * wrap_angle(longitudes[k] - longitudes[0])
    return wrap_angle(longitudes[0] + shift)
