"""Test of beam conventions: sign and direction of the published beams, decided from data before any beam is used.

No message type defines the sign of a beam velocity, and drivers differ in it. Some drivers also swap sine and cosine of
the angle between beam and vertical: they publish (-.653, .653, .383) for a beam 22.5 deg from the vertical, whose
direction is (-.271, .271, .924).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

ENOUGH = 20  # messages before a decision
_ACCEPT = 9.0  # largest mean squared normalised residual of the accepted reading: three standard deviations
_RESIDUAL_CAP = 49.0  # largest squared normalised residual that is counted: a radar also sees moving objects
_SEPARATION = 4.0  # the second best reading must fit worse by this factor
_MIN_SPEED = 5.0  # standard deviations of the velocity: at a lower speed every reading fits


@dataclass(frozen=True, slots=True)
class Reading:
    """One convention: velocity along a beam = ``sign`` * published value, sine and cosine ``swapped`` or not."""

    swapped: bool
    sign: int

    def directions(self, published: Array) -> Array:
        """The true unit vectors (n, 3) under this convention."""
        return with_swapped_angle(published) if self.swapped else published


def with_swapped_angle(directions: Array) -> Array:
    """Unit vectors (n, 3) with sine and cosine of their angle to the z axis exchanged; one along z stays there."""
    aside = np.hypot(directions[:, 0], directions[:, 1])
    height = directions[:, 2]
    stretch = np.abs(height) / np.where(aside > 0.0, aside, 1.0)
    upright = np.where(aside > 0.0, aside, np.abs(height))
    return np.column_stack([directions[:, :2] * stretch[:, None], np.copysign(upright, height)])


def readings(sign: int, directions_are_certain: bool) -> tuple[Reading, ...]:
    """The conventions to be distinguished; ``sign`` is 1 or -1 where known, 0 where unknown."""
    swaps = (False,) if directions_are_certain else (False, True)
    return tuple(Reading(swapped, s) for swapped in swaps for s in ((sign,) if sign else (1, -1)))


@dataclass
class GeometryCheck:
    """Compares the misfit of every convention with a velocity from another source, in the sensor frame."""

    candidates: tuple[Reading, ...]
    messages: int = 0
    refusals: int = 0
    fit: float = math.nan
    """RMS of the normalised residuals of the best reading at the last decision."""
    _misfit: Array = field(init=False)
    _beams: int = 0

    def __post_init__(self) -> None:
        self._misfit = np.zeros(len(self.candidates))

    def add(self, directions: Array, measured: Array, velocity: Array, sd: float) -> None:
        """Add a message: published ``directions`` (n, 3) and ``measured`` velocities (n,) [m/s], NaN where lost.

        ``velocity`` (3,) [m/s] is the reference in the sensor frame; ``sd`` [m/s] is the standard deviation of beam and
        reference together.
        """
        known = np.isfinite(measured)
        if not known.any() or math.hypot(*velocity) < _MIN_SPEED * sd:
            return
        self.messages += 1
        self._beams += int(known.sum())
        for k, reading in enumerate(self.candidates):
            along = reading.directions(directions[known]) @ velocity
            squares = np.square((reading.sign * measured[known] - along) / sd)
            self._misfit[k] += float(np.minimum(squares, _RESIDUAL_CAP).sum())

    def decide(self) -> Reading | None:
        """The only reading that fits, after ``ENOUGH`` messages; None before, or where none or several fit.

        Where none or several fit, the test starts again; ``refusals`` counts how often none fitted.
        """
        if self.messages < ENOUGH:
            return None
        order = np.argsort(self._misfit)
        best = float(self._misfit[order[0]])
        self.fit = math.sqrt(best / self._beams)
        if best > _ACCEPT * self._beams:
            self.refusals += 1
        elif len(order) == 1 or self._misfit[order[1]] > _SEPARATION * max(best, float(self._beams)):
            return self.candidates[order[0]]
        self.messages, self._beams, self._misfit = 0, 0, np.zeros(len(self.candidates))
        return None
