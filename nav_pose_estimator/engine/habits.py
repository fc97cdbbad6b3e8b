"""What the flight so far lets expect of the next minute: the vehicle will move as it has moved, about where it is.

While GNSS is good the class watches speed and position; during an outage it gives, once a second, a zero-mean velocity
prior as wide as the recent speed and, on request, a position prior at the last trusted position as wide as the recent
range. Both are honest pseudo-measurements of the filter. A vehicle that never slows down (a fixed wing) does not hover
when GNSS goes: for it the prior is withheld, and ``reason`` says so.

Strictly causal: nothing after the loss of GNSS is learned from.
"""

from __future__ import annotations

import copy
import math
from collections import deque

import numpy as np

from nav_pose_estimator.core import layout as at
from nav_pose_estimator.core.earth import radii
from nav_pose_estimator.engine.modes import DENIED
from nav_pose_estimator.engine.parameters.learner import LearnerParameters
from nav_pose_estimator.engine.samples import Prior
from nav_pose_estimator.engine.solutions import Mode, NavBlock, NavSolution

_SECOND_NS = 1_000_000_000
_MEMORY = 120  # s of flight that show whether the vehicle ever slows down
_ENOUGH = 20  # s of flight below which nothing is known


class Habits:
    """Priors of horizontal velocity and position from the flight so far."""

    def __init__(self, parameters: LearnerParameters) -> None:
        self._parameters = parameters
        self._seconds: deque[tuple[float, float, float, float]] = deque(maxlen=_MEMORY)  # lat, lon [rad], v_E, v_N
        self._second = 0
        self._anchor: tuple[float, float] | None = None
        self.reason = "no flight has been seen yet"

    def copy(self) -> Habits:
        """An independent copy."""
        twin = copy.copy(self)
        twin._seconds = self._seconds.copy()
        return twin

    def reset(self) -> None:
        """Forget the flight."""
        self.__init__(self._parameters)  # type: ignore[misc]

    def feed(self, output: NavBlock | NavSolution) -> list[Prior]:
        """Learn from an aided solution, or give the priors that are due in an outage."""
        stamp = output.stamp_ns if isinstance(output, NavSolution) else int(output.stamps_ns[-1])
        if stamp // _SECOND_NS == self._second or output.mode not in (*DENIED, Mode.AIDED):
            return []
        self._second = stamp // _SECOND_NS
        lat, lon, v_east, v_north = _horizontal(output)
        if output.mode is Mode.AIDED:
            self._seconds.append((lat, lon, v_east, v_north))
            self._anchor = (lat, lon)
            return []
        return self._priors(stamp)

    def _priors(self, stamp: int) -> list[Prior]:
        seen = np.array(self._seconds)
        if len(seen) < _ENOUGH:
            self.reason = f"only {len(seen)} s of flight with GNSS have been seen"
            return []
        slow = float(np.percentile(np.hypot(seen[:, 2], seen[:, 3]), 10.0))
        if slow > self._parameters.slow_speed:
            self.reason = f"the vehicle does not slow down (90 % of the flight above {slow:.1f} m/s)"
            return []
        self.reason = ""
        square = np.square(seen[:, 2:]).sum(axis=1)
        # a vehicle that hovers now but has flown before may fly again
        mean_square = max(float(square[-30:].mean()), self._parameters.habit_share * float(square.mean()))
        variance = max(0.5 * mean_square * self._parameters.velocity_prior_weight, 0.05**2)
        priors = [Prior(stamp, "horizontal_velocity", (0.0, 0.0), variance * np.eye(2))]
        if self._parameters.method == "best":
            priors.append(self._position_prior(stamp, seen[-60:]))
        return priors

    def _position_prior(self, stamp: int, recent: np.ndarray) -> Prior:
        lat, lon = self._anchor or (recent[-1, 0], recent[-1, 1])
        r_m, r_n = radii(lat)
        spread = np.var(recent[:, 0]) * r_m**2 + np.var(recent[:, 1]) * (r_n * math.cos(lat)) ** 2
        variance = self._parameters.position_prior_weight * (1.0 + 0.5 * float(spread))
        return Prior(stamp, "horizontal_position", (lat, lon), variance * np.eye(2))


def _horizontal(output: NavBlock | NavSolution) -> tuple[float, float, float, float]:
    if isinstance(output, NavSolution):
        return output.lat, output.lon, float(output.vel_n[0]), float(output.vel_n[1])
    row = output.rows[-1]
    return float(row[at.OUT_POS]), float(row[at.OUT_POS + 1]), float(row[at.OUT_VEL]), float(row[at.OUT_VEL + 1])
