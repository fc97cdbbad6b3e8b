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
    silent = np.zeros(6)  # s since the first of equal values of each axis, its own step included
    silent_gyro = silent_accel = 0.0  # the same of the whole sensors
    totals = np.zeros(6)
    for i in range(1, len(rows)):
        step = rows[i, 0] - rows[i - 1, 0]
        same_gyro = same_accel = 0
        away_gyro = away_accel = longest = 0.0
        for k in range(6):
            value = rows[i, 1 + k]
            is_same = value == rows[i - 1, 1 + k]
            silent[k] = step + (silent[k] if is_same else 0.0)
            longest = max(longest, silent[k])
            totals[k] += value
            if k < 3:
                away_gyro += (value - usual[k]) ** 2
                same_gyro += is_same
            else:
                away_accel += (value - usual[k]) ** 2
                same_accel += is_same
            if is_same and not abs(value) <= (clipped_rate if k < 3 else clipped_force):
                return False
        if not (away_gyro <= struck_rate**2 and away_accel <= struck_force**2):  # false for NaN
            return False
        silent_gyro = step + (silent_gyro if same_gyro == 3 else 0.0)
        silent_accel = step + (silent_accel if same_accel == 3 else 0.0)
        if longest >= 0.99 * dead[1] or max(silent_gyro, silent_accel) >= 0.99 * dead[0]:
            return False
    for k in range(6):
        usual[k] = totals[k] / (len(rows) - 1)
    return True


def finest_and_largest(rows: np.ndarray) -> tuple[tuple[float, float], tuple[float, float]]:
    """Smallest nonzero step between consecutive values of an axis, and largest absolute value, of rates and of forces.

    Of IMU rows (N, 7). The step is infinite where no value changes.
    """
    if COMPILED:
        finest_rate, largest_rate, finest_force, largest_force = _finest_and_largest(rows)
        return (finest_rate, largest_rate), (finest_force, largest_force)
    steps, sizes = np.abs(np.diff(rows, axis=0)), np.abs(rows)
    rate, force = (
        (float(steps[:, k : k + 3][steps[:, k : k + 3] > 0.0].min(initial=math.inf)), float(sizes[:, k : k + 3].max()))
        for k in (1, 4)
    )
    return rate, force


@kernel
def _finest_and_largest(rows):
    finest_rate = finest_force = math.inf
    largest_rate = largest_force = 0.0
    for i in range(len(rows)):
        for axis in range(3):
            w, f = rows[i, 1 + axis], rows[i, 4 + axis]
            largest_rate, largest_force = max(largest_rate, abs(w)), max(largest_force, abs(f))
            step = abs(w - rows[i - 1, 1 + axis]) if i > 0 else 0.0
            if 0.0 < step < finest_rate:
                finest_rate = step
            step = abs(f - rows[i - 1, 4 + axis]) if i > 0 else 0.0
            if 0.0 < step < finest_force:
                finest_force = step
    return finest_rate, largest_rate, finest_force, largest_force


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


def first_from(rows: np.ndarray, t: float) -> int:
    """``first_after`` of the times that are not earlier than ``t`` [s]."""
    return first_after(rows, math.nextafter(t, -math.inf))  # type: ignore[no-any-return]
