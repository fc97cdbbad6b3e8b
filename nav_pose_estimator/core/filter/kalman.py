"""Kalman filter of the error state, closed loop: an observation corrects the nominal state and the error is zero again.

An observation is ``z`` (m,), estimate minus measurement, with ``H`` (m, n) such that z = H error + noise, and the
noise covariance ``R`` (m, m). All arrays are float64 and contiguous; ``nav`` and ``P`` change in place. ``constants``
tell which states there are. Bring ``P`` to the time of ``nav`` first (``core.filter.strapdown.flush_covariance``).

The covariance update is Joseph's form, a sum of two congruences, so that ``P`` stays exactly symmetric and positive
definite also for measurements much better than the state.

Sources: Groves, second edition, equations 3.21, 3.24, 3.58, 17.16 (Joseph's form, gate on the normalised innovation);
J. Sola (2017), section 6.3 (reset; here the attitude error is defined in n, which changes the sign of its Jacobian).
"""

import math

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.earth.ellipsoid import gravity
from nav_pose_estimator.core.filter.error_model import propagate_covariance, system_matrix
from nav_pose_estimator.core.filter.error_state import inject
from nav_pose_estimator.core.filter.layout import ALT, DPOS, GYRO_BIAS_PSD, GYRO_WANDER, LAT, PHI
from nav_pose_estimator.core.numerics.jit import COMPILED, kernel
from nav_pose_estimator.core.numerics.vectors import add, cross, load3, scale

Array = NDArray[np.float64]

REJECTED, ACCEPTED, INFLATED = 0, 1, 2
"""Status of ``gated_correct``: left out, taken as it is, taken with more noise than it claims."""

PREDICTION_STEP = 1.0  # s


# --- correct -------------------------------------------------------------------------------------------------------
@kernel
def correct(nav, P, constants, z, H, R):
    """Take one observation in. Returns its normalised innovation squared (NIS).

    The NIS is infinite, and nothing is changed, when a number is not finite or H P H' + R is not positive definite.
    """
    m, n = H.shape
    gain = np.empty((n, m))
    nis = _gain(P, z, H, R, gain)
    if nis < math.inf:
        _update(nav, P, constants, z, H, R, gain)
    return nis


@kernel
def gated_correct(nav, P, constants, z, H, R, soft, hard):
    """``correct`` behind a gate on the NIS; returns (status, nis) with the NIS before any inflation.

    Up to ``soft`` the observation is ACCEPTED as it is. Up to ``hard`` it is INFLATED: R grows by (nis / soft - 1) S
    with S = H P H' + R, which makes its NIS exactly ``soft``. Beyond, or when not finite, it is REJECTED and nothing
    changes.
    """
    nis = innovation(P, z, H, R)
    if not (nis <= hard and nis < math.inf):
        return REJECTED, nis
    status, noise = ACCEPTED, R
    if nis > soft:
        status, noise = INFLATED, _widened(P, H, R, nis / soft - 1.0)
    if correct(nav, P, constants, z, H, noise) == math.inf:
        return REJECTED, nis
    return status, nis


@kernel
def innovation(P, z, H, R):
    """Normalised innovation squared of an observation that is not taken in; infinite as in ``correct``."""
    m, n = H.shape
    return _gain(P, z, H, R, np.empty((n, m)))


@kernel
def log_density(P, z, H, R):
    """Logarithm of the density of an observation, but for a constant that depends on its size alone."""
    m, n = H.shape
    gain = np.empty((n, m))
    nis = _gain(P, z, H, R, gain)
    if not nis < math.inf:
        return -math.inf
    _project(P, H, gain)
    L = _innovation_covariance(H, R, gain)
    _factorise(L)
    total = -0.5 * nis
    for i in range(m):
        total -= math.log(L[i, i])
    return total


@kernel
def _project(P, H, out):
    """``out`` (n, m) = P H'; zeros of H cost nothing."""
    m, n = H.shape
    for i in range(m):
        for j in range(n):
            out[j, i] = 0.0
        for k in range(n):
            h = H[i, k]
            if h != 0.0:
                for j in range(n):
                    out[j, i] += h * P[k, j]


@kernel
def _innovation_covariance(H, R, PH):
    """S (m, m) = H P H' + R from ``PH`` = P H'."""
    m, n = H.shape
    S = np.empty((m, m))
    for i in range(m):
        for j in range(i + 1):
            total = R[i, j]
            for k in range(n):
                total += H[i, k] * PH[k, j]
            S[i, j] = total
            S[j, i] = total
    return S


@kernel
def _factorise(S):
    """Lower Cholesky factor of ``S`` in its place; False when ``S`` is not positive definite or not finite."""
    for i in range(S.shape[0]):
        for j in range(i + 1):
            total = S[i, j]
            for k in range(j):
                total -= S[i, k] * S[j, k]
            if i > j:
                S[i, j] = total / S[j, j]
            elif 0.0 < total < math.inf:
                S[i, i] = math.sqrt(total)
            else:
                return False
    return True


@kernel
def _gain(P, z, H, R, gain):
    """Fill ``gain`` (n, m) with K = P H' (H P H' + R)^-1; returns the NIS, or infinity when there is no such gain."""
    m, n = H.shape
    _project(P, H, gain)
    L = _innovation_covariance(H, R, gain)
    if not _factorise(L):
        return math.inf
    nis = 0.0
    whitened = np.empty(m)
    for i in range(m):
        total = z[i]
        for k in range(i):
            total -= L[i, k] * whitened[k]
        whitened[i] = total / L[i, i]
        nis += whitened[i] * whitened[i]
    for row in range(n):
        for i in range(m):
            for k in range(i):
                gain[row, i] -= L[i, k] * gain[row, k]
            gain[row, i] /= L[i, i]
        for i in range(m - 1, -1, -1):
            for k in range(i + 1, m):
                gain[row, i] -= L[k, i] * gain[row, k]
            gain[row, i] /= L[i, i]
    return nis if nis < math.inf else math.inf


@kernel
def _widened(P, H, R, factor):
    """R + factor (H P H' + R)."""
    m, n = H.shape
    PH = np.empty((n, m))
    _project(P, H, PH)
    S = _innovation_covariance(H, R, PH)
    for i in range(m):
        for j in range(m):
            S[i, j] = R[i, j] + factor * S[i, j]
    return S


@kernel
def _joseph_by_loops(P, H, R, gain):
    """``P <- (I - K H) P (I - K H)' + K R K'``, each half computed once; zeros of I - K H cost nothing."""
    m, n = H.shape
    M = np.zeros((n, n))
    MP = np.zeros((n, n))
    KR = np.zeros((n, m))
    for i in range(n):
        M[i, i] = 1.0
        for r in range(m):
            for j in range(n):
                M[i, j] -= gain[i, r] * H[r, j]
            for k in range(m):
                KR[i, k] += gain[i, r] * R[r, k]
        for j in range(n):
            if M[i, j] != 0.0:
                for k in range(n):
                    MP[i, k] += M[i, j] * P[j, k]
    for i in range(n):
        for j in range(i + 1):
            total = 0.0
            for k in range(n):
                total += MP[i, k] * M[j, k]
            for k in range(m):
                total += KR[i, k] * gain[j, k]
            P[i, j] = total
            P[j, i] = total


def _joseph_by_products(P, H, R, gain):
    """The same by products of whole matrices: without a compiler numpy is faster than loops."""
    M = np.eye(len(P)) - gain @ H
    later = M @ P @ M.T + gain @ R @ gain.T
    P[:] = 0.5 * (later + later.T)


_joseph = _joseph_by_loops if COMPILED else _joseph_by_products


@kernel
def _turn_misalignment(P, phi):
    """Express ``P`` in the misalignment that is left after C <- Exp(phi) C: phi' = (I + [phi x] / 2) (phi_old - phi).

    The left Jacobian of SO(3) to first order: Exp(phi + d) Exp(-phi) = Exp((I + [phi x] / 2) d).
    """
    n = P.shape[0]
    half = scale(0.5, phi)
    block = np.empty((3, 3))
    for k in range(n):
        column = (P[PHI, k], P[PHI + 1, k], P[PHI + 2, k])
        column = add(column, cross(half, column))
        for i in range(3):
            if k < PHI or k >= PHI + 3:
                P[PHI + i, k] = column[i]
                P[k, PHI + i] = column[i]
            else:
                block[i, k - PHI] = column[i]
    for i in range(3):
        row = (block[i, 0], block[i, 1], block[i, 2])
        row = add(row, cross(half, row))
        for j in range(i, 3):
            P[PHI + i, PHI + j] = row[j]
            P[PHI + j, PHI + i] = row[j]


@kernel
def _update(nav, P, constants, z, H, R, gain):
    """Correct ``nav`` and ``P`` with a given gain."""
    m, n = H.shape
    error = np.zeros(n)
    for i in range(n):
        for r in range(m):
            error[i] += gain[i, r] * z[r]
    _joseph(P, H, R, gain)
    _turn_misalignment(P, load3(error, PHI))
    inject(nav, constants, error)


# --- outlook -------------------------------------------------------------------------------------------------------
@kernel
def horizontal_sd(P):
    """Root of the summed variances East and North [m]."""
    return math.sqrt(P[DPOS, DPOS] + P[DPOS + 1, DPOS + 1])


def predicted_horizontal_sd(nav: Array, P: Array, constants: Array, seconds: float) -> float:
    """``horizontal_sd`` [m] that ``P`` will have when nothing but the IMU is used for ``seconds`` from now.

    The vehicle is taken to hold its attitude and velocity: any vehicle's mean specific force over such a time is close
    to the reaction to gravity.
    """
    later = P.copy()
    f_n = np.array((0.0, 0.0, gravity(nav[LAT], nav[ALT])))
    F = system_matrix(nav, constants, len(P), f_n, np.zeros(3))
    constants = constants.copy()
    constants[GYRO_BIAS_PSD] += nav[GYRO_WANDER]
    steps = math.ceil(max(seconds, 0.0) / PREDICTION_STEP)
    for _ in range(steps):
        propagate_covariance(later, F, constants, seconds / steps)
    return float(horizontal_sd(later))
