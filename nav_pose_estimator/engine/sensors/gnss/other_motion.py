"""Uncertainty of the position while GNSS and IMU contradict each other."""

from __future__ import annotations

import math

from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.solutions import Level

_CREDIBLE = 2.0  # standard deviations that cover both the position of GNSS and that of the IMU
_BEFORE = 9.0  # s from the beginning of a contradiction until it is established
_NEWEST = 0.2  # weight of the newest fix in the running mean
_MOVED = 4.0  # m: smallest motion at rest that counts; recorded flights: 2.6 m at most
_CHANCE_FACTOR = 1.6  # the same relative to the distance of two fixes due to their stated noise
_FURTHER = 1.1  # relative growth at which the floor is raised
_HOLDS = 20.0  # s for which the floor is kept after it was last raised


class OtherMotion:
    """Keeps the possible error: the position still follows GNSS, and its sigma covers the distance to the IMU's motion.

    It is not known which of the two is right.
    """

    def __init__(self, journal: Journal) -> None:
        self._journal = journal
        self._distance, self._speed, self._share = 0.0, 0.0, 0.0  # m, m/s, unexplained fraction of the variation
        self.is_on = False

    def second(self, is_contradicted: bool, apart: float, share: float, stamp_ns: int) -> None:
        """Process the verdict of a second: difference ``apart`` [m/s] and unexplained ``share`` in the last window."""
        if is_contradicted and not self.is_on:
            self.is_on, self._speed, self._distance, self._share = True, apart, apart * _BEFORE, share
            text = f"{self.reason()}; the position still follows GNSS, and its sigma grows"
            self._journal.say(stamp_ns, "gnss.other_motion", Level.ERROR, text, speed=apart)
        elif self.is_on and not is_contradicted:
            self.is_on, self._distance, self._speed = False, 0.0, 0.0
            text = "GNSS and IMU tell the same motion again"
            self._journal.say(stamp_ns, "gnss.other_motion.ended", Level.INFO, text)
        elif self.is_on and apart:
            self._speed, self._share = apart, share
            self._distance += apart

    def least_sd(self) -> tuple[float, float]:
        """Floors of the standard deviations of position [m] and velocity [m/s] on each horizontal axis."""
        return self._distance / _CREDIBLE, self._speed / _CREDIBLE

    def reason(self) -> str:
        """Why the position is less certain than usual, one clause for the user; empty where it is not."""
        if not self.is_on:
            return ""
        percent = 100.0 * min(self._share, 1.0)
        return (
            f"GNSS and IMU tell different motions ({percent:.0f} % of the changes of velocity unexplained): "
            "fixes of a base station or of another vehicle, a frozen or spoofed receiver, or a failing IMU"
        )


class RestDrift:
    """Positions that move while IMU and GNSS velocity show rest, as those of a receiver that converges after its start.

    The distance moved is the floor of the position error, because the first fixes were wrong by at least that much.
    """

    def __init__(self) -> None:
        self._place: complex | None = None  # m: mean of the last fixes, East + i North
        self._first: complex | None = None  # m: the same at the beginning of the rest
        self._chance = 0.0  # m
        self._until = -math.inf  # s
        self.least_sd = 0.0
        """Floor of the standard deviation [m] on each axis."""

    @property
    def is_on(self) -> bool:
        """Whether positions have moved at rest."""
        return self.least_sd > 0.0

    def fix(self, east: float, north: float, chance: float) -> None:
        """Process a used fix [m] in any level frame; ``chance`` [m]: distance of two fixes due to their noise."""
        place, self._chance = complex(east, north), chance
        self._place = place if self._place is None else self._place + _NEWEST * (place - self._place)

    def second(self, t: float, rests: bool) -> None:
        """Compare with the beginning of the rest, every second; ``t`` [s], ``rests``: IMU and velocity show rest."""
        if self.is_on and t > self._until:
            self.least_sd, self._first = 0.0, None
        if not rests or self._place is None or self._first is None:
            self._first = self._place if rests else None
            return
        moved = abs(self._place - self._first)
        if moved > max(_MOVED, _CHANCE_FACTOR * self._chance, _FURTHER * self.least_sd):
            self.least_sd, self._until = moved, t + _HOLDS

    @property
    def reason(self) -> str:
        """Why the position is less certain than usual, one clause for the user; empty where it is not."""
        return f"GNSS positions have moved by {self.least_sd:.0f} m while the vehicle stood" if self.is_on else ""
