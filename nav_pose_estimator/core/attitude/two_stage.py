"""Two-stage Kalman attitude filter on the quaternion with adaptive accelerometer noise, as kernels.

The state is the quaternion itself (4). Stage 1 corrects it by the specific force, stage 2 by the magnetometer, which
may change only the heading (two-stage filters: Sabatelli et al., IEEE Trans. Instrum. Meas. 62(3), 2013). A PI
regulator with integral separation adapts the noise R1 of stage 1 to the mismatch between actual and theoretical
covariance of the innovations: R1 grows while the actual one is larger.

Stage 1 uses the specific force low-passed in n, whose mean is the reaction to gravity. Consecutive windows of the
low-passed force are correlated, so ``SHARED`` of them count as one.

``literal`` zeroes the components of the quaternion's correction that the source names (z in stage 1, x and y in stage
2). That means "no change of heading" only near q = 1. The default projects the gain on the derivative of the quaternion
by the heading (stage 2) or off it (stage 1), which is exact at any attitude.
"""

import math

from nav_pose_estimator.core.attitude.heading import observe_heading
from nav_pose_estimator.core.attitude.layout import (
    AGE,
    BIAS,
    FIELD_H,
    GRAVITY,
    LEARN_AFTER,
    LOW_FORCE,
    OWN,
    PERIOD,
    QUAT,
    STILL_TIME,
    SUM_RATE,
    SUM_TIME,
    SUM_TURN,
    SUM_WALK,
    TRUST,
)
from nav_pose_estimator.core.attitude.magnetic_field import FIRST, NOTHING, USUAL, field_anomaly
from nav_pose_estimator.core.attitude.motion import (
    add_field,
    begin,
    clear_sums,
    doubt_rest,
    propagate,
    turn_heading,
    watch_acceleration,
    watch_rest,
    write_covariance,
    write_row,
)
from nav_pose_estimator.core.attitude.navigator_aid import follow_navigator
from nav_pose_estimator.core.numerics.jit import kernel
from nav_pose_estimator.core.numerics.vectors import load3, load4, q_exp, q_multiply, q_rotate_back, store4

COVARIANCE = OWN  # (4, 4) of the quaternion's additive error
GAIN = COVARIANCE + 16  # 4
SPREAD = GAIN + 4  # 4: P h of the current observation
TILT_COV = SPREAD + 4  # (3, 3) of the misalignment about n axes
R1 = TILT_COV + 9  # m^2/s^4: adapted noise variance of the low-passed force
SCATTER = R1 + 1  # m^2/s^4: smoothed actual trace of the innovations' covariance
MISMATCH_SUM = SCATTER + 1  # integral of the regulator
BIAS_AGE = MISMATCH_SUM + 1  # s: equivalent duration in motion of the data behind the bias
R1_START = BIAS_AGE + 1  # constants follow from here; m^2/s^4
REGULATOR_P, REGULATOR_I, REGULATOR_BAND = R1_START + 1, R1_START + 2, R1_START + 3
SHARED = R1_START + 4  # number of windows with correlated noise that count as one
LITERAL = R1_START + 5  # 1: corrections as the source writes them
BIAS_TAU_START, BIAS_TAU = R1_START + 6, R1_START + 7  # s: smoothing of the bias in motion, at first and later
TILT_VAR, HEADING_VAR = R1_START + 8, R1_START + 9  # rad^2 at the start
BIAS_VAR = R1_START + 10  # (rad/s)^2 of the gyroscope bias at the start
SIZE = R1_START + 11

_SCATTER_WINDOWS = 20.0  # windows over which the actual covariance is averaged
_REST_COUNTS = 20.0  # seconds in motion that one second at rest is equivalent to, as evidence of the bias
_SETTLED = 100.0  # s of BIAS_AGE (5 s at rest) after which the variance of the bias begins to fall
_REST_TAU = 5.0  # s: smoothing of the bias at rest
_SHARED_HEADING = 1.5  # factor on the heading's deviation: magnetic errors are correlated over seconds, P ignores that
_STEP_DOWN, _STEP_UP = -0.3, 0.5  # bounds of one relative step of R1
_LEAST, _MOST = 0.05, 50.0  # bounds of R1, relative to R1_START


@kernel
def step(s, dt, wx, wy, wz, fx, fy, fz):
    """One IMU sample: rate [rad/s] and specific force [m/s^2] in b, means over the ``dt`` [s] before it.

    The first sample after the vector was made (``AGE`` negative) starts the filter.
    """
    if s[AGE] < 0.0:
        _start(s, (wx, wy, wz), (fx, fy, fz))
        return
    propagate(s, dt, (wx, wy, wz), (fx, fy, fz))
    if s[SUM_TIME] >= 0.999 * s[PERIOD]:
        _feed_back(s, s[COVARIANCE:GAIN].reshape(4, 4))


@kernel
def add_magnetic_field(s, mx, my, mz):
    """Add a magnetic field in b, any unit; the first one sets the heading at once, others act at the next feedback."""
    add_field(s, (mx, my, mz))
    if s[FIELD_H] == 0.0:
        P = s[COVARIANCE:GAIN].reshape(4, 4)
        _correct_heading(s, P)
        _write(s, P)


@kernel
def run(s, last_ns, stamps, gyro, accel, mag, anomaly, behind, aids, out):
    """Loop of :func:`step` and :func:`add_magnetic_field`; arguments as of ``core.attitude.complementary.run``."""
    used = 0
    for i in range(len(stamps)):
        dt = (stamps[i] - (stamps[i - 1] if i > 0 else last_ns)) * 1e-9
        step(s, dt, gyro[i, 0], gyro[i, 1], gyro[i, 2], accel[i, 0], accel[i, 1], accel[i, 2])
        if used < len(behind) and behind[used] == i:
            follow_navigator(s, aids[used])
            used += 1
        has_field = len(mag) > 0 and not math.isnan(mag[i, 0] + mag[i, 1] + mag[i, 2])
        if has_field:
            add_magnetic_field(s, mag[i, 0], mag[i, 1], mag[i, 2])
        write_row(s, out, i)
        if has_field and field_anomaly(s) > anomaly:
            return i + 1
    return len(stamps)


@kernel
def _start(s, w, f):
    begin(s, w, f)
    P = s[COVARIANCE:GAIN].reshape(4, 4)
    for i in range(4):
        for j in range(4):
            P[i, j] = 0.0
    for axis in range(3):
        _add_variance(s, P, axis, s[HEADING_VAR] if axis == 2 else s[TILT_VAR])
    s[R1], s[SCATTER], s[MISMATCH_SUM] = s[R1_START], 0.0, 0.0
    _write(s, P)


@kernel
def _feed_back(s, P):
    """End of a window: propagate the covariance, then run the two stages."""
    watch_rest(s)
    variance = s[BIAS_VAR] / max(s[BIAS_AGE] / _SETTLED, 1.0) ** 2
    doubt_rest(s, variance, variance, variance)
    watch_acceleration(s)
    _propagate_covariance(s, P)
    before = load4(s, QUAT)
    _correct_tilt(s, P)
    if not _correct_heading(s, P):
        before = load4(s, QUAT)
    _learn_bias(s, before)
    _write(s, P)
    clear_sums(s)


@kernel
def _learn_bias(s, before):
    """Estimate the gyro bias: at rest the mean rate, in motion the long-term mean of the stages' corrections."""
    window = s[SUM_TIME]
    if s[STILL_TIME] > s[LEARN_AFTER]:
        s[BIAS_AGE] = min(s[BIAS_AGE] + _REST_COUNTS * window, s[BIAS_TAU])
        gain = window / min(s[STILL_TIME], _REST_TAU)
        for i in range(3):
            s[BIAS + i] += gain * (s[SUM_RATE + i] / window - s[BIAS + i])
        return
    s[BIAS_AGE] = min(s[BIAS_AGE] + window, s[BIAS_TAU])
    now = load4(s, QUAT)
    turned = q_multiply((before[0], -before[1], -before[2], -before[3]), now)  # in b, small
    for i in range(3):
        s[BIAS + i] -= 2.0 / max(s[BIAS_AGE], s[BIAS_TAU_START]) * turned[1 + i]


@kernel
def _direction(s, axis):
    """Direction (unit 4-vector) of the change of q for a rotation about n axis ``axis``: e (x) q."""
    w, x, y, z = load4(s, QUAT)
    if axis == 0:
        return -x, w, -z, y
    if axis == 1:
        return -y, z, w, -x
    return -z, -y, x, w


@kernel
def _add_variance(s, P, axis, variance):
    u = _direction(s, axis)
    for i in range(4):
        for j in range(4):
            P[i, j] += 0.25 * variance * u[i] * u[j]


@kernel
def _propagate_covariance(s, P):
    """P <- A P A' + Q: the turn t of the window acts on the error as dq <- dq (x) Exp(t), on rows, then columns."""
    turn = q_exp(load3(s, SUM_TURN))
    for side in range(2):
        for i in range(4):
            row = (P[i, 0], P[i, 1], P[i, 2], P[i, 3]) if side == 0 else (P[0, i], P[1, i], P[2, i], P[3, i])
            turned = q_multiply(row, turn)
            for j in range(4):
                if side == 0:
                    P[i, j] = turned[j]
                else:
                    P[j, i] = turned[j]
    for axis in range(3):
        _add_variance(s, P, axis, s[SUM_WALK])


@kernel
def _correct_tilt(s, P):
    """Stage 1: sequential update by the three components of the low-passed force in b, predicted as g C' up."""
    g, low = s[GRAVITY], load3(s, LOW_FORCE)
    w, x, y, z = load4(s, QUAT)
    seen, theory, actual = q_rotate_back((w, x, y, z), low), 0.0, 0.0
    noise = s[R1] * s[SHARED] / s[TRUST]
    for axis in range(3):
        if axis == 0:
            h, expected = (-2.0 * g * y, 2.0 * g * z, -2.0 * g * w, 2.0 * g * x), 2.0 * g * (x * z - w * y)
        elif axis == 1:
            h, expected = (2.0 * g * x, 2.0 * g * w, 2.0 * g * z, 2.0 * g * y), 2.0 * g * (y * z + w * x)
        else:
            h = (2.0 * g * w, -2.0 * g * x, -2.0 * g * y, 2.0 * g * z)
            expected = g * (w * w - x * x - y * y + z * z)
        residual = seen[axis] - expected
        prior = _observe(s, P, h, noise)
        theory += prior + s[R1]
        actual += residual * residual
        for i, part in ((0, w), (1, x), (2, y), (3, z)):  # the earlier components have changed the state
            residual -= h[i] * (s[QUAT + i] - part)
        _restrict(s, True)
        _update(s, P, residual, prior + noise)
    _normalise(s)
    _adapt(s, theory, actual)


@kernel
def _adapt(s, theory, actual):
    """PI regulator of R1 on the relative mismatch of actual and theoretical covariance; integral only while small."""
    s[SCATTER] += (actual - s[SCATTER]) / min(_SCATTER_WINDOWS, 1.0 + s[AGE] / s[PERIOD])
    mismatch = (s[SCATTER] - theory) / theory
    inside = abs(mismatch) <= s[REGULATOR_BAND]
    s[MISMATCH_SUM] = s[MISMATCH_SUM] + mismatch if inside else 0.0
    change = s[REGULATOR_P] * mismatch + (s[REGULATOR_I] * s[MISMATCH_SUM] if inside else 0.0)
    change = min(max(change, _STEP_DOWN), _STEP_UP)
    s[R1] = min(max(s[R1] * (1.0 + change), _LEAST * s[R1_START]), _MOST * s[R1_START])


@kernel
def _observe(s, P, h, noise):
    """Write the Kalman gain of a scalar observation with row ``h`` to GAIN; returns h P h'."""
    prior = 0.0
    for i in range(4):
        s[SPREAD + i] = P[i, 0] * h[0] + P[i, 1] * h[1] + P[i, 2] * h[2] + P[i, 3] * h[3]
        prior += h[i] * s[SPREAD + i]
    for i in range(4):
        s[GAIN + i] = s[SPREAD + i] / (prior + noise)
    return prior


@kernel
def _restrict(s, keep_heading):
    """Project the gain on what its stage may change: all but the heading in stage 1, only the heading in stage 2."""
    if s[LITERAL] > 0.0:
        if keep_heading:
            s[GAIN + 3] = 0.0
        else:
            s[GAIN + 1] = s[GAIN + 2] = 0.0
        return
    u = _direction(s, 2)
    along = u[0] * s[GAIN] + u[1] * s[GAIN + 1] + u[2] * s[GAIN + 2] + u[3] * s[GAIN + 3]
    for i in range(4):
        s[GAIN + i] = s[GAIN + i] - along * u[i] if keep_heading else along * u[i]


@kernel
def _update(s, P, residual, variance):
    """q <- q + K r, and P in Joseph's form, because the restricted gain is not optimal."""
    for i in range(4):
        s[QUAT + i] += s[GAIN + i] * residual
    for i in range(4):
        for j in range(4):
            a, b = s[GAIN + i], s[GAIN + j]
            P[i, j] += variance * a * b - a * s[SPREAD + j] - s[SPREAD + i] * b


@kernel
def _correct_heading(s, P):
    """Stage 2: update by the heading error, a rotation about Up. False where the heading was set instead."""
    kind, error, noise, least = observe_heading(s)
    if kind == NOTHING:
        return True
    if kind != USUAL:
        _forget_heading(s, P, noise if kind == FIRST else least)
    if kind == FIRST:
        turn_heading(s, error)
        _forget_heading(s, P, noise)
        return False
    u = _direction(s, 2)
    prior = _observe(s, P, (2.0 * u[0], 2.0 * u[1], 2.0 * u[2], 2.0 * u[3]), noise)
    _restrict(s, False)
    _update(s, P, error, prior + noise)
    _normalise(s)
    return True


@kernel
def _forget_heading(s, P, variance):
    """Reset the heading's error: uncorrelated with the rest, with ``variance`` [rad^2]."""
    u = _direction(s, 2)
    for side in range(2):
        for i in range(4):
            along = 0.0
            for j in range(4):
                along += u[j] * (P[i, j] if side == 0 else P[j, i])
            for j in range(4):
                if side == 0:
                    P[i, j] -= along * u[j]
                else:
                    P[j, i] -= along * u[j]
    _add_variance(s, P, 2, variance)


@kernel
def _normalise(s):
    q = load4(s, QUAT)
    scale = 1.0 / math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    store4(s, QUAT, (scale * q[0], scale * q[1], scale * q[2], scale * q[3]))


@kernel
def _write(s, P):
    """Write the covariance about n axes, twice the quaternion's error along ``_direction``, with heading inflated."""
    T = s[TILT_COV:R1].reshape(3, 3)
    for a in range(3):
        u = _direction(s, a)
        for b in range(3):
            v, total = _direction(s, b), 0.0
            for i in range(4):
                for j in range(4):
                    total += u[i] * P[i, j] * v[j]
            T[a, b] = 4.0 * total
    for a in range(3):
        T[2, a] *= _SHARED_HEADING
        T[a, 2] *= _SHARED_HEADING
    write_covariance(s, T)
