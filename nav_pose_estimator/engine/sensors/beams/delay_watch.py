"""Whether velocities are stamped late: what the innovations say of it, and what the filter's own state needs."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.beams.delay import add_delay
from nav_pose_estimator.engine.observation import FilterView

Array = NDArray[np.float64]

_SURE = 5.0  # deviations
_SHORT = 0.03  # s: a delay that costs nothing
_SPAN, _LONGEST = 0.19, 1.1  # s over which the velocity's change is taken, at the least and at the most


class VelocityChange:
    """How fast the velocity at the sensor has changed of late.

    By differences over two tenths of a second, or from one message to the next where these come more slowly: vibration
    does not show in them, and they are as good for a delay as a line between the two is.
    """

    def __init__(self) -> None:
        self._past: deque[tuple[float, Array]] = deque()

    def at(self, t: float, velocity: Array) -> Array:
        """The mean change (3,) [m/s^2] until ``t`` [s], when the ``velocity`` is (3,) [m/s]; zero where unknown."""
        past = self._past
        if past and past[-1][0] >= t:
            past.clear()
        while len(past) > 1 and past[1][0] <= t - _SPAN:
            past.popleft()
        change = np.zeros(3)
        if past and t - past[0][0] <= _LONGEST:
            change = (velocity - past[0][1]) / (t - past[0][0])
        past.append((t, velocity))
        return change


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

    def missing(self, state: float, sd: float) -> float:
        """``delay``, or where the filter estimates it the ``state`` [s], if certain by its ``sd``; 0 if it is not."""
        if math.isnan(sd):
            return self.delay
        return state if abs(state) > max(_SHORT, _SURE * sd) else 0.0
