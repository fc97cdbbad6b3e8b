"""Validation of beam velocity messages: the beams of a message, or one sentence why it cannot be used."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.filter.measurements import BEAMS
from nav_pose_estimator.engine.samples import BeamVelocitySample, Vector3

Array = NDArray[np.float64]

MOST_POINTS = 64
_FASTEST = 100.0  # m/s: a larger velocity counts as lost
_LENGTH = 0.02  # tolerance of the length of a unit vector
_SAME = 1e-6  # largest difference of two directions that count as equal
_STUCK = 5  # repetitions after which the sensor is stuck; a sensor at rest with few digits repeats less often

FLAWS = {
    "empty": "the message holds no beam, or not as many directions as velocities",
    "geometry": "the message has no directions of its beams: set aids.beams.directions",
    "count": "the message has {found} beams, but aids.beams.directions gives {given}",
    "direction": "the direction of beam {beam} is not a unit vector (its length is {length:.3g})",
    "duplicate": "beams {beam} and {other} have the same direction: two messages in one, or a wrong geometry",
    "zero": "all velocities are exactly zero: the sensor has no echo, or does not measure",
    "stamp": "the message has the stamp of the one before it: its driver does not stamp every measurement",
    "stuck": "all velocities repeat to the last digit: the sensor is stuck, or its driver repeats messages",
}
"""Reason for rejecting a message, by the last word of its counter."""


class Beams(NamedTuple):
    """``directions`` (n, 3) in the sensor frame and ``velocities`` (n,) [m/s], both as published, NaN for a lost beam.

    ``variances`` (n,) [m^2/s^2] with their floor; ``velocity`` the sensor's own 3-D velocity or None.
    """

    directions: Array
    velocities: Array
    variances: Array
    velocity: Vector3 | None


class Flaw(NamedTuple):
    """Rejection of a message: a key of ``FLAWS`` and its sentence."""

    reason: str
    text: str


def given_directions(numbers: tuple[float, ...]) -> Array:
    """The unit vectors (k, 3) of ``aids.beams.directions``, without the beams that are all zero."""
    vectors = np.array(numbers).reshape(-1, 3)
    lengths = np.linalg.norm(vectors, axis=1)
    return vectors[lengths > 0.0] / lengths[lengths > 0.0, None]


class MessageReader:
    """Reads samples into beams; ``given`` (k, 3) directions, where there are any, replace those of the messages."""

    def __init__(self, given: Array) -> None:
        self._given = given
        self._sound = np.zeros((0, 3))  # directions of the last message that had any, checked
        self._stamp_ns = 0  # of the last message
        self._last, self._repeats = b"", 0  # velocities of the last message, and how often they have been repeated

    def read(self, sample: BeamVelocitySample, floor: float) -> Beams | Flaw:
        """The beams of a message, or the reason for its rejection; ``floor`` [m^2/s^2]: smallest variance."""
        if sample.stamp_ns == self._stamp_ns:
            return _flaw("stamp")
        self._stamp_ns = sample.stamp_ns
        return self._read(sample, floor)

    def _read(self, sample: BeamVelocitySample, floor: float) -> Beams | Flaw:
        velocities = np.array(sample.velocities, float)
        directions = self._given if len(self._given) else np.asarray(sample.directions, float)
        flaw = self._flaw_of(directions, len(velocities))
        if flaw is not None:
            rest = None if len(self._given) else _with_directions(sample, velocities, directions)
            return flaw if rest is None else self._read(rest, floor)
        directions = self._sound  # the same array for every message, which is quickly recognised
        if not velocities.any():
            return _flaw("zero")
        numbers = velocities.tobytes()
        self._last, self._repeats = numbers, self._repeats + 1 if numbers == self._last else 0
        is_lost = _is_lost(sample, velocities)
        if is_lost.any():
            velocities[is_lost] = math.nan
        if self._repeats >= _STUCK and not is_lost.all():
            return _flaw("stuck")
        variances = np.full(len(velocities), floor)
        if sample.variances is not None:  # one that is unknown (NaN), negative or tiny is the floor
            np.fmax(variances, sample.variances, out=variances)
        if len(velocities) <= MOST_POINTS:
            return Beams(directions, velocities, variances, sample.velocity)
        chosen = np.linspace(0, len(velocities) - 1, MOST_POINTS).astype(int)
        return Beams(directions[chosen], velocities[chosen], variances[chosen], sample.velocity)

    def _flaw_of(self, directions: Array, count: int) -> Flaw | None:
        """Flaw of ``directions`` for ``count`` velocities, None if valid; those of the last valid message are known."""
        is_like = 0 < count == len(self._sound) and directions.shape == self._sound.shape
        if is_like and (directions is self._sound or directions.tobytes() == self._sound.tobytes()):
            return None
        if count == 0 or (directions.shape != (count, 3) and not len(self._given)):
            return _flaw("empty")
        if len(directions) != count:
            return _flaw("count", found=count, given=len(self._given))
        flaw = _flaw_of_directions(directions)
        self._sound = directions if flaw is None else self._sound
        return flaw


def _flaw(reason: str, **facts: float) -> Flaw:
    return Flaw(reason, FLAWS[reason].format(**facts))


def _flaw_of_directions(directions: Array) -> Flaw | None:
    if not np.isfinite(directions).all():
        return _flaw("geometry")
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


def _with_directions(sample: BeamVelocitySample, velocities: Array, directions: Array) -> BeamVelocitySample | None:
    """The sample without absent beams: those with a zero direction, and lost ones without a unit direction.

    None where that changes nothing, or leaves no beam.
    """
    if directions.shape != (len(velocities), 3):
        return None
    lengths = np.sqrt(np.square(directions).sum(axis=1))
    is_unit = np.abs(lengths - 1.0) <= _LENGTH
    kept = is_unit | ((lengths != 0.0) & ~_is_lost(sample, velocities))
    if kept.all() or not kept.any():
        return None
    return BeamVelocitySample(
        sample.stamp_ns,
        directions[kept],
        velocities[kept],
        _part(sample.variances, kept),
        sample.velocity,
        _part(sample.ranges, kept),
        _part(sample.valid, kept),
    )


def _part(values: NDArray | None, kept: NDArray[np.bool_]) -> NDArray | None:
    return None if values is None else np.asarray(values)[kept]


def _is_lost(sample: BeamVelocitySample, velocities: Array) -> NDArray[np.bool_]:
    """Which beams (n,) had no echo, by velocity, variance, range and validity flag of the message."""
    lost = ~(np.abs(velocities) < _FASTEST)
    if sample.variances is not None:
        lost |= np.isposinf(sample.variances)
    if sample.ranges is not None:
        lost |= ~(np.asarray(sample.ranges) > 0.0)
    if sample.valid is not None:
        lost |= ~np.asarray(sample.valid, bool)
    return lost
