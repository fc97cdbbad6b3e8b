"""How the published directions and signs of beams are meant, found from data before any beam is used.

Drivers differ in the sign of a beam velocity, which no message defines, and some swap sine and cosine of the angle
between beam and vertical: (-.653, .653, .383) for a beam 22.5 deg off it, which is (-.271, .271, .924).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

ENOUGH = 20  # messages
_FIT = 9.0  # mean square of residual over deviation: three deviations
_MOST = 49.0  # that one residual counts for: a radar also sees what moves
_CLEAR = 4.0  # the next best reading fits so many times worse
_SLOW = 5.0  # deviations: slower than that, every reading fits


@dataclass(frozen=True, slots=True)
class Reading:
    """One way to read a message: velocity along a beam = ``sign`` * published, sine and cosine ``swapped`` or not."""

    swapped: bool
    sign: int

    def directions(self, published: Array) -> Array:
        """Unit vectors (n, 3) as they are meant."""
        return with_swapped_angle(published) if self.swapped else published


def with_swapped_angle(directions: Array) -> Array:
    """Unit vectors (n, 3) with sine and cosine of their angle to the z axis exchanged; one along z stays there."""
    aside = np.hypot(directions[:, 0], directions[:, 1])
    height = directions[:, 2]
    stretch = np.abs(height) / np.where(aside > 0.0, aside, 1.0)
    upright = np.where(aside > 0.0, aside, np.abs(height))
    return np.column_stack([directions[:, :2] * stretch[:, None], np.copysign(upright, height)])


def readings(sign: int, directions_are_certain: bool) -> tuple[Reading, ...]:
    """What has to be told apart where the ``sign`` is known (1, -1) or not (0), and the directions are or are not."""
    swaps = (False,) if directions_are_certain else (False, True)
    return tuple(Reading(swapped, s) for swapped in swaps for s in ((sign,) if sign else (1, -1)))


@dataclass
class GeometryCheck:
    """Sums the misfit of every reading against a velocity that is known otherwise, in the sensor frame."""

    candidates: tuple[Reading, ...]
    messages: int = 0
    refusals: int = 0
    fit: float = math.nan
    """Residual over deviation, root mean square, of the best reading when it was last decided."""
    _misfit: Array = field(init=False)
    _beams: int = 0

    def __post_init__(self) -> None:
        self._misfit = np.zeros(len(self.candidates))

    def add(self, directions: Array, measured: Array, velocity: Array, sd: float) -> None:
        """A message: published ``directions`` (n, 3) and ``measured`` (n,) [m/s], NaN where lost.

        ``velocity`` (3,) [m/s] in the sensor frame; ``sd`` [m/s] of beam and velocity together.
        """
        known = np.isfinite(measured)
        if not known.any() or math.hypot(*velocity) < _SLOW * sd:
            return
        self.messages += 1
        self._beams += int(known.sum())
        for k, reading in enumerate(self.candidates):
            along = reading.directions(directions[known]) @ velocity
            squares = np.square((reading.sign * measured[known] - along) / sd)
            self._misfit[k] += float(np.minimum(squares, _MOST).sum())

    def decide(self) -> Reading | None:
        """The reading that fits and no other does, after ``ENOUGH`` messages; None before, or where none fits.

        Where none fits ``refusals`` grows and the check begins anew.
        """
        if self.messages < ENOUGH:
            return None
        order = np.argsort(self._misfit)
        best = float(self._misfit[order[0]])
        self.fit = math.sqrt(best / self._beams)
        if best > _FIT * self._beams:
            self.refusals += 1
        elif len(order) == 1 or self._misfit[order[1]] > _CLEAR * max(best, float(self._beams)):
            return self.candidates[order[0]]
        self.messages, self._beams, self._misfit = 0, 0, np.zeros(len(self.candidates))
        return None
