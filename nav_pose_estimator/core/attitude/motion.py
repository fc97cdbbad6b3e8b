"""Common parts of both attitude filters: start, integration, detection of rest, rejection of acceleration, aiding.

Kernels on the state vector of ``core.attitude.layout``.
"""

import math

from nav_pose_estimator.core.attitude.layout import (
    AGE,
    BIAS,
    BIAS_LIMIT,
    BODY_VELOCITY,
    COLUMNS,
    COV,
    EXTRA_PSD,
    FIELD_COUNT,
    FIELD_H,
    FORCE,
    FORCE_BIAS,
    FROZEN,
    GAP_DT,
    GAP_RATE_SD,
    GRAVITY,
    IRON_AXES,
    IRON_FIELD,
    IRON_TIME,
    IRON_USED,
    LEARN_PSD,
    LOW_FORCE,
    MATRIX,
    MEAN_FORCE,
    MEAN_RATE,
    MOTION,
    NAV_ACCEL,
    NAV_HEADING_VAR,
    NAV_HOLD,
    NAV_SPEED,
    OFFSET_TIME,
    PLACE_VAR,
    POINT,
    QUAT,
    RATE,
    REJECT_FROM,
    REJECT_TO,
    STILL_FORCE,
    STILL_NORM,
    STILL_RATE,
    STILL_TIME,
    SUM_FIELD,
    SUM_FORCE,
    SUM_FORCE_N,
    SUM_FORCE_SQUARE,
    SUM_RATE,
    SUM_RATE_SQUARE,
    SUM_SWEEP,
    SUM_TIME,
    SUM_TURN,
    SUM_WALK,
    SWAY,
    SWAY_LOW,
    SWAY_TILT,
    SWAY_VAR,
    TIMING_SD,
    TRUST,
    TURN_PSD,
    WANDER_PSD,
)
from nav_pose_estimator.core.numerics.jit import inlined, kernel
from nav_pose_estimator.core.numerics.vectors import (
    add_scaled,
    cross,
    dot,
    less_product,
    load3,
    load4,
    q_columns,
    q_exp,
    q_multiply,
    q_polish,
    q_rotate,
    scale,
    store3,
    store4,
)

_MEAN_TAU = 0.5  # s: smoothing of rate and force for the rest detector
_LOW_TAU = 2.0  # s: low-pass of the force in n for the rejection
_MIN_TRUST = 1e-3  # minimum of the rejection function p(a)
_MOVING = 0.5  # m/s: a vehicle with a larger speed from the navigator is not at rest
# First indices of all horizontal vectors in n, which rotate with the heading.
_OF_N = (
    SWAY, SWAY_LOW, LOW_FORCE, SUM_FORCE_N, SUM_FIELD, SUM_SWEEP, NAV_ACCEL, BODY_VELOCITY,
    COLUMNS, COLUMNS + 3, COLUMNS + 6, IRON_FIELD, IRON_AXES, IRON_AXES + 3, IRON_AXES + 6,
)  # fmt: skip
_LASTING_SHARE = 0.16  # fraction of PLACE_VAR that turning of the vehicle does not average out
_SURE = 9.0  # squared normalised rate above which the vehicle is not at rest: three standard deviations


@kernel
def begin(s, w, f):
    """Start with the first sample: roll and pitch from the specific force, yaw zero (x axis towards East)."""
    norm = math.sqrt(dot(f, f))
    up = scale(1.0 / norm, f) if norm > 0.0 else (0.0, 0.0, 1.0)
    roll, pitch = math.atan2(up[1], up[2]), math.atan2(-up[0], math.sqrt(up[1] * up[1] + up[2] * up[2]))
    cr, sr, cp, sp = math.cos(0.5 * roll), math.sin(0.5 * roll), math.cos(0.5 * pitch), math.sin(0.5 * pitch)
    q = (cr * cp, sr * cp, cr * sp, -sr * sp)
    store4(s, QUAT, q)
    store3(s, RATE, add_scaled(w, -1.0, load3(s, BIAS)))
    store3(s, FORCE, f)
    store3(s, MEAN_RATE, w)
    store3(s, MEAN_FORCE, f)
    store3(s, LOW_FORCE, (0.0, 0.0, norm))
    store3(s, SWAY, (0.0, 0.0, 0.0))
    s[AGE], s[STILL_TIME], s[TRUST], s[MOTION] = 0.0, 0.0, 1.0, 0.0
    s[NAV_HOLD], s[NAV_SPEED], s[NAV_HEADING_VAR] = -1.0, -1.0, 0.0
    s[IRON_TIME] = s[OFFSET_TIME] = -math.inf
    clear_sums(s)


@inlined
def clear_sums(s):
    """Begin a new window of sums at the current attitude."""
    for i in range(SUM_TIME, COLUMNS):
        s[i] = 0.0
    store3(s, SUM_SWEEP, (0.0, 0.0, 0.0))
    columns = q_columns(load4(s, QUAT))
    store3(s, COLUMNS, columns[0])
    store3(s, COLUMNS + 3, columns[1])
    store3(s, COLUMNS + 6, columns[2])


@inlined
def propagate(s, dt, w, f):
    """Integrate one sample: raw rate ``w`` [rad/s] and specific force ``f`` [m/s^2] in b, over the last ``dt`` [s]."""
    s[AGE] += dt
    rate = less_product(add_scaled(w, -1.0, load3(s, BIAS)), s, MATRIX)
    force = add_scaled(f, -1.0, load3(s, FORCE_BIAS))
    if s[POINT] > 0.0:  # trapezoidal rule; the force belongs to the end of the interval
        turn, at_end = scale(0.5 * dt, add_scaled(rate, 1.0, load3(s, RATE))), force
    else:  # the mean force belongs to the middle of the interval: rotate it to the axes at the end
        turn, at_end = scale(dt, rate), add_scaled(force, -0.5 * dt, cross(rate, force))
    q = q_polish(q_multiply(load4(s, QUAT), q_exp(turn)))
    store4(s, QUAT, q)
    store3(s, RATE, rate)
    store3(s, FORCE, f)
    f_n = q_rotate(q, at_end)
    s[NAV_HOLD] -= dt
    if s[NAV_HOLD] < 0.0:
        store3(s, NAV_ACCEL, (0.0, 0.0, 0.0))
        s[NAV_SPEED] = -1.0
    for i in range(3):
        s[SWAY + i] += dt * (f_n[i] - s[NAV_ACCEL + i])
        s[SUM_RATE + i] += dt * w[i]
        s[SUM_FORCE + i] += dt * f[i]
        s[SUM_TURN + i] += turn[i]
        s[SUM_FORCE_N + i] += dt * f_n[i]
    s[SWAY + 2] -= dt * s[GRAVITY]
    gap = s[GAP_RATE_SD] * dt if dt > s[GAP_DT] else 0.0
    square = dot(w, w)
    s[SUM_WALK] += (s[WANDER_PSD] + s[EXTRA_PSD] + s[TURN_PSD] * square) * dt + gap * gap
    s[SUM_TIME] += dt
    s[SUM_RATE_SQUARE] += dt * square
    s[SUM_FORCE_SQUARE] += dt * dot(f, f)


@inlined
def watch_rest(s):
    """Detection of rest: count the seconds without motion, from the window of sums that just ended."""
    window = s[SUM_TIME]
    gain = window / (_MEAN_TAU + window)
    rate_spread, force_spread, still = s[SUM_RATE_SQUARE] / window, s[SUM_FORCE_SQUARE] / window, s[FROZEN] == 0.0
    for i in range(3):
        # mean square about the smoothed mean: E[x^2] - 2 m E[x] + m^2
        rate, force, m, n = s[SUM_RATE + i] / window, s[SUM_FORCE + i] / window, s[MEAN_RATE + i], s[MEAN_FORCE + i]
        rate_spread += m * (m - 2.0 * rate)
        force_spread += n * (n - 2.0 * force)
        s[MEAN_RATE + i] += gain * (rate - m)
        s[MEAN_FORCE + i] += gain * (force - n)
        still = still and abs(s[MEAN_RATE + i]) < s[BIAS_LIMIT]
    mean = load3(s, MEAN_FORCE)
    still = still and rate_spread < s[STILL_RATE] ** 2 and force_spread < s[STILL_FORCE] ** 2
    still = still and abs(math.sqrt(dot(mean, mean)) - s[GRAVITY]) < s[STILL_NORM] and s[NAV_SPEED] < _MOVING
    s[STILL_TIME] = s[STILL_TIME] + window if still else 0.0
    turn = load3(s, SUM_TURN)
    s[MOTION] += window / (1.0 + window) * (math.sqrt(dot(turn, turn)) / window - s[MOTION])


@inlined
def doubt_rest(s, x, y, z):
    """Reject rest where the bias, with variances ``x``, ``y``, ``z``, does not explain the mean rate: it is a turn.

    Smooth flight in a wide circle is as free of vibration as a parked vehicle. A bias that is still unknown explains
    any rate within ``BIAS_LIMIT``.
    """
    variances = (x, y, z)
    for i in range(3):
        residual, known = s[MEAN_RATE + i] - s[BIAS + i], _SURE * variances[i] < (0.5 * s[BIAS_LIMIT]) ** 2
        if known and residual * residual > _SURE * (variances[i] + s[LEARN_PSD]):  # of a mean over about one second
            s[STILL_TIME] = 0.0


@inlined
def watch_acceleration(s):
    """Rejection function p(a) of the norm of the specific force low-passed in n: a ramp from 1 to ``_MIN_TRUST``."""
    window = s[SUM_TIME]
    gain = window / (_LOW_TAU + window)
    for i in range(3):
        residual = s[SUM_FORCE_N + i] / window - s[NAV_ACCEL + i]
        s[LOW_FORCE + i] += gain * (residual - s[LOW_FORCE + i])
    low = load3(s, LOW_FORCE)
    off = abs(math.sqrt(dot(low, low)) - s[GRAVITY])
    s[TRUST] = min(max((s[REJECT_TO] - off) / (s[REJECT_TO] - s[REJECT_FROM]), _MIN_TRUST), 1.0)
    if s[FROZEN] > 0.0:
        s[TRUST] = _MIN_TRUST


@inlined
def turn_in_n(s, v):
    """q <- Exp(v) (x) q: rotate the estimate by the rotation vector ``v`` [rad] in n."""
    store4(s, QUAT, q_polish(q_multiply(q_exp(v), load4(s, QUAT))))


@kernel
def turn_heading(s, angle):
    """Rotate attitude and all stored vectors in n by ``angle`` [rad] counter-clockwise about the vertical."""
    turn_in_n(s, (0.0, 0.0, angle))
    c, d = math.cos(angle), math.sin(angle)
    for i in _OF_N:
        x, y = s[i], s[i + 1]
        s[i], s[i + 1] = c * x - d * y, d * x + c * y


@inlined
def write_covariance(s, P):
    """Write the covariance of the head: the filter's own ``P`` [:3, :3] plus three unmodelled errors.

    These are the rate times an unknown delay of the sensor, the tilt caused by lasting acceleration, and the part of
    the local magnetic deviation that turning does not average out.
    """
    r = q_rotate(load4(s, QUAT), load3(s, RATE))
    delay = s[TIMING_SD] * s[TIMING_SD]
    for i in range(3):
        for j in range(3):
            s[COV + 3 * i + j] = P[i, j] + delay * r[i] * r[j]
    lasting = s[SWAY_TILT] * s[SWAY_TILT] * s[SWAY_VAR]
    s[COV] += lasting
    s[COV + 4] += lasting
    if s[FIELD_H] > 0.0:
        s[COV + 8] += _LASTING_SHARE * s[PLACE_VAR]


@inlined
def write_row(s, out, row):
    """Write the estimate to ``out`` [row]: attitude (4), larger variance of tilt, variance of heading, bias (3)."""
    for i in range(4):
        out[row, i] = s[QUAT + i]
    out[row, 4] = max(s[COV], s[COV + 4])
    out[row, 5] = s[COV + 8]
    for i in range(3):
        out[row, 6 + i] = s[BIAS + i]


@kernel
def subtract_velocity_change(s, dv, dt, hold, speed):
    """Aiding: the vehicle's velocity changed by ``dv`` (3) [m/s, n] in the last ``dt`` [s]; its ``speed`` [m/s].

    This acceleration is assumed to continue for another ``hold`` [s]. The next call corrects the difference to the true
    change, so that the total subtracted from the sway is exact at any rate of calls.
    """
    for i in range(3):
        s[SWAY + i] -= dv[i] - (s[NAV_ACCEL + i] * dt if s[NAV_HOLD] >= 0.0 else 0.0)
        s[NAV_ACCEL + i] = dv[i] / dt
    s[NAV_HOLD], s[NAV_SPEED] = hold, speed


@kernel
def take_body_velocity(s, x, y, z, dt, hold):
    """Aiding by a velocity (x, y, z) [m/s, b], ``dt`` [s] after the last one; ``dt`` <= 0: the last one is too old."""
    now, before = q_rotate(load4(s, QUAT), (x, y, z)), load3(s, BODY_VELOCITY)
    store3(s, BODY_VELOCITY, now)
    if dt > 0.0:
        subtract_velocity_change(s, add_scaled(now, -1.0, before), dt, hold, math.sqrt(dot(now, now)))


@inlined
def add_field(s, m):
    """Add a magnetic field ``m`` (3) in b, any unit, to the sums of the window."""
    q, m = load4(s, QUAT), add_scaled(m, -1.0, load3(s, IRON_USED))
    m_n, sweep = q_rotate(q, m), q_rotate(q, cross(load3(s, RATE), m))
    for i in range(3):
        s[SUM_FIELD + i] += m_n[i]
        s[SUM_SWEEP + i] += sweep[i]
    s[FIELD_COUNT] += 1.0
