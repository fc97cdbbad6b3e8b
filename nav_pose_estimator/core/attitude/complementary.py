"""Complementary attitude filter with proportional-integral feedback (CN113777645A, claims 1 and 2), as kernels.

The attitude is integrated from the gyroscope, ``dq/dt = q (w + delta) / 2``. The integral in n of specific force plus
gravity is the *sway*, a velocity. It stays near zero (or near the navigator's velocity) unless the estimate is tilted;
then it grows with g times the tilt. It is the error signal of claim 1, low-passed in n:

    u' = f_n - g up - k_u u   low-passed error: u = e / k_u, time constant 1 / k_u
    delta_n = k_p (u x up)    proportional part: rotates the estimate in n
    b' = K_i u                integral part: gyro bias, scale factors and misalignments of the gyroscope

The force is not normalised: the mean of f_n is the reaction to gravity, that of f_n / |f_n| is not. The noise variance
of the sway is divided by the rejection function p(a). The gains are the Kalman gains of this loop, from the covariance
of [tilt and heading (3), sway (2), gyro bias (3), gyro matrix (9)], which is propagated beside it at ``PERIOD``. So
they are large at the start and small later, and the published covariance is that of the loop.

Error state: phi with C = (I + [phi x]) C_hat; estimate minus truth for the sway; truth minus estimate for bias and
matrix. A magnetometer corrects the heading, the gyro bias and the gyro matrix, never the tilt.
"""

import math

from nav_pose_estimator.core.attitude.heading import observe_heading
from nav_pose_estimator.core.attitude.layout import (
    AGE,
    BIAS,
    BIAS_PSD,
    COLUMNS,
    EXTRA_SWAY_PSD,
    FIELD_H,
    LEARN_AFTER,
    LEARN_PSD,
    LEVEL_AFTER,
    MATRIX,
    MATRIX_PSD,
    MOTION_FALL,
    MOTION_FLOOR,
    MOTION_RISE,
    MOTION_TAU,
    OWN,
    PERIOD,
    QUAT,
    STILL_PSD,
    STILL_TIME,
    SUM_FORCE_N,
    SUM_RATE,
    SUM_TIME,
    SUM_TURN,
    SUM_WALK,
    SWAY,
    SWAY_LOW,
    SWAY_PSD,
    SWAY_VAR,
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
    turn_in_n,
    watch_acceleration,
    watch_rest,
    write_covariance,
    write_row,
)
from nav_pose_estimator.core.attitude.navigator_aid import follow_navigator
from nav_pose_estimator.core.numerics.jit import inlined, kernel
from nav_pose_estimator.core.numerics.vectors import load3, load4, q_columns

# --- layout of the error state, its covariance and the work space --------------------------------------------------
PHI, D_SWAY, D_BIAS, D_MATRIX, STATES = 0, 3, 5, 8, 17
COVARIANCE = OWN  # (17, 17)
GAIN = COVARIANCE + STATES * STATES  # 17: last Kalman gain
GAIN_2 = GAIN + STATES  # 17: gain of the second observation of a pair
BODY_TURN = GAIN_2 + STATES  # (3, 17): covariance with all states of the window's turn in b that bias and matrix cause
CROSS = BODY_TURN + 3 * STATES  # (3, 17): the same in n, as a change of phi
TILT_VAR, HEADING_VAR, SWAY_START_VAR = CROSS + 51, CROSS + 52, CROSS + 53  # initial variances
SIZE = SWAY_START_VAR + 1

_SURE = 9.0  # squared normalised sway above which the vehicle is not at rest: three standard deviations
_LOW_TAU = 2.0  # s: time constant of the low-pass whose output is the lasting part of the sway


@kernel
def step(s, dt, wx, wy, wz, fx, fy, fz):
    """One IMU sample: rate [rad/s] and specific force [m/s^2] in b, means over the ``dt`` [s] before it.

    The first sample after the vector was made (``AGE`` negative) starts the filter.
    """
    _step(s, dt, (wx, wy, wz), (fx, fy, fz))


@inlined
def _step(s, dt, w, f):
    if s[AGE] < 0.0:
        _start(s, w, f)
        return
    propagate(s, dt, w, f)
    if s[SUM_TIME] >= 0.999 * s[PERIOD]:
        _feed_back(s)


@kernel
def add_magnetic_field(s, mx, my, mz):
    """Add a magnetic field in b, any unit; the first one sets the heading at once, others act at the next feedback."""
    add_field(s, (mx, my, mz))
    if s[FIELD_H] == 0.0:
        P = s[COVARIANCE:GAIN].reshape(STATES, STATES)
        _correct_heading(s, P)
        write_covariance(s, P)


@kernel
def run(s, last_ns, stamps, gyro, accel, mag, anomaly, behind, aids, out):
    """Loop of :func:`step` and :func:`add_magnetic_field`: the batch form, identical to single calls.

    ``stamps`` (N,) int64 [ns] after ``last_ns``; ``gyro``, ``accel`` (N, 3); ``mag`` (N, 3) or (0, 3): the field that
    follows each IMU sample, NaN for none. ``out`` (N, BLOCK_COLUMNS) receives attitude, variances and bias after each.
    ``aids`` (M, navigator_aid.SIZE) of a navigator take effect after the samples ``behind`` (M,), in order of time.
    Returns the number of processed samples: all, or up to the first one whose field differs by more than ``anomaly``
    from the learned one.
    """
    used = 0
    for i in range(len(stamps)):
        # float: in plain Python numpy's own scalars cost three times as much
        dt = float(stamps[i] - (stamps[i - 1] if i > 0 else last_ns)) * 1e-9
        w = (float(gyro[i, 0]), float(gyro[i, 1]), float(gyro[i, 2]))
        f = (float(accel[i, 0]), float(accel[i, 1]), float(accel[i, 2]))
        _step(s, dt, w, f)
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
    """Level, and reset attitude and sway with their covariance; bias and matrix keep theirs."""
    begin(s, w, f)
    P = s[COVARIANCE:GAIN].reshape(STATES, STATES)
    for i in range(D_BIAS):
        for j in range(STATES):
            P[i, j] = P[j, i] = 0.0
    P[0, 0] = P[1, 1] = s[TILT_VAR]
    P[2, 2] = s[HEADING_VAR]
    P[D_SWAY, D_SWAY] = P[D_SWAY + 1, D_SWAY + 1] = s[SWAY_START_VAR]
    s[SWAY_LOW] = s[SWAY_LOW + 1] = s[SWAY_VAR] = 0.0
    write_covariance(s, P)


@kernel
def _feed_back(s):
    """End of a window: propagate the covariance, then update by sway, rest and magnetic field."""
    P = s[COVARIANCE:GAIN].reshape(STATES, STATES)
    window = s[SUM_TIME]
    watch_rest(s)
    watch_acceleration(s)
    _propagate_covariance(s, P, window)
    _doubt_rest(s, P, window)
    noise = _sway_noise(s, window)
    _level(s, P, noise)
    if s[STILL_TIME] > s[LEARN_AFTER]:
        for axis in range(3):
            residual = s[SUM_RATE + axis] / window - s[BIAS + axis]
            _correct(s, P, D_BIAS + axis, residual, s[LEARN_PSD] / window)
    _correct_heading(s, P)
    write_covariance(s, P)
    s[SWAY + 2] = 0.0
    clear_sums(s)


@inlined
def _doubt_rest(s, P, window):
    """Accept rest only if it agrees with bias and sway; at its beginning the sway is reset.

    An accelerometer cannot distinguish rest from steady cruise. Rest here means no acceleration, not a known velocity.
    """
    doubt_rest(s, P[D_BIAS, D_BIAS], P[D_BIAS + 1, D_BIAS + 1], P[D_BIAS + 2, D_BIAS + 2])
    if s[STILL_TIME] <= s[LEVEL_AFTER]:
        return
    if s[STILL_TIME] - window <= s[LEVEL_AFTER]:
        for i in range(2):
            s[SWAY + i] = s[SWAY_LOW + i] = 0.0
            for j in range(STATES):
                P[D_SWAY + i, j] = P[j, D_SWAY + i] = 0.0
            P[D_SWAY + i, D_SWAY + i] = s[SWAY_START_VAR]
    for i in range(2):
        variance = P[D_SWAY + i, D_SWAY + i] + s[STILL_PSD] / window
        if s[SWAY + i] * s[SWAY + i] > _SURE * variance:
            s[STILL_TIME] = 0.0


@inlined
def _sway_noise(s, window):
    """Noise variance of the sway as an observation of zero: the vehicle's own motion, divided by p(a)."""
    gain = min(1.0, window / _LOW_TAU)
    s[SWAY_LOW] += gain * (s[SWAY] - s[SWAY_LOW])
    s[SWAY_LOW + 1] += gain * (s[SWAY + 1] - s[SWAY_LOW + 1])
    square = 0.5 * (s[SWAY_LOW] * s[SWAY_LOW] + s[SWAY_LOW + 1] * s[SWAY_LOW + 1])
    tau = s[MOTION_RISE] if square > s[SWAY_VAR] else s[MOTION_FALL]
    s[SWAY_VAR] += min(1.0, window / tau) * (square - s[SWAY_VAR])
    if s[STILL_TIME] > s[LEVEL_AFTER]:
        return s[STILL_PSD] / window
    return (s[MOTION_FLOOR] + 2.0 * s[MOTION_TAU] * s[SWAY_VAR]) / (window * s[TRUST])


@inlined
def _propagate_covariance(s, P, window):
    """P <- F P F' + Q over the window: bias and matrix drive phi, tilt drives the sway.

    The error of the turn about body axis k is ``window`` times bias k plus row k of the matrix times the turn of the
    window. ``Y`` holds its covariance with all states, X = -C Y that of the resulting change of phi.
    """
    Y = s[BODY_TURN:CROSS].reshape(3, STATES)
    X = s[CROSS:TILT_VAR].reshape(3, STATES)
    now, turn = q_columns(load4(s, QUAT)), load3(s, SUM_TURN)
    for k in range(3):
        row = D_MATRIX + 3 * k
        for j in range(STATES):
            Y[k, j] = (
                window * P[D_BIAS + k, j] + turn[0] * P[row, j] + turn[1] * P[row + 1, j] + turn[2] * P[row + 2, j]
            )
        for i in range(3):  # C of mid-window, from both ends
            s[COLUMNS + 3 * k + i] = -0.5 * (s[COLUMNS + 3 * k + i] + now[k][i])
    for i in range(3):
        a, b, c = s[COLUMNS + i], s[COLUMNS + 3 + i], s[COLUMNS + 6 + i]
        for j in range(STATES):
            X[i, j] = a * Y[0, j] + b * Y[1, j] + c * Y[2, j]
    for i in range(3):
        for j in range(3, STATES):
            P[i, j] += X[i, j]
            P[j, i] = P[i, j]
        for j in range(3):
            total = X[i, j] + X[j, i]
            for k in range(3):
                row = D_MATRIX + 3 * k
                along = turn[0] * X[i, row] + turn[1] * X[i, row + 1] + turn[2] * X[i, row + 2]
                total += (window * X[i, D_BIAS + k] + along) * s[COLUMNS + 3 * k + j]
            P[i, j] += total
    _sway_by_tilt(P, s[SUM_FORCE_N + 2])
    for i in range(D_SWAY):
        P[i, i] += s[SUM_WALK]
    for i in range(D_SWAY, D_BIAS):
        P[i, i] += (s[SWAY_PSD] + s[EXTRA_SWAY_PSD]) * window
    for i in range(D_BIAS, STATES):
        P[i, i] += (s[BIAS_PSD] if i < D_MATRIX else s[MATRIX_PSD]) * window


@inlined
def _sway_by_tilt(P, up):
    """d(sway) = -phi x (0, 0, up), ``up`` [m/s] the summed vertical force: rows, then columns."""
    for j in range(STATES):
        P[D_SWAY, j] -= up * P[1, j]
        P[D_SWAY + 1, j] += up * P[0, j]
    for j in range(STATES):
        P[j, D_SWAY] -= up * P[j, 1]
        P[j, D_SWAY + 1] += up * P[j, 0]


@inlined
def _level(s, P, variance):
    """Kalman update by sway East and North, each observed as zero with ``variance``, in one pass over P."""
    spread = P[D_SWAY, D_SWAY] + variance
    for i in range(STATES):
        s[GAIN + i] = P[i, D_SWAY] / spread
    share = spread * s[GAIN + D_SWAY + 1]  # covariance of the two observations
    spread_2 = P[D_SWAY + 1, D_SWAY + 1] - share * s[GAIN + D_SWAY + 1] + variance
    for i in range(STATES):
        s[GAIN_2 + i] = (P[i, D_SWAY + 1] - share * s[GAIN + i]) / spread_2
    for i in range(STATES):
        a, b = spread * s[GAIN + i], spread_2 * s[GAIN_2 + i]
        for j in range(i, STATES):
            P[i, j] -= a * s[GAIN + j] + b * s[GAIN_2 + j]
            P[j, i] = P[i, j]
    east = s[SWAY]
    north = s[SWAY + 1] - s[GAIN + D_SWAY + 1] * east
    for i in range(STATES):
        s[GAIN + i] = s[GAIN + i] * east + s[GAIN_2 + i] * north
    _apply(s, 1.0)


@kernel
def _correct(s, P, index, residual, variance):
    """Kalman update of covariance and estimate by one observed error state, ``residual`` with ``variance``."""
    spread = P[index, index] + variance
    for i in range(STATES):
        s[GAIN + i] = P[i, index] / spread
    for i in range(STATES):
        for j in range(i, STATES):
            P[i, j] -= spread * s[GAIN + i] * s[GAIN + j]
            P[j, i] = P[i, j]
    _apply(s, residual)


@inlined
def _apply(s, residual):
    """Correct the estimate by GAIN times ``residual``."""
    turn_in_n(s, (s[GAIN] * residual, s[GAIN + 1] * residual, s[GAIN + 2] * residual))
    s[SWAY] -= s[GAIN + D_SWAY] * residual
    s[SWAY + 1] -= s[GAIN + D_SWAY + 1] * residual
    for i in range(3):
        s[BIAS + i] += s[GAIN + D_BIAS + i] * residual
    for i in range(9):
        s[MATRIX + i] += s[GAIN + D_MATRIX + i] * residual


@kernel
def _correct_heading(s, P):
    """Update heading, bias and matrix by the observed heading error; the gain is zero for tilt and sway."""
    kind, error, noise, least = observe_heading(s)
    if kind == NOTHING:
        return
    if kind != USUAL:
        for j in range(STATES):
            P[2, j] = P[j, 2] = 0.0
        P[2, 2] = noise if kind == FIRST else least
    if kind == FIRST:
        turn_heading(s, error)
        return
    P[2, 2] = max(P[2, 2], least)
    spread = P[2, 2] + noise
    for i in range(STATES):
        s[GAIN + i] = P[i, 2] / spread if i == 2 or i >= D_BIAS else 0.0
        s[CROSS + i] = P[i, 2]
    for i in range(STATES):
        for j in range(i, STATES):
            a, b, x, y = s[GAIN + i], s[GAIN + j], s[CROSS + i], s[CROSS + j]
            P[i, j] += spread * a * b - a * y - x * b  # (I - K H) P (I - K H)' + K R K'
            P[j, i] = P[i, j]
    _apply(s, error)
