"""Inner loop of the navigator: propagation over IMU rows, with a ring buffer of checkpoints of the filter.

State, covariance, constants and checkpoints lie in one vector, so that a call from Python passes one array. The head of
the vector has a fixed layout; P (n, n) follows at ``HEAD``, then the checkpoints, each a copy of ``nav`` and P.
"""

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.earth.ellipsoid import enu_of
from nav_pose_estimator.core.filter.blocks import state_count, states_within
from nav_pose_estimator.core.filter.error_model import covariance_step, covariance_step_in, scratch
from nav_pose_estimator.core.filter.layout import (
    ALT,
    BASE_STATES,
    CONSTANTS_SIZE,
    GYRO_BIAS,
    IMU_ACCEL,
    IMU_GYRO,
    IMU_T,
    LAT,
    LON,
    NAV_SIZE,
    OUT_COLUMNS,
    POINT_SAMPLED,
    SOLUTION_BIASES,
    SOLUTION_COV,
    SOLUTION_ENU,
    SUM_TIME,
    TIME,
)
from nav_pose_estimator.core.filter.mixture import merge
from nav_pose_estimator.core.filter.strapdown import integrate, write_output
from nav_pose_estimator.core.numerics.jit import COMPILED, inlined, kernel
from nav_pose_estimator.core.numerics.vectors import add_scaled, load3

NAV = 0
CONSTANTS = NAV + NAV_SIZE
ORIGIN = CONSTANTS + CONSTANTS_SIZE  # 3: latitude, longitude [rad], height [m] of the local frame
STATES = ORIGIN + 3  # n
PERIOD = STATES + 1  # s: shortest interval between checkpoints
SLOTS = PERIOD + 1  # capacity of the ring in checkpoints
OLDEST = SLOTS + 1  # running number of the oldest checkpoint in the ring ...
NEWEST = OLDEST + 1  # ... and of the newest
HEAD = NEWEST + 1


def make(constants: NDArray[np.float64], slots: int, period: float) -> NDArray[np.float64]:
    """A new vector for the filter of ``constants`` with ``slots`` checkpoints; ``nav`` and P are zero."""
    states = state_count(constants)
    memory = np.zeros(HEAD + states * states + slots * (NAV_SIZE + states * states))
    memory[CONSTANTS:ORIGIN] = constants
    memory[STATES], memory[PERIOD], memory[SLOTS], memory[NEWEST] = states, period, slots, -1.0
    return memory


@inlined
def checkpoint_start(memory, number):
    """Index at which checkpoint ``number`` begins in the vector: ``nav``, then P."""
    n = int(memory[STATES])
    return HEAD + n * n + (number % int(memory[SLOTS])) * (NAV_SIZE + n * n)


@kernel
def add_checkpoint(memory):
    """Store the present filter as a checkpoint; it replaces the oldest one when the ring is full."""
    n = int(memory[STATES])
    memory[NEWEST] += 1.0
    memory[OLDEST] = max(memory[OLDEST], memory[NEWEST] - memory[SLOTS] + 1.0)
    start = checkpoint_start(memory, int(memory[NEWEST]))
    _copy(memory, NAV, start, NAV_SIZE)
    _copy(memory, HEAD, start + NAV_SIZE, n * n)


@kernel
def renew_checkpoint(memory):
    """Replace the newest checkpoint if it is of the present time, because the filter has been corrected since."""
    if memory[checkpoint_start(memory, int(memory[NEWEST])) + TIME] == memory[NAV + TIME]:
        memory[NEWEST] -= 1.0
        add_checkpoint(memory)


@kernel
def drop_before(memory, t):
    """Drop all checkpoints up to ``t`` [s] except the last of them; returns the time of the oldest one left."""
    while memory[OLDEST] < memory[NEWEST] and memory[checkpoint_start(memory, int(memory[OLDEST]) + 1) + TIME] <= t:
        memory[OLDEST] += 1.0
    return memory[checkpoint_start(memory, int(memory[OLDEST])) + TIME]


@kernel
def restore_before(memory, t):
    """Restore the last checkpoint before ``t`` [s], or else the oldest one; later checkpoints are dropped."""
    while memory[NEWEST] > memory[OLDEST] and memory[checkpoint_start(memory, int(memory[NEWEST])) + TIME] >= t:
        memory[NEWEST] -= 1.0
    n = int(memory[STATES])
    start = checkpoint_start(memory, int(memory[NEWEST]))
    _copy(memory, start, NAV, NAV_SIZE)
    _copy(memory, start + NAV_SIZE, HEAD, n * n)


@inlined
def _copy_by_loop(memory, source, target, count):
    """Copy ``count`` numbers in a loop: slices would also compile code for errors of their lengths."""
    for i in range(count):
        memory[target + i] = memory[source + i]


def _copy_by_slices(memory, source, target, count):
    """``_copy_by_loop`` in plain Python, where a loop takes a hundred times as long."""
    memory[target : target + count] = memory[source : source + count]


_copy = _copy_by_loop if COMPILED else _copy_by_slices


@kernel
def run_block(memory, rows, begin, end, due, out):
    """Propagate the filter over IMU rows ``begin`` to ``end`` of ``rows`` (N, 7), but not beyond the time ``due`` [s].

    Returns the index of the row before which it stopped. That is ``end`` where all rows are earlier than ``due``.
    Otherwise state and P are at ``due``, within the interval of that row, ready for an observation. The rows of ``out``
    (M, OUT_COLUMNS) receive the state after each of the last M rows that was reached.
    """
    n = int(memory[STATES])
    nav, constants, P = memory[NAV:CONSTANTS], memory[CONSTANTS:ORIGIN], memory[HEAD : HEAD + n * n].reshape(n, n)
    space, mark = scratch(n), _next_checkpoint(memory)
    for i in range(begin, end):
        gyro = (float(rows[i, IMU_GYRO]), float(rows[i, IMU_GYRO + 1]), float(rows[i, IMU_GYRO + 2]))
        accel = (float(rows[i, IMU_ACCEL]), float(rows[i, IMU_ACCEL + 1]), float(rows[i, IMU_ACCEL + 2]))
        t = rows[i, IMU_T]
        stops = due <= t
        if stops:
            if constants[POINT_SAMPLED] != 0.0 and i > 0:
                gyro = _between(rows, i, IMU_GYRO, due)
                accel = _between(rows, i, IMU_ACCEL, due)
            t = due
        if integrate(nav, constants, t, gyro, accel) or (stops and nav[SUM_TIME] > 0.0):
            covariance_step_in(nav, P, constants, space)
        if stops:
            return i
        if i >= end - out.shape[0]:
            write_output(nav, P, out, out.shape[0] - end + i)
        if nav[TIME] >= mark:
            add_checkpoint(memory)
            mark = _next_checkpoint(memory)
    return end


@inlined
def _next_checkpoint(memory):
    """Time [s] from which on the next checkpoint is due."""
    return memory[checkpoint_start(memory, int(memory[NEWEST])) + TIME] + memory[PERIOD]


@inlined
def _between(rows, i, column, t):
    """Three IMU values at ``t`` [s] within the interval of row ``i``, interpolated linearly from the row before."""
    last, now = load3(rows[i - 1], column), load3(rows[i], column)
    span = rows[i, IMU_T] - rows[i - 1, IMU_T]
    share = (t - rows[i - 1, IMU_T]) / span if span > 0.0 else 1.0
    return add_scaled(last, share, add_scaled(now, -1.0, last))


@kernel
def run_sample(memory, rows, index, solution, t, wx, wy, wz, fx, fy, fz):
    """Propagate over one sample, as ``run_block`` does over a block of one row, and write it to ``rows`` [index].

    ``solution`` (SOLUTION_SIZE,) receives the complete solution after it. Work space for a step of the covariance is
    allocated only where one is due.
    """
    row = rows[index : index + 1]
    row[0, IMU_T] = t
    row[0, IMU_GYRO], row[0, IMU_GYRO + 1], row[0, IMU_GYRO + 2] = wx, wy, wz
    row[0, IMU_ACCEL], row[0, IMU_ACCEL + 1], row[0, IMU_ACCEL + 2] = fx, fy, fz
    n = int(memory[STATES])
    nav, constants, P = memory[NAV:CONSTANTS], memory[CONSTANTS:ORIGIN], memory[HEAD : HEAD + n * n].reshape(n, n)
    if integrate(nav, constants, t, (wx, wy, wz), (fx, fy, fz)):
        covariance_step(nav, P, constants)
    write_output(nav, P, solution[:OUT_COLUMNS].reshape(1, OUT_COLUMNS), 0)
    if nav[TIME] >= _next_checkpoint(memory):
        add_checkpoint(memory)
    complete_solution(memory, solution)


@kernel
def complete_solution(memory, solution):
    """Write the part of a solution after its output row: biases, ENU position, covariance of the base states."""
    n = int(memory[STATES])
    for i in range(6):
        solution[SOLUTION_BIASES + i] = memory[NAV + GYRO_BIAS + i]
    origin_lat, origin_lon, origin_h = memory[ORIGIN], memory[ORIGIN + 1], memory[ORIGIN + 2]
    enu = enu_of(memory[NAV + LAT], memory[NAV + LON], memory[NAV + ALT], origin_lat, origin_lon, origin_h)
    for i in range(3):
        solution[SOLUTION_ENU + i] = enu[i]
    for i in range(BASE_STATES):
        for k in range(BASE_STATES):
            solution[SOLUTION_COV + BASE_STATES * i + k] = memory[HEAD + n * i + k]


@kernel
def mix(branches, weights, trunk):
    """Merge the filters ``branches`` (K, ...) by ``weights`` (K,) into the filter ``trunk``, which may lack blocks."""
    n, m = int(branches[0, STATES]), int(trunk[STATES])
    constants = branches[0, CONSTANTS:ORIGIN]
    places = states_within(trunk[CONSTANTS:ORIGIN], constants)
    navs, Ps = np.empty((len(branches), NAV_SIZE)), np.empty((len(branches), n, n))
    for k in range(len(branches)):
        for i in range(NAV_SIZE):
            navs[k, i] = branches[k, NAV + i]
        for i in range(n):
            for j in range(n):
                Ps[k, i, j] = branches[k, HEAD + n * i + j]
    nav, P = merge(navs, Ps, constants, weights)
    for i in range(NAV_SIZE):
        trunk[NAV + i] = nav[i]
    for i in range(m):
        for j in range(m):
            trunk[HEAD + m * i + j] = P[places[i], places[j]]
