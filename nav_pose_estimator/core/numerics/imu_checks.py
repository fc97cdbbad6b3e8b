"""Quick acceptance tests of a block of IMU samples, each in one compiled pass at a tenth of the cost of numpy calls."""

import math

import numpy as np

from nav_pose_estimator.core.numerics.jit import COMPILED, kernel


@kernel
def is_unremarkable(stamps, gyro, accel, last_ns, before, step_ns, bounds):
    """True for N samples that are in order of time, in range, and show neither repeated nor clipped values.

    ``stamps`` (N,) int64 ns, ``gyro`` (N, 3) [rad/s], ``accel`` (N, 3) [m/s^2]. They follow the sample at ``last_ns``
    with the six values ``before``, in steps of at most ``step_ns``. ``bounds``: largest valid rate and force, and the
    rate and force above which a repeated value of an axis means clipping. False is no verdict: the exact rules decide.
    """
    rate, force, usual_rate, usual_force = bounds
    for i in range(len(stamps)):
        last = stamps[i - 1] if i > 0 else last_ns
        if not 0 < stamps[i] - last <= step_ns:
            return False
        same_gyro = same_accel = 0
        for k in range(3):
            w, f = gyro[i, k], accel[i, k]
            if not (abs(w) <= rate and abs(f) <= force):  # false for NaN
                return False
            if w == (gyro[i - 1, k] if i > 0 else before[k]):
                same_gyro += 1
                if abs(w) > usual_rate:
                    return False
            if f == (accel[i - 1, k] if i > 0 else before[3 + k]):
                same_accel += 1
                if abs(f) > usual_force:
                    return False
        if same_gyro == 3 or same_accel == 3:
            return False
    return True


@kernel
def is_calm(rows, usual, bounds, dead):
    """True for IMU rows (N, 7) without a shock, clipped values, or constant values for as long as ``dead`` [s].

    The first row is that before the block. ``usual`` (6,) are the mean rates and forces. ``bounds``: distances of rate
    and force from them that count as a shock, and the rate and force above which a repeated value of an axis means
    clipping. ``dead`` (2,): time without change of a whole sensor, and of one axis, that counts as a failure. False is
    no verdict: the exact test decides. Where it is True, ``usual`` becomes the mean of the rows but the first.
    """
    struck_rate, struck_force, clipped_rate, clipped_force = bounds
    silent_gyro = silent_accel = 0.0  # s since the first of equal values, its own step included
    for column in range(1, 7):
        silent = 0.0
        for i in range(1, len(rows)):
            silent = rows[i, 0] - rows[i - 1, 0] + (silent if rows[i, column] == rows[i - 1, column] else 0.0)
            if silent >= 0.99 * dead[1]:
                return False
    for i in range(1, len(rows)):
        step = rows[i, 0] - rows[i - 1, 0]
        same_gyro = same_accel = 0
        away_gyro = away_accel = 0.0
        for k in range(3):
            w, f = rows[i, 1 + k], rows[i, 4 + k]
            away_gyro += (w - usual[k]) ** 2
            away_accel += (f - usual[3 + k]) ** 2
            if w == rows[i - 1, 1 + k]:
                same_gyro += 1
                if not abs(w) <= clipped_rate:
                    return False
            if f == rows[i - 1, 4 + k]:
                same_accel += 1
                if not abs(f) <= clipped_force:
                    return False
        if not (away_gyro <= struck_rate**2 and away_accel <= struck_force**2):  # false for NaN
            return False
        silent_gyro = step + (silent_gyro if same_gyro == 3 else 0.0)
        silent_accel = step + (silent_accel if same_accel == 3 else 0.0)
        if max(silent_gyro, silent_accel) >= 0.99 * dead[0]:
            return False
    for k in range(6):
        total = 0.0
        for i in range(1, len(rows)):
            total += rows[i, 1 + k]
        usual[k] = total / (len(rows) - 1)
    return True


def finest_and_largest(columns: np.ndarray) -> tuple[float, float]:
    """Smallest nonzero step between consecutive samples of ``columns`` (N, 3), and largest absolute value.

    The step is infinite where no value changes.
    """
    if COMPILED:
        finest, largest = _finest_and_largest(columns)
        return finest, largest
    steps = np.abs(np.diff(columns, axis=0))
    return float(steps[steps > 0.0].min(initial=math.inf)), float(np.abs(columns).max())


@kernel
def _finest_and_largest(columns):
    finest, largest = math.inf, 0.0
    for i in range(len(columns)):
        for axis in range(3):
            largest = max(largest, abs(columns[i, axis]))
            step = abs(columns[i, axis] - columns[i - 1, axis]) if i > 0 else 0.0
            if 0.0 < step < finest:
                finest = step
    return finest, largest


@kernel
def next_exchange(stamps, begin, period, length, periods):
    """Index from ``begin`` on of the first of ``stamps`` (N,) [ns] behind which data are exchanged; N without one.

    That is the first stamp in another group of ``periods`` intervals of ``length`` [ns] than the stamp before it, or
    more than one interval away from it. ``period`` is the number of the interval of the stamp before ``begin``.
    """
    before = period
    for i in range(begin, len(stamps)):
        now = stamps[i] // length
        if now // periods != before // periods or abs(now - before) > 1:
            return i
        before = now
    return len(stamps)


@kernel
def first_after(rows, t):
    """Index of the first of the IMU ``rows`` (N, 7), in order of time, that is later than ``t`` [s]; N without one.

    numpy's search would copy the column of the times first.
    """
    begin, end = 0, len(rows)
    while begin < end:
        middle = (begin + end) // 2
        if rows[middle, 0] > t:
            end = middle
        else:
            begin = middle + 1
    return begin
