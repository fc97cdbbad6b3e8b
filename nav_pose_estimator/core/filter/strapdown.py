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
    DPOS,
    GAP_DT,
    GNSS_DELAY_SD,
    GNSS_VEL,
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
    less_product,
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
    # After a gap the sample does not represent the interval; the mean of both ends is the better estimate.
    gap = dt > constants[GAP_DT]
    if gap:
        nav[SUM_GAP] += dt
    is_mean = not gap and constants[POINT_SAMPLED] == 0.0
    turn, push = _body_increments(load3(nav, PREV_RATE), load3(nav, PREV_FORCE), rate, force, dt, is_mean)
    _navigate(nav, turn, push, dt)
    store3(nav, PREV_RATE, rate)
    store3(nav, PREV_FORCE, force)
    nav[TIME] = t
    return nav[SUM_TIME] + 0.5 * dt >= constants[COV_PERIOD]


@kernel
def unaided_velocities(nav, constants, rows, lever, out, angle):
    """Propagate ``nav`` without covariance over IMU ``rows`` (N, 7) of about a second, the first later than ``nav``.

    ``out`` (N, 4) receives time and velocity in n of the point at lever arm ``lever`` (3,) [m] in b from the IMU.
    ``angle`` (3,) [rad] is increased by the integral of the rate over all rows but the first. Latitude and gravity are
    those of the first row: that changes the horizontal velocity by less than 1e-8 m/s in a second at 30 m/s.
    """
    arm, disturbance = load3(lever, 0), load3(nav, GRAVITY)
    motion, earth = _motion(nav), _earth(float(nav[LAT]), float(nav[ALT]))
    last_rate, last_force, t = load3(nav, PREV_RATE), load3(nav, PREV_FORCE), float(nav[TIME])
    for i in range(len(rows)):
        gyro, now = load3(rows[i], IMU_GYRO), float(rows[i, IMU_T])
        dt, t = now - t, now
        for k in range(3):
            angle[k] += dt * gyro[k] if i > 0 else 0.0
        rate = corrected_rate(nav, constants, gyro)
        force = add_scaled(load3(rows[i], IMU_ACCEL), -1.0, load3(nav, ACCEL_BIAS))
        is_mean = dt <= constants[GAP_DT] and constants[POINT_SAMPLED] == 0.0
        turn, push = _body_increments(last_rate, last_force, rate, force, dt, is_mean)
        motion, _ = _advanced(motion, turn, push, dt, earth, disturbance)
        last_rate, last_force = rate, force
        swing = q_rotate(motion[2], cross(rate, arm))
        out[i, 0] = t
        for k in range(3):
            out[i, 1 + k] = motion[1][k] + swing[k]
    _store_motion(nav, motion)
    store3(nav, PREV_RATE, last_rate)
    store3(nav, PREV_FORCE, last_force)
    nav[TIME] = t


@inlined
def note_gnss(nav):
    """Keep the velocity of the present GNSS observation: a latency displaces the position along it, also in an outage.

    The latency is a consider parameter (S. Schmidt, Advances in Control Systems 3, 1966): the filter does not estimate
    it, and what it may do to the position is added to the covariance of every solution (``displaced_by``).
    """
    for i in range(3):
        nav[GNSS_VEL + i] = nav[VEL + i]


@inlined
def displaced_by(nav, constants, axis):
    """Displacement [m] along an ENU ``axis`` by one standard deviation of the latency of GNSS."""
    return constants[GNSS_DELAY_SD] * nav[GNSS_VEL + axis]


@inlined
def write_output(nav, constants, P, out, row):
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
    for i in range(3):
        out[row, OUT_VAR + DPOS + i] += displaced_by(nav, constants, i) ** 2


@inlined
def corrected_rate(nav, constants, gyro):
    """Angular rate (3,) without bias and, where its states are in use, the gyro matrix: (I - M)(gyro - bias)."""
    rate = add_scaled(gyro, -1.0, load3(nav, GYRO_BIAS))
    if constants[I_GYRO_MATRIX] < 0.0:
        return rate
    return less_product(rate, nav, GYRO_MATRIX)


@inlined
def _body_increments(last_rate, last_force, rate, force, dt, is_mean):
    """Rotation vector [rad] and velocity increment [m/s] over the interval, both in b at its start.

    ``is_mean``: rate and force are means over the interval; otherwise they are those of its end.
    """
    coning = cross(last_rate, rate)
    sculling = add(cross(last_rate, force), cross(last_force, rate))
    if not is_mean:
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
def _motion(nav):
    """Latitude, longitude, height; velocity; attitude; last acceleration."""
    place = (float(nav[LAT]), float(nav[LON]), float(nav[ALT]))
    return place, load3(nav, VEL), load4(nav, QUAT), load3(nav, PREV_ACCEL)


@inlined
def _store_motion(nav, motion):
    place, v, q, accel = motion
    store3(nav, LAT, place)
    store3(nav, VEL, v)
    store4(nav, QUAT, q)
    store3(nav, PREV_ACCEL, accel)


@inlined
def _earth(lat, h):
    """Sine and cosine of the latitude, the reciprocals of both radii of curvature plus height [1/m], gravity."""
    s = math.sin(lat)
    c = max(math.cos(lat), MIN_COS_LAT)
    w2 = 1.0 - E2 * s * s
    R_N = A / math.sqrt(w2)
    return s, c, 1.0 / (R_N * (1.0 - E2) / w2 + h), 1.0 / (R_N + h), gravity_from_sine(s * s, h)


@inlined
def _navigate(nav, turn, push, dt):
    """Advance attitude, velocity and position over ``dt`` [s] by the body increments; add to the covariance's sums."""
    motion = _motion(nav)
    (lat, _, h), v, _, last_accel = motion
    # State in the middle of the interval; the equatorial radius is accurate enough to extrapolate half a step.
    half = 0.5 * dt
    earth = _earth(
        lat + half * (v[1] + half * last_accel[1]) / (A + h),
        h + half * (v[2] + half * last_accel[2]),
    )
    motion, dv_f = _advanced(motion, turn, push, dt, earth, load3(nav, GRAVITY))
    _store_motion(nav, motion)
    nav[SUM_TIME] += dt
    store3(nav, SUM_FORCE, add(load3(nav, SUM_FORCE), dv_f))
    store3(nav, SUM_RATE, add(load3(nav, SUM_RATE), turn))


@inlined
def _advanced(motion, turn, push, dt, earth, disturbance):
    """``motion`` after ``dt`` [s], and the specific force's velocity increment in n [m/s].

    ``earth``: of the middle of the interval; ``disturbance`` (3,) of gravity [m/s^2].
    """
    (lat, lon, h), v, q, last_accel = motion
    s, c, i_m, i_n, gravity = earth
    half = 0.5 * dt
    v_mid = add_scaled(v, half, last_accel)
    w_ie = (0.0, OMEGA * c, OMEGA * s)
    w_en = (-v_mid[1] * i_m, v_mid[0] * i_n, v_mid[0] * i_n * s / c)

    level_turn = scale(dt, add(w_ie, w_en))
    dv_f = q_rotate(q, push)
    dv_f = add_scaled(dv_f, -0.5, cross(level_turn, dv_f))
    coriolis = cross(add_scaled(w_en, 2.0, w_ie), v_mid)
    accel = add_scaled(scale(1.0 / dt, dv_f), -1.0, coriolis)
    accel = (accel[0], accel[1], accel[2] - gravity)
    accel = add(accel, disturbance)
    v_end = add_scaled(v, dt, accel)

    place = (
        lat + half * (v[1] + v_end[1]) * i_m,
        _wrapped(lon + half * (v[0] + v_end[0]) * i_n / c),
        h + half * (v[2] + v_end[2]),
    )
    # n rotates so little in one interval that first order is exact after normalisation.
    level = (1.0, -0.5 * level_turn[0], -0.5 * level_turn[1], -0.5 * level_turn[2])
    return (place, v_end, q_polish(q_multiply(level, q_multiply(q, q_exp(turn)))), accel), dv_f


@inlined
def _wrapped(lon):
    """Longitude wrapped to [-pi, pi] from at most one turn outside."""
    if lon > math.pi:
        return lon - 2.0 * math.pi
    if lon < -math.pi:
        return lon + 2.0 * math.pi
    return lon
