"""Strapdown integration: attitude, velocity and geodetic position from angular rate and specific force.

All functions work in place on ``nav`` (layout in ``filter.layout``) and the covariance ``P`` (n, n), with the filter's
``constants``. IMU rows are ``[t, gyro (3), accel (3)]``: seconds since the engine's epoch, rad/s, m/s^2, body frame.

One interval is integrated by rotation-vector and velocity increments. Their coning and sculling terms use the present
and the previous interval, and are exact for rates and forces that change linearly in time. The rotation of n and the
Coriolis term are evaluated in the middle of the interval at an extrapolated velocity.

A caller that sets a new state must also set the memory: PREV_RATE and PREV_FORCE to the corrected first sample, TIME to
its time. For positions near a pole see ``core.earth.ellipsoid``.

Sources: P. Savage, "Strapdown inertial navigation integration algorithm design", parts 1 and 2, J. Guidance, Control
and Dynamics 21(1, 2), 1998; Groves, second edition, sections 5.5 and 5.6; CN113777645A, step 3 (there with a
first-order Runge-Kutta step).
"""

import math

from nav_pose_estimator.core.earth.ellipsoid import E2, MIN_COS_LAT, OMEGA, A, gravity_from_sine
from nav_pose_estimator.core.filter.error_model import covariance_step
from nav_pose_estimator.core.filter.layout import (
    ACCEL_BIAS,
    ALT,
    COV_PERIOD,
    GAP_DT,
    GRAVITY,
    GYRO_BIAS,
    GYRO_MATRIX,
    I_GYRO_MATRIX,
    IMU_ACCEL,
    IMU_GYRO,
    IMU_T,
    LAT,
    LON,
    OUT_FORCE,
    OUT_POS,
    OUT_QUAT,
    OUT_RATE,
    OUT_T,
    OUT_VAR,
    OUT_VEL,
    POINT_SAMPLED,
    PREV_ACCEL,
    PREV_FORCE,
    PREV_RATE,
    QUAT,
    SUM_FORCE,
    SUM_GAP,
    SUM_RATE,
    SUM_TIME,
    TIME,
    VEL,
)
from nav_pose_estimator.core.numerics.jit import inlined, kernel
from nav_pose_estimator.core.numerics.vectors import (
    add,
    add_scaled,
    cross,
    load3,
    load4,
    q_exp,
    q_multiply,
    q_polish,
    q_rotate,
    scale,
    store3,
    store4,
)


@kernel
def propagate(nav, P, constants, imu_row):
    """Propagate ``nav`` to the time of one IMU row, and ``P`` when its step is due. Rows not later are ignored.

    An interval may be split, for example at the time of a measurement: pass the same values twice if samples are means
    over the interval, interpolated values if they are instantaneous.
    """
    if integrate(nav, constants, imu_row[IMU_T], load3(imu_row, IMU_GYRO), load3(imu_row, IMU_ACCEL)):
        covariance_step(nav, P, constants)


flush_covariance = covariance_step
"""(nav, P, constants): propagate ``P`` to the time of ``nav``, before a measurement or before ``P`` is reported."""


@inlined
def integrate(nav, constants, t, gyro, accel):
    """Propagate ``nav`` to ``t`` [s] with ``gyro`` (3,) [rad/s] and ``accel`` (3,) [m/s^2]; True when P is due.

    The covariance step comes at the sample nearest to its time, so that jitter of the stamps does not delay it by a
    whole sample.
    """
    dt = float(t) - float(nav[TIME])  # float: in plain Python numpy's own scalars cost three times as much
    if not dt > 0.0:
        return False
    rate = corrected_rate(nav, constants, gyro)
    force = add_scaled(accel, -1.0, load3(nav, ACCEL_BIAS))
    turn, push = _body_increments(nav, constants, rate, force, dt)
    _navigate(nav, turn, push, dt)
    store3(nav, PREV_RATE, rate)
    store3(nav, PREV_FORCE, force)
    nav[TIME] = t
    return nav[SUM_TIME] + 0.5 * dt >= constants[COV_PERIOD]


@kernel
def unaided_velocities(nav, constants, rows, lever, out, angle):
    """Propagate ``nav`` without covariance over IMU ``rows`` (N, 7); ``out`` (N, 4) receives time and velocity in n.

    The velocity is that of the point at lever arm ``lever`` (3,) [m] in b from the IMU. ``angle`` (3,) [rad] is
    increased by the integral of the rate over all rows but the first.
    """
    arm = load3(lever, 0)
    for i in range(len(rows)):
        for k in range(3):
            angle[k] += (rows[i, IMU_T] - rows[i - 1, IMU_T]) * rows[i, IMU_GYRO + k] if i > 0 else 0.0
        integrate(nav, constants, rows[i, IMU_T], load3(rows[i], IMU_GYRO), load3(rows[i], IMU_ACCEL))
        swing = q_rotate(load4(nav, QUAT), cross(load3(nav, PREV_RATE), arm))
        out[i, 0] = nav[TIME]
        for k in range(3):
            out[i, 1 + k] = nav[VEL + k] + swing[k]


@inlined
def write_output(nav, P, out, row):
    """Write the state to ``out`` [row] in the order of ``layout``; variances are those of the last covariance step."""
    out[row, OUT_T] = nav[TIME]
    for i in range(3):
        out[row, OUT_POS + i] = nav[LAT + i]
        out[row, OUT_VEL + i] = nav[VEL + i]
        out[row, OUT_RATE + i] = nav[PREV_RATE + i]
        out[row, OUT_FORCE + i] = nav[PREV_FORCE + i]
    for i in range(4):
        out[row, OUT_QUAT + i] = nav[QUAT + i]
    for i in range(9):
        out[row, OUT_VAR + i] = P[i, i]


@inlined
def corrected_rate(nav, constants, gyro):
    """Angular rate (3,) without bias and, where its states are in use, the gyro matrix: (I - M)(gyro - bias)."""
    rate = add_scaled(gyro, -1.0, load3(nav, GYRO_BIAS))
    if constants[I_GYRO_MATRIX] < 0.0:
        return rate
    x = rate[0] - nav[GYRO_MATRIX] * rate[0] - nav[GYRO_MATRIX + 1] * rate[1] - nav[GYRO_MATRIX + 2] * rate[2]
    y = rate[1] - nav[GYRO_MATRIX + 3] * rate[0] - nav[GYRO_MATRIX + 4] * rate[1] - nav[GYRO_MATRIX + 5] * rate[2]
    z = rate[2] - nav[GYRO_MATRIX + 6] * rate[0] - nav[GYRO_MATRIX + 7] * rate[1] - nav[GYRO_MATRIX + 8] * rate[2]
    return x, y, z


@inlined
def _body_increments(nav, constants, rate, force, dt):
    """Rotation vector [rad] and velocity increment [m/s] over the interval, both in b at its start."""
    last_rate = load3(nav, PREV_RATE)
    last_force = load3(nav, PREV_FORCE)
    coning = cross(last_rate, rate)
    sculling = add(cross(last_rate, force), cross(last_force, rate))
    gap = dt > constants[GAP_DT]
    if gap:
        nav[SUM_GAP] += dt
    # After a gap the sample does not represent the interval; the mean of both ends is the better estimate.
    if gap or constants[POINT_SAMPLED] != 0.0:
        rate = scale(0.5, add(last_rate, rate))
        force = scale(0.5, add(last_force, force))
    dt2 = dt * dt
    turn = add_scaled(scale(dt, rate), dt2 / 12.0, coning)
    # Rotation of the body during the interval, to second order: without the second order, 4 g and 3 rad/s leave an
    # error of 16 cm after a minute at 200 Hz; with it 4 mm.
    turned = cross(rate, force)
    push = add_scaled(scale(dt, force), 0.5 * dt2, turned)
    push = add_scaled(push, dt * dt2 / 6.0, cross(rate, turned))
    push = add_scaled(push, dt2 / 12.0, sculling)
    return turn, push


@inlined
def _navigate(nav, turn, push, dt):
    """Advance attitude, velocity and position over ``dt`` [s] by the body increments; add to the covariance's sums."""
    half = 0.5 * dt
    v = load3(nav, VEL)
    q = load4(nav, QUAT)
    h, lat = float(nav[ALT]), float(nav[LAT])
    # State in the middle of the interval; the equatorial radius is accurate enough to extrapolate half a step.
    v_mid = add_scaled(v, half, load3(nav, PREV_ACCEL))
    h_mid = h + half * v_mid[2]
    lat_mid = lat + half * v_mid[1] / (A + h)
    s = math.sin(lat_mid)
    c = max(math.cos(lat_mid), MIN_COS_LAT)
    w2 = 1.0 - E2 * s * s
    R_N = A / math.sqrt(w2)
    i_m = 1.0 / (R_N * (1.0 - E2) / w2 + h_mid)
    i_n = 1.0 / (R_N + h_mid)
    w_ie = (0.0, OMEGA * c, OMEGA * s)
    w_en = (-v_mid[1] * i_m, v_mid[0] * i_n, v_mid[0] * i_n * s / c)

    level_turn = scale(dt, add(w_ie, w_en))
    dv_f = q_rotate(q, push)
    dv_f = add_scaled(dv_f, -0.5, cross(level_turn, dv_f))
    coriolis = cross(add_scaled(w_en, 2.0, w_ie), v_mid)
    accel = add_scaled(scale(1.0 / dt, dv_f), -1.0, coriolis)
    accel = (accel[0], accel[1], accel[2] - gravity_from_sine(s * s, h_mid))
    accel = add(accel, load3(nav, GRAVITY))
    v_end = add_scaled(v, dt, accel)

    nav[LAT] = lat + half * (v[1] + v_end[1]) * i_m
    nav[LON] = _wrapped(float(nav[LON]) + half * (v[0] + v_end[0]) * i_n / c)
    nav[ALT] = h + half * (v[2] + v_end[2])
    # n rotates so little in one interval that first order is exact after normalisation.
    level = (1.0, -0.5 * level_turn[0], -0.5 * level_turn[1], -0.5 * level_turn[2])
    store4(nav, QUAT, q_polish(q_multiply(level, q_multiply(q, q_exp(turn)))))
    store3(nav, VEL, v_end)
    store3(nav, PREV_ACCEL, accel)
    nav[SUM_TIME] += dt
    store3(nav, SUM_FORCE, add(load3(nav, SUM_FORCE), dv_f))
    store3(nav, SUM_RATE, add(load3(nav, SUM_RATE), turn))


@inlined
def _wrapped(lon):
    """Longitude wrapped to [-pi, pi] from at most one turn outside."""
    if lon > math.pi:
        return lon - 2.0 * math.pi
    if lon < -math.pi:
        return lon + 2.0 * math.pi
    return lon
