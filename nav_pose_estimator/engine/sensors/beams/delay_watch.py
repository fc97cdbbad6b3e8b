"""Latency of beam velocities: from the filter's delay state where it has one, else from the innovations."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.beams.delay import add_delay, no_past, velocity_change
from nav_pose_estimator.core.filter.blocks import DVL_DELAY
from nav_pose_estimator.engine.observation import FilterView

Array = NDArray[np.float64]

_SURE = 5.0  # standard deviations by which a delay has to be significant
_SHORT = 0.03  # s: smaller delays are not reported
_ENOUGH = 100  # messages before the estimated state is reported
_NO_CHANGE = np.zeros(3)


@dataclass
class DelayWatch:
    """Monitor of the delay; ``estimate`` and ``sd`` [s] are those of the state ``dvl_delay``, ``sd`` NaN without it.

    Without the state and while GNSS is good, the innovations are regressed on the acceleration along each beam. Where
    the beams are used the filter follows them, and the regression shows less than the whole delay.
    """

    estimate: float = 0.0
    sd: float = math.nan
    variance: float = 0.0
    """m^2/s^2: variance that an uncertain acceleration adds to a delayed velocity."""
    sums: Array = field(default_factory=lambda: np.zeros(4))
    _past: Array = field(default_factory=no_past)
    _messages: int = 0

    def change(self, t: float, f: FilterView, lever: Array, gnss_is_good: bool) -> Array:
        """Rate of change (3,) [m/s^2, b] of the velocity at ``lever`` (3,) [m] at ``t`` [s]; zero if unknown."""
        state = int(f.constants[DVL_DELAY.index])
        if state < 0:
            return _NO_CHANGE
        change, self.sd, self.variance = velocity_change(self._past, f.nav, f.P, t, lever, gnss_is_good, state)
        self.estimate = float(f.nav[DVL_DELAY.nav])
        self._messages += 1
        return change

    def add(self, z: Array, H: Array, f: FilterView) -> None:
        """Add innovations ``z`` (n,) [m/s], estimate minus measurement, NaN where lost, with their rows ``H``."""
        if math.isnan(self.sd):
            add_delay(self.sums, z, H, f.nav)

    @property
    def missing(self) -> float:
        """Stamp minus time of validity [s] beyond ``aids.beams.delay``; 0 where it is not significant."""
        if not math.isnan(self.sd):
            is_certain = self._messages > _ENOUGH and abs(self.estimate) > max(_SHORT, _SURE * self.sd)
            return self.estimate if is_certain else 0.0
        product, slopes, squares, count = self.sums.tolist()
        if slopes == 0.0:
            return 0.0
        delay = product / slopes
        left = max(squares - delay * product, 0.0) / max(count, 1.0)
        return delay if abs(delay) > max(_SHORT, _SURE * math.sqrt(left / slopes)) else 0.0
