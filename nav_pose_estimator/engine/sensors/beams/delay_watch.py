"""Whether velocities are stamped late: says so while GNSS is good."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.beams.delay import add_delay
from nav_pose_estimator.engine.observation import FilterView

Array = NDArray[np.float64]

_SURE = 5.0  # deviations
_SHORT = 0.03  # s: a delay that costs nothing


@dataclass
class DelayWatch:
    """Regression of innovations on the change of the velocity along each beam, while GNSS is good.

    Where the beams are used the filter follows them, and less than the whole delay is seen.
    """

    sums: Array = field(default_factory=lambda: np.zeros(4))

    def add(self, z: Array, H: Array, f: FilterView) -> None:
        """Innovations ``z`` (n,) [m/s], estimate minus measurement, NaN where lost, with their rows ``H``."""
        add_delay(self.sums, z, H, f.nav)

    @property
    def delay(self) -> float:
        """Stamp minus time of validity [s] that is still missing from ``aids.beams.delay``; 0 where none is certain."""
        product, slopes, squares, count = self.sums.tolist()
        if slopes == 0.0:
            return 0.0
        delay = product / slopes
        left = max(squares - delay * product, 0.0) / max(count, 1.0)
        return delay if abs(delay) > max(_SHORT, _SURE * math.sqrt(left / slopes)) else 0.0
