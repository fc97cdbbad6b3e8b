"""Complementary attitude filter with proportional-integral feedback (CN113777645A, claims 1 and 2), scalar kernels.

The kinematics ``dq/dt = q (w - b + delta) / 2`` are driven by the gyroscope. The feedback ``delta`` turns the
estimate until the specific force, low-passed in the earth frame, points up:

    s'      = (p f_n - s) / tau               f_n = C_nb f_b (less the navigator's acceleration where there is one)
    delta_n = kp (s x up) / g                 the mean of f_n is gravity; that of f_n / |f_n| is not

The low-pass and the feedback form a second-order loop of natural frequency ``sqrt(kp / tau)``. The gyro bias (the
integral part) is learned at rest. A magnetometer turns the estimate about the vertical only.
"""

import math

from nav_pose_estimator.core.attitude_layout import BIAS, COV, FORCE, HEAD_SIZE, QUAT, RATE
from nav_pose_estimator.core.jit import kernel

AGE = HEAD_SIZE  # s since start
LEAN = AGE + 1  # 3: low-passed residual specific force in n, less gravity, m/s^2
NAV_ACCEL = LEAN + 3  # 3: acceleration of the vehicle in n as the navigator sees it, m/s^2
NAV_HOLD = NAV_ACCEL + 3  # s for which NAV_ACCEL is still believed
REST_RATE = NAV_HOLD + 1  # 3: low-passed raw rate, rad/s
REST_FORCE = REST_RATE + 3  # 3: low-passed raw force, m/s^2
REST_TIME = REST_FORCE + 3  # s at rest so far
BIAS_VAR = REST_TIME + 1  # (rad/s)^2 per axis
TILT_VAR = BIAS_VAR + 1  # rad^2 per axis
YAW_VAR = TILT_VAR + 1
FIELD_NORM = YAW_VAR + 1  # learned norm of the magnetic field, 0 before the first sample
FIELD_DIP = FIELD_NORM + 1  # learned dip, rad, positive down
MAG_AGE = FIELD_DIP + 1  # s of magnetometer data used
MAG_TIME = MAG_AGE + 1  # AGE at the last magnetometer sample
MAG_WEIGHT = MAG_TIME + 1  # 0 disturbed ... 1 undisturbed, of the last sample
KP = MAG_WEIGHT + 1  # 1/s
TAU = KP + 1  # s
GRAVITY = TAU + 1  # m/s^2
REJECT_FROM = GRAVITY + 1  # m/s^2: the feedback begins to fade at this low-passed norm error ...
REJECT_TO = REJECT_FROM + 1  # ... and is gone at this one
REST_RATE_LIMIT = REJECT_TO + 1  # rad/s
REST_FORCE_LIMIT = REST_RATE_LIMIT + 1  # m/s^2
REST_AFTER = REST_FORCE_LIMIT + 1  # s
BIAS_LIMIT = REST_AFTER + 1  # rad/s
TAU_MAG = BIAS_LIMIT + 1  # s
NORM_SD = TAU_MAG + 1  # relative
DIP_SD = NORM_SD + 1  # rad
GYRO_PSD = DIP_SD + 1  # (rad/s)^2/Hz
BIAS_PSD = GYRO_PSD + 1  # (rad/s)^2/s
ACCEL_SD = BIAS_PSD + 1  # m/s^2: typical unmodelled acceleration after the low-pass
SIZE = ACCEL_SD + 1


@kernel
def start(s, wx, wy, wz, fx, fy, fz):
    """Begin with the first sample: level by the specific force, yaw 0 (x axis as near to East as it can be)."""
    norm = math.sqrt(fx * fx + fy * fy + fz * fz)
    if norm < 1e-3:
        fx, fy, fz, norm = 0.0, 0.0, 1.0, 1.0
    roll, pitch = math.atan2(fy, fz), math.atan2(-fx, math.sqrt(fy * fy + fz * fz))
    cr, sr, cp, sp = math.cos(roll / 2), math.sin(roll / 2), math.cos(pitch / 2), math.sin(pitch / 2)
    s[QUAT], s[QUAT + 1], s[QUAT + 2], s[QUAT + 3] = cr * cp, sr * cp, cr * sp, -sr * sp
    s[AGE] = 0.0
    s[LEAN] = s[LEAN + 1] = s[LEAN + 2] = 0.0
    s[NAV_HOLD] = -1.0
    s[RATE], s[RATE + 1], s[RATE + 2] = wx - s[BIAS], wy - s[BIAS + 1], wz - s[BIAS + 2]
    s[FORCE], s[FORCE + 1], s[FORCE + 2] = fx, fy, fz
    s[REST_RATE], s[REST_RATE + 1], s[REST_RATE + 2] = wx, wy, wz
    s[REST_FORCE], s[REST_FORCE + 1], s[REST_FORCE + 2] = fx, fy, fz
    s[REST_TIME] = 0.0
    s[TILT_VAR] = (s[ACCEL_SD] / s[GRAVITY]) ** 2 + 1e-4
    s[YAW_VAR] = math.pi * math.pi / 3.0
    s[MAG_AGE] = 0.0
    s[FIELD_NORM] = 0.0
    _write_covariance(s)


@kernel
def step(s, dt, wx, wy, wz, fx, fy, fz):
    """Propagate by one IMU sample: rate [rad/s] and specific force [m/s^2] in b, means over the ``dt`` [s] before it.

    The first sample after the vector was made (``AGE`` negative) starts the filter.
    """
    if s[AGE] < 0.0:
        start(s, wx, wy, wz, fx, fy, fz)
        return
    s[AGE] += dt
    _learn_at_rest(s, dt, wx, wy, wz, fx, fy, fz)
    wx, wy, wz = wx - s[BIAS], wy - s[BIAS + 1], wz - s[BIAS + 2]
    s[RATE], s[RATE + 1], s[RATE + 2] = wx, wy, wz
    s[FORCE], s[FORCE + 1], s[FORCE + 2] = fx, fy, fz
    _turn_in_b(s, wx * dt, wy * dt, wz * dt)
    _feed_back(s, dt, fx, fy, fz)
    s[TILT_VAR] += (s[GYRO_PSD] + s[BIAS_VAR] * dt) * dt
    s[YAW_VAR] = min(s[YAW_VAR] + (s[GYRO_PSD] + s[BIAS_VAR] * dt) * dt, math.pi * math.pi / 3.0)
    _write_covariance(s)


@kernel
def _turn_in_b(s, ax, ay, az):
    """q <- q (x) Exp(a), a rotation vector [rad] in b."""
    a, b, c, d = s[QUAT], s[QUAT + 1], s[QUAT + 2], s[QUAT + 3]
    square = 0.25 * (ax * ax + ay * ay + az * az)
    if square < 1e-3:
        w, k = 1.0 - square * (0.5 - square / 24.0), 0.5 - square * (1.0 / 12.0 - square / 240.0)
    else:
        half = math.sqrt(square)
        w, k = math.cos(half), 0.5 * math.sin(half) / half
    x, y, z = k * ax, k * ay, k * az
    s[QUAT] = a * w - b * x - c * y - d * z
    s[QUAT + 1] = a * x + b * w + c * z - d * y
    s[QUAT + 2] = a * y - b * z + c * w + d * x
    s[QUAT + 3] = a * z + b * y - c * x + d * w


@kernel
def _turn_in_n(s, x, y, z):
    """q <- Exp(a) (x) q for a small rotation vector (x, y, z) [rad] in n, and normalise."""
    a, b, c, d = s[QUAT], s[QUAT + 1], s[QUAT + 2], s[QUAT + 3]
    x, y, z = 0.5 * x, 0.5 * y, 0.5 * z
    w = math.sqrt(max(1.0 - x * x - y * y - z * z, 0.0))
    qa, qb = w * a - x * b - y * c - z * d, w * b + x * a + y * d - z * c
    qc, qd = w * c - x * d + y * a + z * b, w * d + x * c - y * b + z * a
    scale = 1.0 / math.sqrt(qa * qa + qb * qb + qc * qc + qd * qd)
    s[QUAT], s[QUAT + 1], s[QUAT + 2], s[QUAT + 3] = qa * scale, qb * scale, qc * scale, qd * scale


@kernel
def _to_n(s, x, y, z):
    """C_nb v."""
    a, b, c, d = s[QUAT], s[QUAT + 1], s[QUAT + 2], s[QUAT + 3]
    return (
        (a * a + b * b - c * c - d * d) * x + 2.0 * (b * c - a * d) * y + 2.0 * (b * d + a * c) * z,
        2.0 * (b * c + a * d) * x + (a * a - b * b + c * c - d * d) * y + 2.0 * (c * d - a * b) * z,
        2.0 * (b * d - a * c) * x + 2.0 * (c * d + a * b) * y + (a * a - b * b - c * c + d * d) * z,
    )


@kernel
def _feed_back(s, dt, fx, fy, fz):
    ax, ay, az = _to_n(s, fx, fy, fz)
    gravity, age = s[GRAVITY], max(s[AGE], dt)
    s[NAV_HOLD] -= dt
    if s[NAV_HOLD] < 0.0:
        s[NAV_ACCEL] = s[NAV_ACCEL + 1] = s[NAV_ACCEL + 2] = 0.0
    gain = dt / min(s[TAU] + dt, age + dt)
    s[LEAN] += gain * (ax - s[NAV_ACCEL] - s[LEAN])
    s[LEAN + 1] += gain * (ay - s[NAV_ACCEL + 1] - s[LEAN + 1])
    s[LEAN + 2] += gain * (az - s[NAV_ACCEL + 2] - gravity - s[LEAN + 2])
    up = s[LEAN + 2] + gravity
    off = abs(math.sqrt(s[LEAN] * s[LEAN] + s[LEAN + 1] * s[LEAN + 1] + up * up) - gravity)
    trust = min(max((s[REJECT_TO] - off) / (s[REJECT_TO] - s[REJECT_FROM]), 0.0), 1.0)
    turn = trust * max(s[KP], 1.0 / (age + s[TAU])) * dt
    _turn_in_n(s, turn * s[LEAN + 1] / gravity, -turn * s[LEAN] / gravity, 0.0)
    noise = (s[ACCEL_SD] / gravity) ** 2
    s[TILT_VAR] += 2.0 * turn * (noise - s[TILT_VAR])


@kernel
def subtract_velocity_change(s, dvx, dvy, dvz, dt, hold):
    """Tell the filter that the vehicle's velocity changed by (dvx, dvy, dvz) [m/s, n] in the last ``dt`` [s].

    That acceleration is believed for another ``hold`` seconds; what it missed or had too much is made good at the
    next call. So the low-pass sees the true velocity change, whatever the rate of the calls.
    """
    gain = 1.0 / max(s[TAU], dt)
    for i in range(3):
        change = dvx if i == 0 else dvy if i == 1 else dvz
        s[LEAN + i] -= gain * (change - s[NAV_ACCEL + i] * dt)
        s[NAV_ACCEL + i] = change / dt
    s[NAV_HOLD] = hold


@kernel
def _learn_at_rest(s, dt, wx, wy, wz, fx, fy, fz):
    gain = dt / (0.5 + dt)
    dw, df = 0.0, 0.0
    for i in range(3):
        rate, force = (wx, fx) if i == 0 else (wy, fy) if i == 1 else (wz, fz)
        s[REST_RATE + i] += gain * (rate - s[REST_RATE + i])
        s[REST_FORCE + i] += gain * (force - s[REST_FORCE + i])
        dw += (rate - s[REST_RATE + i]) ** 2
        df += (force - s[REST_FORCE + i]) ** 2
    still = dw < s[REST_RATE_LIMIT] ** 2 and df < s[REST_FORCE_LIMIT] ** 2
    for i in range(3):
        still = still and abs(s[REST_RATE + i]) < s[BIAS_LIMIT]
    s[REST_TIME] = s[REST_TIME] + dt if still else 0.0
    s[BIAS_VAR] += s[BIAS_PSD] * dt
    if s[REST_TIME] < s[REST_AFTER]:
        return
    noise = s[GYRO_PSD] + 1e-10  # of a mean over one second at rest
    gain = s[BIAS_VAR] * dt / (s[BIAS_VAR] * dt + noise)
    for i in range(3):
        s[BIAS + i] += gain * (s[REST_RATE + i] - s[BIAS + i])
    s[BIAS_VAR] *= 1.0 - gain


@kernel
def correct_heading(s, mx, my, mz):
    """Turn the estimate about the vertical so that the horizontal field (mx, my, mz in b, any unit) points North."""
    east, north, up = _to_n(s, mx, my, mz)
    horizontal = math.sqrt(east * east + north * north)
    norm = math.sqrt(horizontal * horizontal + up * up)
    if norm <= 0.0 or horizontal < 0.05 * norm:
        s[MAG_WEIGHT] = 0.0
        return
    dip, dt = math.atan2(-up, horizontal), s[AGE] - s[MAG_TIME] if s[MAG_AGE] > 0.0 else 0.0
    s[MAG_TIME] = s[AGE]
    error = math.atan2(east, north)
    if s[FIELD_NORM] == 0.0:
        s[FIELD_NORM], s[FIELD_DIP], s[MAG_AGE], s[MAG_WEIGHT] = norm, dip, 1e-3, 1.0
        _turn_heading(s, error)
        s[YAW_VAR] = 0.01
        _write_covariance(s)
        return
    a, b = (norm / s[FIELD_NORM] - 1.0) / s[NORM_SD], (dip - s[FIELD_DIP]) / s[DIP_SD]
    weight = math.exp(-0.5 * (a * a + b * b))
    s[MAG_WEIGHT] = weight
    gain = min(weight * dt / min(s[TAU_MAG], s[MAG_AGE] + dt), 1.0)
    s[MAG_AGE] += weight * dt
    _turn_heading(s, gain * error)
    slow = weight * dt / min(s[MAG_AGE] + dt, 20.0)
    s[FIELD_NORM] += slow * (norm - s[FIELD_NORM])
    s[FIELD_DIP] += slow * (dip - s[FIELD_DIP])
    s[YAW_VAR] += gain * (2.0 * (0.04**2 - s[YAW_VAR]) + gain * s[YAW_VAR])
    _write_covariance(s)


@kernel
def _turn_heading(s, angle):
    """Turn by ``angle`` [rad] counter-clockwise about the vertical, however large."""
    w, z = math.cos(0.5 * angle), math.sin(0.5 * angle)
    a, b, c, d = s[QUAT], s[QUAT + 1], s[QUAT + 2], s[QUAT + 3]
    s[QUAT], s[QUAT + 1], s[QUAT + 2], s[QUAT + 3] = w * a - z * d, w * b - z * c, w * c + z * b, w * d + z * a
    x, y = s[LEAN], s[LEAN + 1]
    c, d = math.cos(angle), math.sin(angle)
    s[LEAN], s[LEAN + 1] = c * x - d * y, d * x + c * y


@kernel
def _write_covariance(s):
    s[COV] = s[COV + 4] = s[TILT_VAR]
    s[COV + 8] = s[YAW_VAR]


@kernel
def run(s, imu, mag, out):
    """Loop of :func:`step` and :func:`correct_heading`: the batch form, identical to single calls.

    ``imu`` (N, 7): dt, rate, force. ``mag`` (N, 3) or (0, 3): field that follows each IMU sample, NaN for none.
    ``out`` (N, HEAD_SIZE) receives the head of the state after each sample.
    """
    for i in range(len(imu)):
        step(s, imu[i, 0], imu[i, 1], imu[i, 2], imu[i, 3], imu[i, 4], imu[i, 5], imu[i, 6])
        if len(mag) > 0 and not math.isnan(mag[i, 0] + mag[i, 1] + mag[i, 2]):
            correct_heading(s, mag[i, 0], mag[i, 1], mag[i, 2])
        for j in range(HEAD_SIZE):
            out[i, j] = s[j]
