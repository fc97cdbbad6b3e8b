"""Monitor of the accuracy that a receiver states, with events where it is optimistic."""

from __future__ import annotations

import math

import numpy as np

from nav_pose_estimator.core.filter.measurement_noise import NoiseModel
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.observation import Observation
from nav_pose_estimator.engine.solutions import Level

_TOO_LARGE, _FINE = 9.0, 4.0  # variance factors (3 and 2 times the deviation) at which optimism begins and ends
_LASTS = 10.0  # s for which the factor must be too large


class StatedAccuracy:
    """Monitors the factor that a noise model has estimated on the variance of ``what``."""

    def __init__(self, what: str) -> None:
        self._what = what
        self._since = math.inf  # s: from when on it has been too large
        self._optimistic = False

    def lasting(self, o: Observation, stated: np.ndarray, noise: NoiseModel, journal: Journal) -> np.ndarray:
        """R for the tests of ``o``: ``stated``, or that of ``noise`` where the receiver has been optimistic for long.

        In a short burst of errors it is better to reject fixes than to enlarge their noise.
        """
        self._update(o, noise.factor, journal)
        return noise.expected(stated) if self._optimistic else stated

    def _update(self, o: Observation, factor: float, journal: Journal) -> None:
        """Process the ``factor`` before ``o``; a lasting change gives one event."""
        if factor <= (_FINE if self._optimistic else _TOO_LARGE):
            self._since = math.inf
            if self._optimistic:
                text = f"GNSS {self._what}: errors are about as large as the receiver states again"
                journal.say(o.stamp_ns, "gnss.noise.agrees", Level.INFO, text)
            self._optimistic = False
            return
        self._since = min(self._since, o.t)
        if not self._optimistic and o.t - self._since >= _LASTS:
            self._optimistic = True
            times = math.sqrt(factor)
            text = f"GNSS {self._what}: errors are {times:.1f} times as large as the receiver states"
            journal.say(o.stamp_ns, "gnss.noise.optimistic", Level.WARN, text, factor=factor)
