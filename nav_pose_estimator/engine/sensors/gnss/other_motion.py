"""Uncertainty of the position while GNSS and IMU contradict each other."""

from __future__ import annotations

from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.solutions import Level

_CREDIBLE = 2.0  # standard deviations that cover both the position of GNSS and that of the IMU
_BEFORE = 9.0  # s from the beginning of a contradiction until it is established


class OtherMotion:
    """Keeps the possible error: the position still follows GNSS, and its sigma covers the distance to the IMU's motion.

    It is not known which of the two is right.
    """

    def __init__(self, journal: Journal) -> None:
        self._journal = journal
        self._way, self._speed, self._share = 0.0, 0.0, 0.0  # m, m/s, unexplained fraction of the variation
        self.is_on = False

    def second(self, is_contradicted: bool, apart: float, share: float, stamp_ns: int) -> None:
        """Process the verdict of a second: difference ``apart`` [m/s] and unexplained ``share`` in the last window."""
        if is_contradicted and not self.is_on:
            self.is_on, self._speed, self._way, self._share = True, apart, apart * _BEFORE, share
            text = f"{self.reason()}; the position still follows GNSS, and its sigma grows"
            self._journal.say(stamp_ns, "gnss.other_motion", Level.ERROR, text, speed=apart)
        elif self.is_on and not is_contradicted:
            self.is_on, self._way, self._speed = False, 0.0, 0.0
            text = "GNSS and IMU tell the same motion again"
            self._journal.say(stamp_ns, "gnss.other_motion.ended", Level.INFO, text)
        elif self.is_on and apart:
            self._speed, self._share = apart, share
            self._way += apart

    def least_sd(self) -> tuple[float, float]:
        """Floors of the standard deviations of position [m] and velocity [m/s] on each horizontal axis."""
        return self._way / _CREDIBLE, self._speed / _CREDIBLE

    def reason(self) -> str:
        """Why the position is less certain than usual, one clause for the user; empty where it is not."""
        if not self.is_on:
            return ""
        percent = 100.0 * min(self._share, 1.0)
        return (
            f"GNSS and IMU tell different motions ({percent:.0f} % of the changes of velocity unexplained): "
            "fixes of a base station or of another vehicle, a frozen or spoofed receiver, or a failing IMU"
        )
