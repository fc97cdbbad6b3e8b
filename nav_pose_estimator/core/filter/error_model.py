"""Error model of the navigator: system matrix F of the error state, and the propagation of the covariance.

State order, signs and units are those of ``filter.layout``: misalignment ``phi``, velocity and position error in n,
position in metres East, North, Up, then gyroscope and accelerometer bias in b, then the optional ``blocks``.

    phi_dot = -w_in x phi + dw_in - C (dbg + M w)      C = C_nb, w = w_ib_b, dw_in linear in dv and dp
    dv_dot  =  f_n x phi - (2 w_ie + w_en) x dv + v x (2 dw_ie + dw_en) + dg + C dba - g'
    dp_dot  =  dv + (rotation and scale of the metric coordinates)
    others  :  first-order Gauss-Markov with driving noise, or a random walk where its rate 1/tau is zero

dg is the change of normal gravity with height, g' the states of the gravity block.

Position errors are kept in metres, so that the covariance is well scaled. With D the metres per radian,
``dp_m = D dp`` obeys ``dp_m_dot = (D F_pp D^-1 + D_dot D^-1) dp_m + dv``; the variation of the radii cancels in it
exactly, because d((R_N + h) cos L)/dL = -(R_M + h) sin L. Known small terms are dropped elsewhere: the change of the
radii with latitude in w_en (1/300 of that term) and the change of gravity with latitude (8e-9 m/s^2 per metre).

Estimates of biases, wind and other blocks are held constant between updates, except those of the GNSS errors: the
Gauss-Markov model describes truth minus estimate.

Sources: CN113777645A, step 3 (states and structure; it drives no noise into the biases, which would stop the filter
from learning them); Titterton and Weston, "Strapdown Inertial Navigation Technology", second edition, section 12.3;
Groves, second edition, section 14.2.4; G. Strang, SIAM J. Numerical Analysis 5(3), 1968 (the splitting).
"""

import math

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.earth.ellipsoid import E2, MIN_COS_LAT, OMEGA, A, gravity_from_sine
from nav_pose_estimator.core.filter.blocks import add_block_noise, add_rates, fade_gnss_error
from nav_pose_estimator.core.filter.layout import (
    ACCEL_BIAS_PSD,
    ACCEL_BIAS_RATE,
    ACCEL_NOISE_PSD,
    ALT,
    D_ACCEL_BIAS,
    D_GYRO_BIAS,
    DPOS,
    DVEL,
    GAP_ACCEL_SD,
    GAP_RATE_SD,
    GYRO_BIAS_PSD,
    GYRO_BIAS_RATE,
    GYRO_NOISE_PSD,
    GYRO_WANDER,
    I_GRAVITY,
    I_GYRO_MATRIX,
    LAT,
    PHI,
    QUAT,
    SUM_FORCE,
    SUM_GAP,
    SUM_RATE,
    SUM_TIME,
    VEL,
)
from nav_pose_estimator.core.numerics.jit import COMPILED, inlined, kernel
from nav_pose_estimator.core.numerics.vectors import (
    add,
    add_scaled,
    cross,
    load3,
    load4,
    q_columns,
    q_exp,
    q_multiply,
    scale,
    store3,
)

Array = NDArray[np.float64]

EAST, NORTH, UP = 0, 1, 2


def system_matrix(nav: Array, constants: Array, states: int, f_n: Array, w_b: Array) -> Array:
    """F (states, states) at the state ``nav`` for specific force ``f_n`` (3,) [m/s^2] and rate ``w_b`` (3,) [rad/s]."""
    F = np.zeros((states, states))
    fill_system_matrix(F, nav, constants, load3(f_n, 0), load3(w_b, 0), q_columns(load4(nav, QUAT)))
    return F


@inlined
def fill_system_matrix(F, nav, constants, f_n, w_b, C):
    """Write F into a matrix of zeros. ``C`` holds the three columns of C_nb."""
    _fill_level_frame(F, nav)
    _add_skew(F, DVEL, PHI, 1.0, f_n)
    for j in range(3):
        _add_column(F, PHI, D_GYRO_BIAS + j, scale(-1.0, C[j]))
        _add_column(F, DVEL, D_ACCEL_BIAS + j, C[j])
        F[D_GYRO_BIAS + j, D_GYRO_BIAS + j] = -constants[GYRO_BIAS_RATE]
        F[D_ACCEL_BIAS + j, D_ACCEL_BIAS + j] = -constants[ACCEL_BIAS_RATE]
    add_rates(F, constants)
    matrix = int(constants[I_GYRO_MATRIX])
    if matrix >= 0:
        for i in range(3):
            for j in range(3):
                _add_column(F, PHI, matrix + 3 * i + j, scale(-w_b[j], C[i]))
    gravity = int(constants[I_GRAVITY])
    if gravity >= 0:
        for i in range(3):
            F[DVEL + i, gravity + i] = -1.0


@inlined
def _fill_level_frame(F, nav):
    """Coupling of position and velocity errors into all three by the rotation and curvature of the Earth."""
    lat, h = float(nav[LAT]), float(nav[ALT])
    s = math.sin(lat)
    c = max(math.cos(lat), MIN_COS_LAT)
    v = load3(nav, VEL)
    w2 = 1.0 - E2 * s * s
    R_N = A / math.sqrt(w2)
    i_m = 1.0 / (R_N * (1.0 - E2) / w2 + h)  # 1 / (R_M + h)
    i_n = 1.0 / (R_N + h)
    tan = s / c
    w_ie = (0.0, OMEGA * c, OMEGA * s)
    w_en = (-v[NORTH] * i_m, v[EAST] * i_n, v[EAST] * tan * i_n)
    # derivatives of w_en by velocity East and North; of w_ie and w_in by metres North; of w_en by metres Up
    by_east = (0.0, i_n, tan * i_n)
    by_north = (-i_m, 0.0, 0.0)
    earth_north = (0.0, -w_ie[UP] * i_m, w_ie[NORTH] * i_m)
    north = (0.0, earth_north[1], earth_north[2] + v[EAST] * i_n * i_m / (c * c))
    up = (-w_en[EAST] * i_m, -w_en[NORTH] * i_n, -w_en[UP] * i_n)

    _add_skew(F, PHI, PHI, -1.0, add(w_en, w_ie))
    _add_column(F, PHI, DVEL + EAST, by_east)
    _add_column(F, PHI, DVEL + NORTH, by_north)
    _add_column(F, PHI, DPOS + NORTH, north)
    _add_column(F, PHI, DPOS + UP, up)
    _add_skew(F, DVEL, DVEL, -1.0, add_scaled(w_en, 2.0, w_ie))
    _add_column(F, DVEL, DVEL + EAST, cross(v, by_east))
    _add_column(F, DVEL, DVEL + NORTH, cross(v, by_north))
    _add_column(F, DVEL, DPOS + NORTH, cross(v, add(north, earth_north)))
    _add_column(F, DVEL, DPOS + UP, cross(v, up))
    F[DVEL + UP, DPOS + UP] += 2.0 * gravity_from_sine(s * s, h) * math.sqrt(i_m * i_n)
    for i in range(3):
        F[DPOS + i, DVEL + i] = 1.0
    F[DPOS + EAST, DPOS + EAST] = (v[UP] - v[NORTH] * tan) * i_n
    F[DPOS + EAST, DPOS + NORTH] = w_en[UP]
    F[DPOS + EAST, DPOS + UP] = -w_en[NORTH]
    F[DPOS + NORTH, DPOS + NORTH] = v[UP] * i_m
    F[DPOS + NORTH, DPOS + UP] = w_en[EAST]


@kernel
def _propagate_by_shears(P, F, constants, T):
    """``P <- Phi (P + Q T / 2) Phi' + Q T / 2``, in place, with Phi of second order in the step ``T`` [s].

    Phi is Strang's splitting of exp(F T): half a step of Gauss-Markov decay and of velocity, a whole step of attitude
    and position, then the other halves of velocity and decay. Each part changes three states by the others, a shear.
    """
    n = P.shape[0]
    _shear_all(P, F, constants, T, scratch(n)[n:])


@inlined
def scratch(n):
    """Work space of the covariance steps of ``n`` states: the system matrix and three rows for ``_shear``."""
    return np.empty((n + 3, n))


@inlined
def _shear_all(P, F, constants, T, W):
    """``_propagate_by_shears`` with work space ``W`` (3, n)."""
    _add_noise(P, constants, 0.5 * T)
    _decay(P, F, 0.5 * T)
    for b, share in ((DVEL, 0.5), (PHI, 1.0), (DPOS, 1.0), (DVEL, 0.5)):  # a loop, so that it is compiled only once
        _shear(P, F, W, b, share * T)
    _decay(P, F, 0.5 * T)
    _add_noise(P, constants, 0.5 * T)


@inlined
def _decay(P, F, T):
    """Multiply rows and columns of biases and optional states by exp(F_ii T); neighbours mostly share their rate."""
    n = P.shape[0]
    rate, factor = 0.0, 1.0
    for i in range(D_GYRO_BIAS, n):
        if F[i, i] != rate:
            rate = F[i, i]
            factor = math.exp(T * rate)
        if rate != 0.0:
            for k in range(n):
                P[i, k] *= factor
            for k in range(n):
                P[k, i] *= factor


@inlined
def _shear(P, F, W, b, T):
    """``P <- S P S'`` with S = I + T F[b:b+3] in rows b to b+2: one step of three states."""
    n = P.shape[0]
    x, y, z = 0, 1, 2
    for k in range(n):
        W[x, k] = P[b, k]
        W[y, k] = P[b + 1, k]
        W[z, k] = P[b + 2, k]
    for j in range(n):
        c0, c1, c2 = T * F[b, j], T * F[b + 1, j], T * F[b + 2, j]
        if c0 != 0.0 or c1 != 0.0 or c2 != 0.0:
            for k in range(n):
                W[x, k] += c0 * P[j, k]
                W[y, k] += c1 * P[j, k]
                W[z, k] += c2 * P[j, k]
    # The diagonal block is sheared from both sides; six independent sums use the processor's pipelines.
    s00, s10, s11, s20, s21, s22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(n):
        c0, c1, c2 = F[b, j], F[b + 1, j], F[b + 2, j]
        s00 += W[x, j] * c0
        s10 += W[y, j] * c0
        s11 += W[y, j] * c1
        s20 += W[z, j] * c0
        s21 += W[z, j] * c1
        s22 += W[z, j] * c2
    W[x, b] += T * s00
    W[y, b] += T * s10
    W[y, b + 1] += T * s11
    W[z, b] += T * s20
    W[z, b + 1] += T * s21
    W[z, b + 2] += T * s22
    W[x, b + 1], W[x, b + 2], W[y, b + 2] = W[y, b], W[z, b], W[z, b + 1]
    for i in range(3):
        for k in range(n):
            P[b + i, k] = W[i, k]
            P[k, b + i] = W[i, k]


def _propagate_by_products(P, F, constants, T, space=None):
    """The same step with equal accuracy by matrix products: without a compiler numpy is faster than loops."""
    transition = np.eye(len(P)) + T * F + (0.5 * T * T) * (F @ F)
    _add_noise(P, constants, 0.5 * T)
    later = transition @ P @ transition.T
    P[:] = 0.5 * (later + later.T)
    _add_noise(P, constants, 0.5 * T)


propagate_in = _shear_all if COMPILED else _propagate_by_products
propagate_covariance = _propagate_by_shears if COMPILED else _propagate_by_products
"""(P, F, constants, T): propagate ``P`` (n, n) over ``T`` [s] with the system matrix ``F`` (n, n), in place."""


@inlined
def _add_noise(P, constants, T):
    """``P <- P + G q G' T``. White noise of equal density on three axes is the same in b and in n."""
    for i in range(3):
        P[PHI + i, PHI + i] += constants[GYRO_NOISE_PSD] * T
        P[DVEL + i, DVEL + i] += constants[ACCEL_NOISE_PSD] * T
        P[D_GYRO_BIAS + i, D_GYRO_BIAS + i] += constants[GYRO_BIAS_PSD] * T
        P[D_ACCEL_BIAS + i, D_ACCEL_BIAS + i] += constants[ACCEL_BIAS_PSD] * T
    add_block_noise(P, constants, T)


@inlined
def _add_gap(P, constants, gap):
    """Add the effect of an unknown constant rate and force over a ``gap`` [s] on attitude, velocity and position."""
    turn = constants[GAP_RATE_SD] * gap
    push = constants[GAP_ACCEL_SD] * gap
    for i in range(3):
        v, p = DVEL + i, DPOS + i
        P[PHI + i, PHI + i] += turn * turn
        P[v, v] += push * push
        P[p, p] += 0.25 * gap * gap * push * push
        P[v, p] += 0.5 * gap * push * push
        P[p, v] = P[v, p]


@inlined
def _add_skew(F, row, column, s, v):
    """``F[row:row+3, column:column+3] += s [v x]``."""
    F[row, column + 1] -= s * v[2]
    F[row, column + 2] += s * v[1]
    F[row + 1, column] += s * v[2]
    F[row + 1, column + 2] -= s * v[0]
    F[row + 2, column] -= s * v[1]
    F[row + 2, column + 1] += s * v[0]


@inlined
def _add_column(F, row, column, v):
    """``F[row:row+3, column] += v``."""
    for i in range(3):
        F[row + i, column] += v[i]


@kernel
def covariance_step(nav, P, constants):
    """Propagate ``P`` (n, n) over the time since the last step and clear the sums in ``nav``; none, if no time passed.

    The transition is of second order in the step and a congruence, so ``P`` stays exactly symmetric and, up to
    rounding, positive definite. Noise is integrated by the trapezoidal rule. Attitude is taken in the middle of the
    step, specific force as its mean.
    """
    if nav[SUM_TIME] > 0.0:
        covariance_step_in(nav, P, constants, scratch(P.shape[0]))


@inlined
def covariance_step_in(nav, P, constants, space):
    """``covariance_step`` over a time above zero, with work ``space`` from ``scratch``: nothing is allocated."""
    n = P.shape[0]
    T = float(nav[SUM_TIME])
    f_n = scale(1.0 / T, load3(nav, SUM_FORCE))
    turn = load3(nav, SUM_RATE)
    C = q_columns(q_multiply(load4(nav, QUAT), q_exp(scale(-0.5, turn))))
    F = space[:n]
    F[:] = 0.0
    fill_system_matrix(F, nav, constants, f_n, scale(1.0 / T, turn), C)
    propagate_in(P, F, constants, T, space[n:])
    fade_gnss_error(nav, constants, T)
    for i in range(D_GYRO_BIAS, D_GYRO_BIAS + 3):
        P[i, i] += nav[GYRO_WANDER] * T
    if nav[SUM_GAP] > 0.0:
        _add_gap(P, constants, nav[SUM_GAP])
        nav[SUM_GAP] = 0.0
    nav[SUM_TIME] = 0.0
    store3(nav, SUM_FORCE, (0.0, 0.0, 0.0))
    store3(nav, SUM_RATE, (0.0, 0.0, 0.0))
