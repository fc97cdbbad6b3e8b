"""How old velocities are when they are stamped: innovations proportional to the acceleration along the beam."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.filter.layout import DVEL, PHI, PREV_ACCEL, PREV_RATE, QUAT
from nav_pose_estimator.core.numerics.rotation import quat_rotate
from nav_pose_estimator.engine.observation import FilterView

Array = NDArray[np.float64]

_MEMORY = 0.998  # of one message
_SURE = 5.0  # deviations
_SHORT = 0.03  # s: a delay that costs nothing


@dataclass
class DelayWatch:
    """Regression of innovations on the change of the velocity along each beam, while GNSS is good.

    Where the beams are used the filter follows them, and less than the whole delay is seen.
    """

    _product: float = 0.0  # sums of slope times innovation, of slope squared, of innovation squared, of beams
    _slopes: float = 0.0
    _squares: float = 0.0
    _count: float = 0.0

    def add(self, z: Array, H: Array, f: FilterView) -> None:
        """Innovations ``z`` (n,) [m/s], estimate minus measurement, NaN where lost, with their rows ``H``."""
        known = np.isfinite(z)
        turning = quat_rotate(f.nav[QUAT : QUAT + 4], f.nav[PREV_RATE : PREV_RATE + 3])
        slope = H[:, DVEL : DVEL + 3] @ f.nav[PREV_ACCEL : PREV_ACCEL + 3] - H[:, PHI : PHI + 3] @ turning
        z, slope = z[known], slope[known]
        self._product = _MEMORY * self._product + float(slope @ z)
        self._slopes = _MEMORY * self._slopes + float(slope @ slope)
        self._squares = _MEMORY * self._squares + float(z @ z)
        self._count = _MEMORY * self._count + len(z)

    @property
    def delay(self) -> float:
        """Stamp minus time of validity [s] that is still missing from ``aids.beams.delay``; 0 where none is certain."""
        if self._slopes == 0.0:
            return 0.0
        delay = self._product / self._slopes
        left = max(self._squares - delay * self._product, 0.0) / max(self._count, 1.0)
        return delay if abs(delay) > max(_SHORT, _SURE * math.sqrt(left / self._slopes)) else 0.0
