"""GNSS that tells another motion than the IMU feels: what that says of the position."""

from __future__ import annotations

from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.solutions import Level

_CREDIBLE = 2.0  # deviations that cover both where GNSS is and where the IMU would be
_BEFORE = 9.0  # s that a proof takes


class OtherMotion:
    """Nobody knows whether GNSS or IMU is right; the position follows GNSS, and its sigma covers what lies between."""

    def __init__(self, journal: Journal) -> None:
        self._journal = journal
        self._way, self._speed, self._share = 0.0, 0.0, 0.0  # m, m/s, of what varies
        self.is_on = False

    def second(self, is_contradicted: bool, apart: float, share: float, stamp_ns: int) -> None:
        """Whether GNSS and IMU tell different motions; by ``apart`` [m/s] and this ``share`` in the last seconds."""
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
        """Deviations that cover where the vehicle may be [m] and how it may move [m/s], on each horizontal axis."""
        return self._way / _CREDIBLE, self._speed / _CREDIBLE

    def reason(self) -> str:
        """Why the position is not to be believed as usual, a clause; empty if it is."""
        if not self.is_on:
            return ""
        percent = 100.0 * min(self._share, 1.0)
        return (
            f"GNSS and IMU tell different motions ({percent:.0f} % of the changes of velocity unexplained): "
            "fixes of a base station or of another vehicle, a frozen or spoofed receiver, or a failing IMU"
        )
