"""What says that GNSS may be elsewhere than the vehicle, beside jumps and pulls: to be told, and covered by sigma."""

from __future__ import annotations

import math
from collections.abc import Sequence

from nav_pose_estimator.core.gnss.spoof_drift import WalkOff
from nav_pose_estimator.core.gnss.two_places import TwoPlaces
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.observation import Observation
from nav_pose_estimator.engine.sensors.gnss.latency import Latency
from nav_pose_estimator.engine.sensors.gnss.other_motion import OtherMotion
from nav_pose_estimator.engine.sensors.gnss.rounding import Rounding
from nav_pose_estimator.engine.solutions import Level

_AGREES = 8.0  # s in a row after which a drift has ended: single fixes of a noisy receiver come and go


class Elsewhere:
    """Positions that leave their velocities, are rounded or of two places, or move otherwise than the IMU feels."""

    def __init__(self, journal: Journal, rounding: Rounding) -> None:
        self._journal, self._rounding = journal, rounding
        self.other_motion, self.latency = OtherMotion(journal), Latency(journal)
        self._walk_off, self._two_places = WalkOff(), TwoPlaces()
        self._drifted = math.nan  # s: when fixes last drifted away; NaN once that has ended

    @property
    def is_on(self) -> bool:
        """Whether any of them says so."""
        told = self.other_motion.is_on or self.latency.is_on or self._walk_off.is_on
        return told or self._two_places.apart > 0.0 or self._rounding.is_on

    def least_sd(self, speed: float) -> tuple[float, float, float]:
        """Deviations of the position [m], horizontal and vertical, and of the horizontal velocity [m/s].

        Of a vehicle of this horizontal ``speed`` [m/s].
        """
        far, fast = self.other_motion.least_sd()
        late = self.latency.least_sd(speed)
        known = (self._walk_off.least_sd, self._two_places.least_sd, self._rounding.least_sd)
        return max(far, late, *known), far, fast

    def reason(self) -> str:
        """Why the position is not to be believed as usual, a clause; empty if it is."""
        told = self._two_places.reason or self._rounding.reason
        told = told or self.other_motion.reason() or self.latency.reason()
        return told or self._walk_off.reason

    def fix(self, east: float, north: float, stamp_ns: int) -> None:
        """A fix lies so far [m] from where the navigator expects it, whatever becomes of it."""
        was = self._two_places.apart
        self._two_places.note(east, north)
        if self._two_places.apart and not was:
            self._journal.say(stamp_ns, "gnss.two_places", Level.ERROR, self._two_places.reason)
        elif was and not self._two_places.apart:
            text = "GNSS fixes lie in one place again"
            self._journal.say(stamp_ns, "gnss.two_places.ended", Level.INFO, text)

    def used(self, o: Observation, fix: Sequence[float], velocity: Sequence[float] | None, scatter: float) -> None:
        """A ``fix`` (3,) [m] is used; its own ``velocity`` (3,) [m/s], and how far two may differ by chance [m]."""
        speed = self._walk_off.update(o.t, fix, velocity, scatter)
        if speed > 0.0:
            self._journal.count("gnss.drift.fixes")
            if math.isnan(self._drifted):
                text = f"GNSS positions drift by {speed:.1f} m/s against the receiver's own velocity: do not trust them"
                self._journal.say(o.stamp_ns, "gnss.drift", Level.WARN, text, speed=speed)
            self._drifted = o.t
        elif o.t - self._drifted > _AGREES:
            self._drifted = math.nan
            text = "GNSS positions agree with the receiver's velocity again"
            self._journal.say(o.stamp_ns, "gnss.drift.ended", Level.INFO, text)
