"""Detection of rounded positions: a driver that prints latitude and longitude with three decimals has a grid of 100 m.

Such a position can be wrong by half a step for as long as the vehicle stays in its cell, and no innovation shows it.
But all fixes lie on the grid. A fix of a receiver with a resolution of 1e-7 deg lies on a grid of 1e-3 deg with a
probability of 1e-8.
"""

from __future__ import annotations

import math

from nav_pose_estimator.core.earth.ellipsoid import radii
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.solutions import Level

_GRIDS = sorted(
    [10.0**-k for k in range(1, 5)] + [10.0**-k / 60.0 for k in range(4)] + [1.0 / 3600.0, 0.1 / 3600.0], reverse=True
)
"""deg: decimals of a degree, of a minute, of a second. The error of a finer grid is below that of receivers."""
_CHOSEN_GRID = 1e-2  # deg: a place with two decimals may be the chosen start of a simulator without noise
_FIXES = 10  # smallest number of fixes, all of them since the start
_ON_GRID = 1e-6  # tolerance, relative to a step
_UNIFORM = 12.0**-0.5  # standard deviation of a uniform distribution over one step
_RADIAN = math.degrees(1.0)


class Rounding:
    """The test. It receives every valid fix; ``sd`` (2,) [m] is the rounding error's deviation, East and North."""

    def __init__(self, journal: Journal) -> None:
        self._journal = journal
        self._grids = list(_GRIDS)  # grids on which all fixes lie, the coarsest first
        self._fixes = 0
        self._first: tuple[float, float] | None = None
        self._has_moved = False
        self.sd = (0.0, 0.0)

    @property
    def is_on(self) -> bool:
        """Whether positions are rounded."""
        return self.sd[1] > 0.0

    @property
    def step(self) -> float:
        """m: step of the grid, 0 where none is established."""
        return max(self.sd) / _UNIFORM

    @property
    def least_sd(self) -> float:
        """Floor of the standard deviation [m] on each axis, since rounding errors do not average out."""
        return max(self.sd)

    def fix(self, lat: float, lon: float, moves: bool, stamp_ns: int) -> None:
        """Add a position [rad], used or not; ``moves``: it repeats while the velocities show motion."""
        if not self._grids:
            return
        self._has_moved = self._has_moved or moves
        place = (lat * _RADIAN, lon * _RADIAN)
        if place == self._first:
            self._fixes += 1
        else:
            self._grids = [grid for grid in self._grids if all(_is_on(angle, grid) for angle in place)]
            self._fixes, self._has_moved = self._fixes + 1, self._has_moved or self._first is not None
            self._first = self._first or place
        was_on = self.is_on
        self._weigh(lat)
        if self.is_on and not was_on:
            text = f"{self.reason}; they are used with that error"
            self._journal.say(stamp_ns, "gnss.rounded", Level.WARN, text, step=self.step)
        elif was_on and not self.is_on:
            self._journal.say(stamp_ns, "gnss.rounded.ended", Level.INFO, "GNSS positions have more digits again")

    def _weigh(self, lat: float) -> None:
        may_be_chosen = not self._has_moved and _CHOSEN_GRID in self._grids
        if not self._grids or self._fixes < _FIXES or may_be_chosen:
            self.sd = (0.0, 0.0)
            return
        r_m, r_n = radii(lat)
        step = math.radians(self._grids[0])
        self.sd = (_UNIFORM * step * r_n * math.cos(lat), _UNIFORM * step * r_m)

    @property
    def reason(self) -> str:
        """Why the position is less certain than usual, one clause for the user; empty where it is not."""
        if not self.is_on:
            return ""
        return (
            f"GNSS positions lie on a grid of {self._grids[0]:.2g} deg ({self.step:.3g} m): the driver has lost digits"
        )


def _is_on(angle: float, grid: float) -> bool:
    """Whether ``angle`` [deg] is a multiple of ``grid``."""
    steps = angle / grid
    return abs(steps - round(steps)) < _ON_GRID
