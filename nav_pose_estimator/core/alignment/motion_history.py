"""Consistency of IMU and GNSS velocity, and a search for the unit, sign or axis error that explains a misfit.

Over a second of length T, non-gravitational forces change the velocity by ``u = dv - g T``, with dv from GNSS. The IMU
predicts it as ``c R s``. Here ``s`` is the specific force integrated with the gyroscope's rates in the axes at some
first instant, ``R`` the unknown rotation from those axes to n, and ``c`` a scale factor, 1 for a correct IMU. Over
several seconds R follows by least squares (Wahba's problem, solved by singular values: Markley, J. Astronaut. Sci.
36(3), 1988), and the norm of the residual is the misfit. A wrong unit, sign or axis of one sensor leaves a misfit that
no rotation removes; undoing the error removes it.

A rotation common to both sensors is absorbed by R. The hypotheses are therefore the gyroscope's axes against those of
the accelerometer: the 24 rotations that map axes on axes, times the sign of the gyroscope, times the sign of the
accelerometer. The last sign needs no second decomposition: ``-s`` only changes the sign of the smallest singular value.
"""

import itertools
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.numerics.jit import inlined, kernel
from nav_pose_estimator.core.numerics.vectors import (
    add,
    add_scaled,
    cross,
    dot,
    load3,
    q_exp,
    q_multiply,
    q_rotate,
    store3,
)
from nav_pose_estimator.core.numerics.wahba import best_rotation

Array = NDArray[np.float64]

BINS = 25
"""Bins per second in which rates and forces are summed before they are integrated."""
ANGLE, IMPULSE = 0, 1
"""A second of IMU data is an array (2, BINS, 3): integrals of rate [rad] and of specific force [m/s] over its bins."""
_LONGEST_STEP = 0.25  # s: longest interval that one IMU sample may stand for
DEGREE = math.pi / 180.0
_PARTS = 5  # consecutive bins whose rotation angles are summed to one rotation vector in ``rotation_of``


def axis_rotations() -> Array:
    """(24, 3, 3): the rotations that map axes on axes, the identity first."""
    found = []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            matrix = np.zeros((3, 3))
            matrix[range(3), order] = signs
            if np.linalg.det(matrix) > 0.0:
                found.append(matrix)
    return np.array(found)


def second_of(rows: Array, start: float) -> Array | None:
    """The second (2, BINS, 3) that begins at ``start`` [s], from IMU rows (N, 7), the first of them before it.

    Each row stands for the interval since the row before it. None if there are gaps.
    """
    if len(rows) < 6 or abs(rows[-1, 0] - start - 1.0) > _LONGEST_STEP:
        return None
    second = np.zeros((2, BINS, 3))
    return second if _sum_up(rows, start, second) else None


@kernel
def _sum_up(rows, start, second):
    """Integrate rates and forces into the bins; False where a step is too long."""
    for i in range(1, len(rows)):
        step = float(rows[i, 0]) - float(rows[i - 1, 0])
        if step > _LONGEST_STEP:
            return False
        place = min(max(int((rows[i, 0] - start) * BINS), 0), BINS - 1)
        for axis in range(3):
            second[ANGLE, place, axis] += step * rows[i, 1 + axis]
            second[IMPULSE, place, axis] += step * rows[i, 4 + axis]
    return True


@kernel
def unrest(parts):
    """Largest of the standard deviations of three columns (N, 3)."""
    count, largest = len(parts), 0.0
    for axis in range(3):
        mean, square = 0.0, 0.0
        for i in range(count):
            mean += parts[i, axis] / count
        for i in range(count):
            square += (parts[i, axis] - mean) ** 2
        largest = max(largest, math.sqrt(square / count))
    return largest


class Fit(NamedTuple):
    """Relative ``misfit`` (H,) of each hypothesis, 0 to 1, and the ``scale`` (H,) that the force needs as a factor."""

    misfit: Array
    scale: Array
    inverted_misfit: Array
    """Misfit with the accelerometer's sign inverted."""


def fit(seconds: Array, u: Array, gyros: Array) -> Fit:
    """Compare consecutive ``seconds`` (S, 2, BINS, 3) with ``u`` (S, 3) [m/s], for the hypotheses ``gyros`` (H, 3, 3).

    Each of ``gyros`` is a matrix that maps the published rates to the true ones.
    """
    s = np.array([impulses(seconds, np.zeros(3), gyro) for gyro in gyros])
    B = np.einsum("ji,hjk->hik", u, s)
    left, singular, right = np.linalg.svd(B)
    sign = np.sign(np.linalg.det(left) * np.linalg.det(right))
    own, wanted = np.einsum("hji,hji->h", s, s) + 1e-12, float(np.sum(u * u))
    traces = [singular[:, 0] + singular[:, 1] + side * sign * singular[:, 2] for side in (1.0, -1.0)]
    misfits = [np.sqrt(np.maximum(1.0 - trace**2 / (own * wanted), 0.0)) for trace in traces]
    return Fit(misfits[0], traces[0] / own, misfits[1])


@kernel
def impulses(seconds, bias, gyro):
    """(S, 3) [m/s]: specific force integrated over each second, in the axes of b at the start of the first one.

    ``seconds`` (S, 2, BINS, 3) are consecutive. The matrix ``gyro`` (3, 3) maps the published rates, less ``bias``
    (3,) [rad/s], to the true ones.
    """
    out = np.empty((len(seconds), 3))
    attitude = (1.0, 0.0, 0.0, 0.0)
    wrong = (float(bias[0]) / BINS, float(bias[1]) / BINS, float(bias[2]) / BINS)
    for s in range(len(seconds)):
        total = (0.0, 0.0, 0.0)
        for b in range(BINS):
            turn = _times(gyro, add_scaled(load3(seconds[s, ANGLE, b], 0), -1.0, wrong))
            force = load3(seconds[s, IMPULSE, b], 0)
            middle = add_scaled(force, 0.5, cross(turn, force))  # the force acts midway through the bin
            total = add(total, q_rotate(attitude, middle))
            attitude = q_multiply(attitude, q_exp(turn))
        store3(out[s], 0, total)
    return out


@kernel
def rotation_of(angles, bias):
    """Quaternion (4,) of a second's rotation from its parts ``angles`` (N, 3) [rad], without ``bias`` (3,) [rad/s]."""
    rotation, count = (1.0, 0.0, 0.0, 0.0), len(angles)
    for first in range(0, count, _PARTS):
        part = (0.0, 0.0, 0.0)
        for i in range(first, min(first + _PARTS, count)):
            part = add_scaled(add_scaled(part, 1.0, load3(angles[i], 0)), -1.0 / count, load3(bias, 0))
        rotation = q_multiply(rotation, q_exp(part))
    return np.array(rotation)


@inlined
def _times(matrix, v):
    return dot(load3(matrix[0], 0), v), dot(load3(matrix[1], 0), v), dot(load3(matrix[2], 0), v)


@kernel
def least_misfit(seconds, u, biases, enough):
    """Smallest ``misfit`` of ``fit`` for the IMU as published, over the candidate gyroscope ``biases`` (K, 3) [rad/s].

    The search ends at the first misfit below ``enough``.
    """
    least, wanted, as_published = math.inf, _squares(u), np.eye(3)
    for k in range(len(biases)):
        s = impulses(seconds, biases[k], as_published)
        _, trace = best_rotation(correlation(s, u))
        least = min(least, math.sqrt(max(1.0 - trace**2 / ((_squares(s) + 1e-12) * wanted), 0.0)))
        if least < enough:
            break
    return least


@kernel
def horizontal_share(u):
    """Horizontal part of ``u`` (S, 3) in n, as the root of a sum of squares, relative to the whole."""
    horizontal = whole = 0.0
    for k in range(len(u)):
        square = u[k, 0] * u[k, 0] + u[k, 1] * u[k, 1]
        horizontal += square
        whole += square + u[k, 2] * u[k, 2]
    return math.sqrt(horizontal / whole)


@kernel
def correlation(impulses, forces):
    """B (3, 3) of Wahba's problem: sum of u s' over ``impulses`` s (S, 3) and ``forces`` u (S, 3)."""
    B = np.zeros((3, 3))
    for k in range(len(forces)):
        for i in range(3):
            for j in range(3):
                B[i, j] += forces[k, i] * impulses[k, j]
    return B


@kernel
def unexplained(impulses, forces):
    """Variation [(m/s)^2] of ``impulses`` (S, 3), and of the residuals of ``forces`` (S, 3) after the best rotation.

    The variation is the sum of squares about the mean, for a constant difference is tilt, bias or scale.
    """
    q, _ = best_rotation(correlation(impulses, forces))
    apart = np.empty_like(forces)
    for k in range(len(forces)):
        store3(apart[k], 0, add_scaled(load3(forces[k], 0), -1.0, q_rotate(q, load3(impulses[k], 0))))
    return varying(impulses), varying(apart)


@kernel
def varying(parts):
    """Variation of ``parts`` (S, 3): sum of squares about their mean."""
    total, count = 0.0, len(parts)
    for axis in range(3):
        mean = 0.0
        for k in range(count):
            mean += parts[k, axis] / count
        for k in range(count):
            total += (parts[k, axis] - mean) ** 2
    return total


@kernel
def _squares(parts):
    """Sum of squares of ``parts`` (S, 3)."""
    total = 0.0
    for k in range(len(parts)):
        total += dot(load3(parts[k], 0), load3(parts[k], 0))
    return total
