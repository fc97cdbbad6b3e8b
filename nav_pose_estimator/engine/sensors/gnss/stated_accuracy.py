"""Whether the receiver is as accurate as it states, and what to say when it is not."""

from __future__ import annotations

import math

from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.observation import Observation
from nav_pose_estimator.engine.solutions import Level

_TOO_LARGE, _FINE = 9.0, 4.0  # factors on the variance: three and two times the deviation
_LASTS = 10.0  # s


class StatedAccuracy:
    """Watches the factor that a noise model has found on the variance of ``what``."""

    def __init__(self, what: str) -> None:
        self._what = what
        self._since = math.inf  # s: from when on it has been too large
        self._said = False

    def update(self, o: Observation, factor: float, journal: Journal) -> None:
        """``factor`` as it stood when ``o`` was used; a change that lasts is told once."""
        if factor <= (_FINE if self._said else _TOO_LARGE):
            self._since = math.inf
            if self._said:
                text = f"GNSS {self._what}: errors are about as large as the receiver states again"
                journal.say(o.stamp_ns, "gnss.noise.agrees", Level.INFO, text)
            self._said = False
            return
        self._since = min(self._since, o.t)
        if not self._said and o.t - self._since >= _LASTS:
            self._said = True
            times = math.sqrt(factor)
            text = f"GNSS {self._what}: errors are {times:.1f} times as large as the receiver states"
            journal.say(o.stamp_ns, "gnss.noise.optimistic", Level.WARN, text, factor=factor)
