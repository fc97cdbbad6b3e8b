"""Whether velocities are stamped late: the filter's own state where it has one, else what the innovations say."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.beams.delay import add_delay, no_past, velocity_change
from nav_pose_estimator.core.filter.blocks import DVL_DELAY
from nav_pose_estimator.engine.observation import FilterView

Array = NDArray[np.float64]

_SURE = 5.0  # deviations
_SHORT = 0.03  # s: a delay that costs nothing
_ENOUGH = 100  # messages after which the state is worth a word
_NO_CHANGE = np.zeros(3)


@dataclass
class DelayWatch:
    """``estimate`` and ``sd`` [s] of the filter's state ``dvl_delay`` as last seen, NaN deviation where it has none.

    Without the state, while GNSS is good: a regression of innovations on the change of the velocity along each beam.
    Where the beams are used the filter follows them, and less than the whole delay is seen.
    """

    estimate: float = 0.0
    sd: float = math.nan
    variance: float = 0.0
    """What an uncertain change adds to the noise of a late velocity [m^2/s^2]."""
    sums: Array = field(default_factory=lambda: np.zeros(4))
    _past: Array = field(default_factory=no_past)
    _messages: int = 0

    def change(self, t: float, f: FilterView, lever: Array, gnss_is_good: bool) -> Array:
        """Mean change (3,) until ``t`` [s] of the velocity at ``lever`` (3,) [m], b [m/s^2]; zero where not known."""
        state = int(f.constants[DVL_DELAY.index])
        if state < 0:
            return _NO_CHANGE
        change, self.sd, self.variance = velocity_change(self._past, f.nav, f.P, t, lever, gnss_is_good, state)
        self.estimate = float(f.nav[DVL_DELAY.nav])
        self._messages += 1
        return change

    def add(self, z: Array, H: Array, f: FilterView) -> None:
        """Innovations ``z`` (n,) [m/s], estimate minus measurement, NaN where lost, with their rows ``H``."""
        if math.isnan(self.sd):
            add_delay(self.sums, z, H, f.nav)

    @property
    def missing(self) -> float:
        """Stamp minus time of validity [s] beyond ``aids.beams.delay``; 0 where none is certain."""
        if not math.isnan(self.sd):
            is_certain = self._messages > _ENOUGH and abs(self.estimate) > max(_SHORT, _SURE * self.sd)
            return self.estimate if is_certain else 0.0
        product, slopes, squares, count = self.sums.tolist()
        if slopes == 0.0:
            return 0.0
        delay = product / slopes
        left = max(squares - delay * product, 0.0) / max(count, 1.0)
        return delay if abs(delay) > max(_SHORT, _SURE * math.sqrt(left / slopes)) else 0.0
