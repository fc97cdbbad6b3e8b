"""Detection of motion from GNSS fixes, with or without their velocity: to the IMU, steady motion looks like rest."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np

from nav_pose_estimator.core.alignment.types import Fix
from nav_pose_estimator.core.earth.ellipsoid import radii

_MEMORY = 5.0  # s of fixes through which the line is fitted ...
_LEAST = 4  # ... and the least number of fixes
_LEAST_TIME = 2.0  # s of fixes without velocity that are needed to show rest
_SURE = 3.0  # standard deviations of the speed that are subtracted for its lower bound


@dataclass(eq=False, slots=True)
class FixMotion:
    """The fixes of the last seconds."""

    rest_speed: float
    """Speed [m/s] above which the vehicle is not at rest."""
    _fixes: deque[Fix] = field(default_factory=deque)

    def note(self, fix: Fix) -> None:
        """Add a fix, in order of time."""
        self._fixes.append(fix)
        while len(self._fixes) > _LEAST and fix.t - self._fixes[0].t > _MEMORY:
            self._fixes.popleft()

    @property
    def moves(self) -> bool:
        """Whether the fixes show motion, by the velocity of the last one or else by their displacement."""
        if not self._fixes:
            return False
        velocity = self._fixes[-1].velocity
        if velocity is not None:
            return math.hypot(*velocity) > self.rest_speed
        return len(self._fixes) >= _LEAST and _speed(self._fixes) > self.rest_speed

    @property
    def has_shown_rest(self) -> bool:
        """Whether there have been enough fixes to show motion, and they show none."""
        if not self._fixes or self.moves:
            return False
        first, last = self._fixes[0], self._fixes[-1]
        return last.velocity is not None or (len(self._fixes) >= _LEAST and last.t - first.t >= _LEAST_TIME)


def _speed(fixes: deque[Fix]) -> float:
    """Lower bound of the horizontal speed [m/s], from a straight line fitted through ``fixes``."""
    first = fixes[0]
    r_m, r_n = radii(first.position[0])
    displacements = [
        (
            math.remainder(fix.position[1] - first.position[1], 2.0 * math.pi) * r_n * math.cos(first.position[0]),
            (fix.position[0] - first.position[0]) * r_m,
        )
        for fix in fixes
    ]
    t = np.array([fix.t for fix in fixes]) - first.t
    t -= t.mean()
    east, north = np.array(displacements).T
    power = float(t @ t)
    slopes = np.array([t @ east, t @ north]) / power
    residuals = np.array([east - east.mean() - slopes[0] * t, north - north.mean() - slopes[1] * t])
    sd = math.sqrt(float(np.sum(residuals**2)) / (len(t) - 2) / power)
    return float(np.hypot(*slopes)) - _SURE * sd
