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
from collections.abc import Iterable
from dataclasses import dataclass
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

Array = NDArray[np.float64]

BINS = 25
"""Bins per second in which rates and forces are summed before they are integrated."""
_LONGEST_STEP = 0.25  # s: longest interval that one IMU sample may stand for
DEGREE = math.pi / 180.0
_AS_PUBLISHED = np.eye(3)[None]


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


@dataclass(frozen=True, eq=False)
class Second:
    """One second of IMU data: integrals of rate (BINS, 3) [rad] and of specific force (BINS, 3) [m/s] over its bins."""

    angle: Array
    impulse: Array

    def without(self, bias: Array) -> "Second":
        """The same second with a gyroscope ``bias`` (3,) [rad/s] subtracted."""
        return Second(self.angle - bias / BINS, self.impulse)


def second_of(rows: Array, start: float) -> Second | None:
    """The second that begins at ``start`` [s], from IMU rows (N, 7), the first of them before it; None if it has gaps.

    Each row stands for the interval since the row before it.
    """
    if len(rows) < 6 or abs(rows[-1, 0] - start - 1.0) > _LONGEST_STEP:
        return None
    second = Second(np.zeros((BINS, 3)), np.zeros((BINS, 3)))
    return second if _sum_up(rows, start, second.angle, second.impulse) else None


@kernel
def _sum_up(rows, start, angle, impulse):
    """Integrate rates and forces into the bins; False where a step is too long."""
    for i in range(1, len(rows)):
        step = rows[i, 0] - rows[i - 1, 0]
        if step > _LONGEST_STEP:
            return False
        place = min(max(int((rows[i, 0] - start) * BINS), 0), BINS - 1)
        for axis in range(3):
            angle[place, axis] += step * rows[i, 1 + axis]
            impulse[place, axis] += step * rows[i, 4 + axis]
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
    inverted_scale: Array
    """Scale with the accelerometer's sign inverted."""


def fit(seconds: list[Second], u: Array, gyros: Array) -> Fit:
    """Compare consecutive ``seconds`` with ``u`` (S, 3) [m/s], for the hypotheses ``gyros`` (H, 3, 3).

    Each of ``gyros`` is a matrix that maps the published rates to the true ones.
    """
    s = impulses(seconds, gyros)
    B = np.einsum("ji,hjk->hik", u, s)
    left, singular, right = np.linalg.svd(B)
    sign = np.sign(np.linalg.det(left) * np.linalg.det(right))
    own, wanted = np.einsum("hji,hji->h", s, s) + 1e-12, float(np.sum(u * u))
    traces = [singular[:, 0] + singular[:, 1] + side * sign * singular[:, 2] for side in (1.0, -1.0)]
    misfits = [np.sqrt(np.maximum(1.0 - trace**2 / (own * wanted), 0.0)) for trace in traces]
    return Fit(misfits[0], traces[0] / own, misfits[1], traces[1] / own)


def least_misfit(seconds: list[Second], u: Array, biases: Iterable[Array], enough: float) -> float:
    """Smallest ``misfit`` of the IMU as published, over the candidate gyroscope ``biases`` (3,) [rad/s].

    The search ends at the first misfit below ``enough``.
    """
    angle, impulse = np.array([one.angle for one in seconds]), np.array([one.impulse for one in seconds])
    wanted, least, out = float(np.vdot(u, u)), math.inf, np.empty((1, len(seconds), 3))
    for bias in biases:
        _integrate(angle - bias / BINS, impulse, _AS_PUBLISHED, out)
        B = u.T @ out[0]
        first, second, third = np.linalg.svd(B, compute_uv=False).tolist()
        trace = first + second + math.copysign(third, dot(B[0], cross(B[1], B[2])))
        own = float(np.vdot(out, out)) + 1e-12
        least = min(least, math.sqrt(max(1.0 - trace**2 / (own * wanted), 0.0)))
        if least < enough:
            break
    return least


def best_rotation(impulses: Array, forces: Array) -> Array:
    """Rotation (..., 3, 3) that maps ``impulses`` (S, 3) onto ``forces`` (..., S, 3) best (Wahba's problem)."""
    left, _, right = np.linalg.svd(np.swapaxes(forces, -1, -2) @ impulses)
    left[..., 2] *= (np.linalg.det(left) * np.linalg.det(right))[..., None]
    return np.asarray(left @ right)


def impulses(seconds: list[Second], gyros: Array) -> Array:
    """(H, S, 3) [m/s]: specific force integrated over each second, in the axes of b at the start of the first one."""
    out = np.empty((len(gyros), len(seconds), 3))
    _integrate(np.array([one.angle for one in seconds]), np.array([one.impulse for one in seconds]), gyros, out)
    return out


@kernel
def _integrate(angle, impulse, gyros, out):
    """``impulses`` from the bins (S, BINS, 3) of rate [rad] and specific force [m/s]."""
    for h in range(len(gyros)):
        attitude = (1.0, 0.0, 0.0, 0.0)
        for s in range(len(angle)):
            total = (0.0, 0.0, 0.0)
            for b in range(BINS):
                turn = _times(gyros[h], load3(angle[s, b], 0))
                force = load3(impulse[s, b], 0)
                middle = add_scaled(force, 0.5, cross(turn, force))  # the force acts midway through the bin
                total = add(total, q_rotate(attitude, middle))
                attitude = q_multiply(attitude, q_exp(turn))
            store3(out[h, s], 0, total)


@inlined
def _times(matrix, v):
    return dot(load3(matrix[0], 0), v), dot(load3(matrix[1], 0), v), dot(load3(matrix[2], 0), v)
