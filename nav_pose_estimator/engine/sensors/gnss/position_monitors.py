"""Monitors of GNSS positions that may differ from the vehicle's: their events and floors of the standard deviations."""

from __future__ import annotations

import math
from collections.abc import Sequence

from nav_pose_estimator.core.gnss.spoof_drift import WalkOff
from nav_pose_estimator.core.gnss.two_places import TwoPlaces
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.observation import Observation
from nav_pose_estimator.engine.sensors.gnss.digits import Rounding
from nav_pose_estimator.engine.sensors.gnss.latency import Latency
from nav_pose_estimator.engine.sensors.gnss.other_motion import OtherMotion, RestDrift
from nav_pose_estimator.engine.sensors.gnss.stated_accuracy import Scatter
from nav_pose_estimator.engine.solutions import Level

_REST_SPEED = 0.3  # m/s: largest speed of a receiver at rest
_AGREES = 8.0  # s without a drifting fix after which a drift has ended


class PositionMonitors:
    """Positions that drift from their velocities, are rounded, alternate between two places, or contradict the IMU."""

    def __init__(self, journal: Journal, rounding: Rounding, scatter: Scatter) -> None:
        self._journal, self._rounding, self._scatter = journal, rounding, scatter
        self.other_motion, self.latency = OtherMotion(journal), Latency(journal)
        self._walk_off, self._two_places, self._rest_drift = WalkOff(), TwoPlaces(), RestDrift()
        # which of the tests of single fixes have a finding; once a second, because fixes act many at once in a replay
        self._found: list[WalkOff | TwoPlaces] = []
        self._speed = math.inf  # m/s, of the receiver at the last used fix
        self._last_drift = math.nan  # s: when fixes last drifted away; NaN once that has ended

    @property
    def is_on(self) -> bool:
        """Whether any of the monitors has a finding, which has acted on the filter from the last second on."""
        if self._found or self._rounding.is_on or self._scatter.is_on or self._rest_drift.is_on:
            return True
        return self.other_motion.is_on or self.latency.is_on

    def least_sd(self, speed: float) -> tuple[float, float, float]:
        """Floors of the standard deviations of position [m], horizontal and vertical, and horizontal velocity [m/s].

        ``speed`` [m/s]: horizontal speed of the vehicle.
        """
        position, velocity_sd = self.other_motion.least_sd()
        latency = self.latency.least_sd(speed)
        horizontal, vertical = self._scatter.least_sd
        others = (test.least_sd for test in (*self._found, self._rounding, self._rest_drift))
        return max(position, latency, horizontal, *others), max(position, vertical), velocity_sd

    def reason(self) -> str:
        """Why the position is less certain than usual, one clause for the user; empty where it is not."""
        reason = self._two_places.reason or self._rounding.reason or self._scatter.reason
        reason = reason or self.other_motion.reason() or self.latency.reason()
        return reason or self._walk_off.reason or self._rest_drift.reason

    def second(self, t: float, is_still: bool) -> None:
        """Process a second up to ``t`` [s] in which the IMU shows rest, or not."""
        self._rest_drift.second(t, is_still and self._speed < _REST_SPEED)
        tests: tuple[WalkOff | TwoPlaces, ...] = (self._walk_off, self._two_places)
        self._found = [test for test in tests if test.least_sd > 0.0]

    def fix(self, east: float, north: float, stamp_ns: int) -> None:
        """Process a fix, used or not, that is this far [m] (East, North) from the navigator."""
        was = self._two_places.apart
        self._two_places.note(east, north)
        if self._two_places.apart and not was:
            self._journal.say(stamp_ns, "gnss.two_places", Level.ERROR, self._two_places.reason)
        elif was and not self._two_places.apart:
            text = "GNSS fixes lie in one place again"
            self._journal.say(stamp_ns, "gnss.two_places.ended", Level.INFO, text)

    def used(self, o: Observation, fix: Sequence[float], velocity: Sequence[float] | None, scatter: float) -> None:
        """Process a used ``fix`` (3,) [m] with its ``velocity`` (3,) [m/s]; ``scatter`` [m]: noise between fixes."""
        self._rest_drift.fix(fix[0], fix[1], scatter)
        self._speed = math.inf if velocity is None else math.hypot(velocity[0], velocity[1])
        speed = self._walk_off.update(o.t, fix, velocity, scatter)
        if speed > 0.0:
            self._journal.count("gnss.drift.fixes")
            if math.isnan(self._last_drift):
                text = f"GNSS positions drift by {speed:.1f} m/s against the receiver's own velocity: do not trust them"
                self._journal.say(o.stamp_ns, "gnss.drift", Level.WARN, text, speed=speed)
            self._last_drift = o.t
        elif o.t - self._last_drift > _AGREES:
            self._last_drift = math.nan
            text = "GNSS positions agree with the receiver's velocity again"
            self._journal.say(o.stamp_ns, "gnss.drift.ended", Level.INFO, text)
