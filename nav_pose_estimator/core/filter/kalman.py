"""Measurement update of the closed-loop error-state Kalman filter: each update corrects the nominal state.

An observation is ``z`` (m,), estimate minus measurement, with ``H`` (m, n) such that z = H error + noise, and the
noise covariance ``R`` (m, m). After the update the error estimate is zero again. All arrays are float64 and contiguous;
``nav`` and ``P`` change in place. ``constants`` say which states the filter has. Propagate ``P`` to the time of ``nav``
first (``core.filter.strapdown.flush_covariance``).

The covariance update is Joseph's form, so that ``P`` stays exactly symmetric and positive definite, also for
measurements much better than the state.

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
"""Status of ``gated_correct``: rejected, used as it is, used with inflated noise."""

PREDICTION_STEP = 1.0  # s: covariance step of ``predicted_horizontal_sd``


# --- correct -------------------------------------------------------------------------------------------------------
@kernel
def correct(nav, P, constants, z, H, R):
    """Update by one observation; returns its normalised innovation squared (NIS).

    The NIS is infinite, and nothing is changed, where a number is not finite or H P H' + R is not positive definite.
    """
    m, n = H.shape
    HP, L = np.empty((m, n)), np.empty((m, m))
    nis = _whitened_square(P, z, H, R, HP, L)
    if nis < math.inf:
        _update(nav, P, constants, z, H, R, HP, _gain(HP, L))
    return nis


@kernel
def gated_correct(nav, P, constants, z, H, R, soft, hard):
    """``correct`` behind a gate on the NIS; returns (status, nis) with the NIS before any inflation.

    Up to ``soft`` the observation is ACCEPTED as it is. Up to ``hard`` it is INFLATED: R grows by (nis / soft - 1) S
    with S = H P H' + R, which makes its NIS exactly ``soft`` and the gain smaller by that ratio. Beyond, or when not
    finite, it is REJECTED and nothing changes.
    """
    m, n = H.shape
    HP, L = np.empty((m, n)), np.empty((m, m))
    nis = _whitened_square(P, z, H, R, HP, L)
    if not (nis <= hard and nis < math.inf):
        return REJECTED, nis
    status, noise, gain = ACCEPTED, R, _gain(HP, L)
    if nis > soft:
        status, noise = INFLATED, _widened(R, L, nis / soft - 1.0)
        for i in range(m):
            for j in range(n):
                gain[i, j] *= soft / nis
    _update(nav, P, constants, z, H, noise, HP, gain)
    return status, nis


@kernel
def innovation(P, z, H, R):
    """NIS of an observation without an update; infinite as in ``correct``."""
    m, n = H.shape
    return _whitened_square(P, z, H, R, np.empty((m, n)), np.empty((m, m)))


@kernel
def log_density(P, z, H, R):
    """Log-likelihood of an observation, up to a constant that depends only on its dimension."""
    m, n = H.shape
    L = np.empty((m, m))
    nis = _whitened_square(P, z, H, R, np.empty((m, n)), L)
    if not nis < math.inf:
        return -math.inf
    total = -0.5 * nis
    for i in range(m):
        total -= math.log(L[i, i])
    return total


@kernel
def _whitened_square(P, z, H, R, HP, L):
    """The NIS, infinite where invalid; ``HP`` (m, n) becomes H P, ``L`` (m, m) the Cholesky factor of H P H' + R.

    H P skips the zeros of H. The product with H' does not, so that a NaN in P makes the NIS invalid (0 times NaN).
    """
    m, n = H.shape
    for i in range(m):
        for j in range(n):
            HP[i, j] = 0.0
        for k in range(n):
            h = H[i, k]
            if h != 0.0:
                for j in range(n):
                    HP[i, j] += h * P[k, j]
    for i in range(m):
        for j in range(i + 1):
            total = R[i, j]
            for k in range(n):
                total += H[i, k] * HP[j, k]
            L[i, j] = total
            L[j, i] = 0.0 if i != j else total
    if not factorise(L):
        return math.inf
    nis = 0.0
    whitened = np.empty(m)
    for i in range(m):
        total = z[i]
        for k in range(i):
            total -= L[i, k] * whitened[k]
        whitened[i] = total / L[i, i]
        nis += whitened[i] * whitened[i]
    return nis if nis < math.inf else math.inf


@kernel
def factorise(S):
    """Replace the lower triangle of ``S`` by its Cholesky factor; False unless S is positive definite."""
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
def _gain(HP, L):
    """The gain transposed, K' (m, n) = (L L')^-1 H P."""
    m, n = HP.shape
    gain = HP.copy()
    for i in range(m):
        for k in range(i):
            for j in range(n):
                gain[i, j] -= L[i, k] * gain[k, j]
        for j in range(n):
            gain[i, j] /= L[i, i]
    for i in range(m - 1, -1, -1):
        for k in range(i + 1, m):
            for j in range(n):
                gain[i, j] -= L[k, i] * gain[k, j]
        for j in range(n):
            gain[i, j] /= L[i, i]
    return gain


@kernel
def _widened(R, L, factor):
    """R + factor L L'."""
    m = len(R)
    wider = np.empty((m, m))
    for i in range(m):
        for j in range(m):
            total = 0.0
            for k in range(min(i, j) + 1):
                total += L[i, k] * L[j, k]
            wider[i, j] = R[i, j] + factor * total
    return wider


@kernel
def _joseph_by_loops(P, H, R, HP, gain):
    """``P <- (I - K H) P (I - K H)' + K R K'`` for any ``gain`` K' (m, n), as two updates of rank m.

    A = P - K H P, then P = A - (A H' - K R) K'. For the optimal gain the second term is only rounding; it makes the
    form robust.
    """
    m, n = H.shape
    rest = np.zeros((m, n))  # (A H' - K R)'
    for r in range(m):
        for i in range(n):
            g = gain[r, i]
            if g != 0.0:
                for j in range(n):
                    P[i, j] -= g * HP[r, j]
    for r in range(m):
        for k in range(n):
            h = H[r, k]
            if h != 0.0:
                for i in range(n):
                    rest[r, i] += h * P[i, k]
        for k in range(m):
            for i in range(n):
                rest[r, i] -= gain[k, i] * R[k, r]
    for i in range(n):
        for j in range(i + 1):
            total = P[i, j]
            for r in range(m):
                total -= rest[r, i] * gain[r, j]
            P[i, j] = total
            P[j, i] = total


def _joseph_by_products(P, H, R, HP, gain):
    """The same by matrix products: without a compiler numpy is faster than loops."""
    A = P - gain.T @ HP
    later = A - (A @ H.T - gain.T @ R) @ gain
    P[:] = 0.5 * (later + later.T)


_joseph = _joseph_by_loops if COMPILED else _joseph_by_products


@kernel
def _turn_misalignment(P, phi):
    """Reset of the attitude error: express ``P`` in phi' = (I + [phi x] / 2) (phi_old - phi) after C <- Exp(phi) C.

    This is the left Jacobian of SO(3) to first order: Exp(phi + d) Exp(-phi) = Exp((I + [phi x] / 2) d).
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
def _update(nav, P, constants, z, H, R, HP, gain):
    """Correct ``nav`` and ``P`` with the transposed gain K' (m, n)."""
    m, n = H.shape
    error = np.zeros(n)
    for i in range(n):
        for r in range(m):
            error[i] += gain[r, i] * z[r]
    _joseph(P, H, R, HP, gain)
    _turn_misalignment(P, load3(error, PHI))
    inject(nav, constants, error)


# --- prediction ----------------------------------------------------------------------------------------------------
@kernel
def horizontal_sd(P):
    """Horizontal standard deviation [m]: root of the sum of the variances East and North."""
    return math.sqrt(P[DPOS, DPOS] + P[DPOS + 1, DPOS + 1])


def predicted_horizontal_sd(nav: Array, P: Array, constants: Array, seconds: float) -> float:
    """``horizontal_sd`` [m] predicted for ``seconds`` [s] of coasting on the IMU alone.

    The vehicle is assumed to keep its attitude and velocity: the mean specific force of any vehicle over such a time is
    close to the reaction to gravity.
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
