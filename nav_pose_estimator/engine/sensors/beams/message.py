"""One message of beam velocities on its way in: what it holds, or the one sentence why it cannot be used."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.filter.measurements import BEAMS
from nav_pose_estimator.engine.samples import BeamVelocitySample, Vector3

Array = NDArray[np.float64]

MOST_POINTS = 64
_FASTEST = 100.0  # m/s
_LENGTH = 0.02  # by which a unit vector may be longer or shorter than one
_SAME = 1e-6  # between two directions of the same beam

FLAWS = {
    "empty": "the message holds no beam, or not as many directions as velocities",
    "geometry": "the message has no directions of its beams: set aids.beams.directions",
    "count": "the message has {found} beams, but aids.beams.directions gives {given}",
    "direction": "the direction of beam {beam} is no unit vector (its length is {length:.3g})",
    "duplicate": "beams {beam} and {other} have the same direction: two messages in one, or a wrong geometry",
    "zero": "all velocities are exactly zero: the sensor has no echo, or does not measure",
}
"""Why a message is not used, by the last word of its counter."""


class Beams(NamedTuple):
    """``directions`` (n, 3) in the sensor frame and ``velocities`` (n,) [m/s], both as published, NaN for a lost beam.

    ``variances`` (n,) [m^2/s^2], NaN where unknown; ``velocity`` the sensor's own 3-D one or None.
    """

    directions: Array
    velocities: Array
    variances: Array
    velocity: Vector3 | None


class Flaw(NamedTuple):
    """A key of ``FLAWS`` and its sentence."""

    reason: str
    text: str


def given_directions(numbers: tuple[float, ...]) -> Array:
    """The unit vectors (k, 3) of ``aids.beams.directions``, without the beams that are all zero."""
    vectors = np.array(numbers).reshape(-1, 3)
    lengths = np.linalg.norm(vectors, axis=1)
    return vectors[lengths > 0.0] / lengths[lengths > 0.0, None]


def read(sample: BeamVelocitySample, given: Array) -> Beams | Flaw:
    """The beams of a message, whose directions are ``given`` (k, 3) where there are any."""
    velocities = np.array(sample.velocities, float)
    count = len(velocities)
    directions = given if len(given) else np.asarray(sample.directions, float)
    if count == 0 or (directions.shape != (count, 3) and not len(given)):
        return _flaw("empty")
    if len(directions) != count:
        return _flaw("count", found=count, given=len(given))
    if not np.isfinite(directions).all():
        return _flaw("geometry")
    variances = np.full(count, math.nan) if sample.variances is None else np.array(sample.variances, float)
    chosen = np.linspace(0, count - 1, min(count, MOST_POINTS)).astype(int)
    flaw = _flaw_of_directions(directions[chosen])
    if flaw is not None:
        return flaw
    if not velocities.any():
        return _flaw("zero")
    velocities[_is_lost(sample, velocities) | np.isposinf(variances)] = math.nan
    return Beams(directions[chosen], velocities[chosen], variances[chosen], sample.velocity)


def _flaw(reason: str, **facts: float) -> Flaw:
    return Flaw(reason, FLAWS[reason].format(**facts))


def _flaw_of_directions(directions: Array) -> Flaw | None:
    lengths = np.sqrt(np.square(directions).sum(axis=1))
    wrong = np.flatnonzero(np.abs(lengths - 1.0) > _LENGTH)
    if len(wrong):
        return _flaw("direction", beam=int(wrong[0]) + 1, length=float(lengths[wrong[0]]))
    if len(directions) <= BEAMS:
        for i in range(len(directions)):
            for j in range(i):
                if np.abs(directions[i] - directions[j]).max() < _SAME:
                    return _flaw("duplicate", beam=j + 1, other=i + 1)
    return None


def _is_lost(sample: BeamVelocitySample, velocities: Array) -> NDArray[np.bool_]:
    """Which beams (n,) met nothing, by all that the message says of them."""
    lost = ~(np.abs(velocities) < _FASTEST)
    if sample.ranges is not None:
        lost |= ~(np.asarray(sample.ranges) > 0.0)
    if sample.valid is not None:
        lost |= ~np.asarray(sample.valid, bool)
    return lost
