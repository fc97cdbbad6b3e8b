"""Assignment of the velocities of a message to beams, in body axes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.beams.geometry import Reading
from nav_pose_estimator.core.filter.measurements import BEAMS
from nav_pose_estimator.engine.sensors.beams.message import Beams

Array = NDArray[np.float64]

_SAME_BEAM = 0.9998  # cosine of 1.1 deg: directions closer than this are of the same beam


class Arranged(NamedTuple):
    """``directions`` (n, 3) in b, ``measured`` (n,) [m/s] along them, NaN where lost, ``variances`` (n,) [m^2/s^2].

    ``are_beams``: row i is beam i of every message.
    """

    directions: Array
    measured: Array
    variances: Array
    are_beams: bool


@dataclass
class Arrangement:
    """Identifies beams by their directions: a message of a Doppler log may lack the lost ones.

    Points of a cloud differ in every message and have no identity. ``axes`` (3, 3): sensor frame to body.
    """

    axes: Array
    _published: Array | None = None  # (n, 3) of the message with most beams so far
    _reading: Reading | None = None
    _in_body: Array | None = None

    @property
    def count(self) -> int:
        """Number of beams; 0 where messages hold points."""
        return 0 if self._published is None else len(self._published)

    def meet(self, beams: Beams) -> None:
        """Note the directions of a message before the geometry is verified."""
        count = len(beams.directions)
        if count <= BEAMS and (self._published is None or count > len(self._published)):
            self._published = beams.directions

    def settle(self, reading: Reading) -> None:
        """Set the verified convention."""
        self._reading = reading
        if self._published is not None:
            self._in_body = reading.directions(self._published) @ self.axes.T

    def arrange(self, beams: Beams) -> Arranged:
        """The velocities of a message by beam, in body axes."""
        assert self._reading is not None
        measured = self._reading.sign * beams.velocities
        if self._published is None or self._in_body is None or len(measured) > BEAMS:
            return self._points(beams, measured)
        if beams.directions is self._published or np.array_equal(beams.directions, self._published):
            return Arranged(self._in_body, measured, beams.variances, True)
        likeness = beams.directions @ self._published.T
        places = likeness.argmax(axis=1)
        if likeness.max(axis=1).min() < _SAME_BEAM or len(np.unique(places)) < len(places):
            return self._points(beams, measured)
        rows, variances = np.full(len(self._published), np.nan), np.ones(len(self._published))
        rows[places], variances[places] = measured, beams.variances
        return Arranged(self._in_body, rows, variances, True)

    def _points(self, beams: Beams, measured: Array) -> Arranged:
        assert self._reading is not None
        return Arranged(self._reading.directions(beams.directions) @ self.axes.T, measured, beams.variances, False)
