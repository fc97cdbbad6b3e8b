"""Whether velocities are stamped late: the filter's own state where it has one, else what the innovations say."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.beams.delay import add_delay, velocity_at
from nav_pose_estimator.core.filter.blocks import DVL_DELAY
from nav_pose_estimator.core.filter.layout import DVEL
from nav_pose_estimator.engine.observation import FilterView

Array = NDArray[np.float64]

_SURE = 5.0  # deviations
_SHORT = 0.03  # s: a delay that costs nothing
_SPAN, _LONGEST = 0.19, 1.1  # s over which the velocity's change is taken, at the least and at the most
_ENOUGH = 100  # messages after which the state is worth a word
_SETTLES = 3.0  # s after a return of GNSS, in which what it corrects is no change of the vehicle's velocity
_NO_CHANGE = np.zeros(3)


@dataclass
class DelayWatch:
    """``estimate`` and ``sd`` [s] of the filter's state ``dvl_delay`` as last seen, NaN deviation where it has none.

    Besides, while GNSS is good, a regression of innovations on the change of the velocity along each beam. Where the
    beams are used the filter follows them, and less than the whole delay is seen.
    """

    estimate: float = 0.0
    sd: float = math.nan
    variance: float = 0.0
    """What an uncertain change adds to the noise of a late velocity [m^2/s^2]; without it the delay is too small for
    its deviation while the velocity is vague."""
    sums: Array = field(default_factory=lambda: np.zeros(4))
    _past: deque[tuple[float, Array]] = field(default_factory=deque)  # s, velocity at the sensor in b
    _changes: int = 0
    _gnss_was_good: bool = True
    _settled: float = -math.inf  # s

    def change(self, t: float, f: FilterView, lever: Array, gnss_is_good: bool) -> Array:
        """Mean change (3,) until ``t`` [s] of the velocity at ``lever`` (3,) [m], b [m/s^2]; zero where not known.

        By differences over two tenths of a second, or from one message to the next where these come more slowly:
        vibration does not show in them, and they are as good for a delay as a line between the two is.
        """
        if not DVL_DELAY.is_in(f.constants):
            return _NO_CHANGE
        state = DVL_DELAY.states(f.constants).start
        self.estimate, self.sd = float(f.nav[DVL_DELAY.nav]), math.sqrt(f.P[state, state])
        if gnss_is_good and not self._gnss_was_good:
            self._settled = t + _SETTLES
        self._gnss_was_good = gnss_is_good
        velocity, past = velocity_at(f.nav, lever), self._past
        if t < self._settled or (past and past[-1][0] >= t):
            past.clear()
        while len(past) > 1 and past[1][0] <= t - _SPAN:
            past.popleft()
        change, self.variance = _NO_CHANGE, 0.0
        if past and t - past[0][0] <= _LONGEST:
            span = t - past[0][0]
            change = (velocity - past[0][1]) / span
            of_change = float(f.P.diagonal()[DVEL : DVEL + 3].max()) / span**2
            self._changes += 1
            self.variance = (self.estimate**2 + self.sd**2) * of_change
        past.append((t, velocity))
        return change

    def add(self, z: Array, H: Array, f: FilterView) -> None:
        """Innovations ``z`` (n,) [m/s], estimate minus measurement, NaN where lost, with their rows ``H``."""
        add_delay(self.sums, z, H, f.nav)

    @property
    def missing(self) -> float:
        """Stamp minus time of validity [s] beyond ``aids.beams.delay``; 0 where none is certain."""
        if not math.isnan(self.sd):
            is_certain = self._changes > _ENOUGH and abs(self.estimate) > max(_SHORT, _SURE * self.sd)
            return self.estimate if is_certain else 0.0
        product, slopes, squares, count = self.sums.tolist()
        if slopes == 0.0:
            return 0.0
        delay = product / slopes
        left = max(squares - delay * product, 0.0) / max(count, 1.0)
        return delay if abs(delay) > max(_SHORT, _SURE * math.sqrt(left / slopes)) else 0.0
