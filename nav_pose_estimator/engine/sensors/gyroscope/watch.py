"""Watch over the gyroscope's scale, signs and axes: doubt as soon as the filter's own estimate contradicts its prior.

With the doubt the prior of the scale factors is released (``prior``): attitude and heading become as uncertain as an
unknown scale makes them, and the filter learns the scale from GNSS. The doubt ends when GNSS has agreed with the filter
for a while. Other signs or axes are beyond the filter's linear error model. ``engine.imu.motion_check`` suspects them
after one manoeuvre, which is a reason for doubt, too, and names them later. A bias that changes while the vehicle turns
steadily is taken for a scale: the two cannot be told apart there.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from nav_pose_estimator.core.alignment.gyro_evidence import GyroEvidence
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.solutions import Level

_CERTAIN = 8.0
"""Log Bayes factor from which the scale is wrong; see docs/plausibility.md for that of recorded flights."""
_SHOWN = -1.5  # log Bayes factor of a wrong yaw axis below which GNSS has shown it to be right, to about 7 %
_CALM, _CALM_FOR = 1.0, 20  # NIS per row of GNSS velocity, and s below it, that end a doubt
_ROUGH_FOR = 3  # s of a larger NIS, or a suspicion, with which the doubt returns
_LARGE, _LARGEST = 0.3, 0.7  # scale errors that motion has to confirm, and that the linear error model cannot follow
_CONFIRMED, _REFUTED = 6, 20  # seconds of manoeuvres in which GNSS agrees, after a large scale error, or a suspicion
_RIGHT, _KNOWN = 0.05, 0.1  # scale error that counts as none; deviation from which a scale is known
_CHANGED = math.radians(0.1)  # rad/s: smallest change of a bias that explains a doubt
_DIAGONAL = (0, 4, 8)  # scale factors in the matrix, row-major
_REASON = "the gyroscope's rates do not fit GNSS: attitude and heading are uncertain"
_DOUBT = (
    "the gyroscope's rates do not fit GNSS: its scale, signs or axes are probably wrong, or its bias has changed (by "
    "temperature, a shock, or with the force), or the stamps of GNSS are late; attitude and heading are uncertain "
    "until they fit"
)
_COMPASS = (
    "gyroscope and magnetometer turn differently: signs or axes of one of them are wrong; the heading is uncertain "
    "until GNSS shows which"
)
_AGAIN = "the navigator started again, so the gyroscope's scale has to be found again: until then it is in doubt"


class Second(NamedTuple):
    """What a second has shown of the gyroscope."""

    m: np.ndarray
    """Estimate (9,) of its matrix, row-major."""
    P: np.ndarray
    """Covariance (9, 9) of ``m``."""
    bias: np.ndarray
    """Estimated bias (3,) [rad/s]."""
    nis: float
    """Largest NIS per row of the last GNSS velocities."""
    walk: float = 0.0
    """Variance of the random walk of each element in a second."""
    suspected: bool = False
    """Whether other signs or axes explain what GNSS shows far better."""
    agrees: bool = False
    """Whether the IMU has measured the changes of velocity of a manoeuvre."""
    compass_differs: bool = False
    """Whether gyroscope and magnetometer turn differently, with wrong signs or axes of either."""


class GyroWatch:
    """The watch. It receives the filter's estimate of the gyroscope's matrix every second while GNSS aids it."""

    def __init__(self) -> None:
        self.evidence = GyroEvidence()
        self.reason = ""
        """Why the solution is less certain, one clause for the user; empty where it is not."""
        self.compass_reason = ""
        """The same for turns that the magnetometer contradicts while GNSS does not show which of the two is right."""
        self.contradicts = False
        """Whether the filter's own estimate is the reason."""
        self._is_wide = self._was_wide = False  # whether the filter's prior is released, and was before its restart
        self._suspected = False  # whether other signs or axes have been, since the doubt began
        self._is_compass_reported = False
        self._rough = 0
        self._calm = self._moved = 0  # s in which GNSS has agreed with the filter, and those of manoeuvres
        self._bias = np.zeros(3)  # before the doubt

    def filter_restarts(self) -> None:
        """The filter starts again with its narrow prior; what is known of the gyroscope stays."""
        self.evidence.begin_again()
        self._was_wide, self._is_wide = self._was_wide or self._is_wide, False
        self._calm = self._moved = 0

    def second(self, seen: Second, journal: Journal, stamp_ns: int) -> bool:
        """Add a second that has been ``seen``. True where the prior is to be released."""
        self.evidence.add(seen.m, seen.P, seen.nis, seen.walk)
        self._compare_with_compass(seen, journal, stamp_ns)
        proved = self.evidence.odds >= _CERTAIN  # not if the odds are NaN
        self._suspected |= seen.suspected
        self.contradicts |= proved and bool(self.reason or not self._is_wide)
        if self._is_wide:
            self._settle(seen, journal, stamp_ns)
            return False
        if not (proved or seen.suspected or self._was_wide):
            return False
        self._is_wide = True
        self.evidence.skip()
        if not self.reason:
            self._bias = seen.bias.copy()
            text = _AGAIN if self._was_wide else _DOUBT
            journal.say(stamp_ns, "imu.gyroscope.doubted", Level.WARN, text)
        self._was_wide = False
        self.reason = _REASON
        return True

    def _compare_with_compass(self, seen: Second, journal: Journal, stamp_ns: int) -> None:
        """Doubt the heading while the magnetometer contradicts a yaw axis of which GNSS has shown nothing."""
        if not seen.compass_differs or self.evidence.yaw_odds < _SHOWN:
            self.compass_reason = ""
        elif not self.compass_reason:
            self.compass_reason = "gyroscope and magnetometer turn differently: the heading is uncertain"
            if not self._is_compass_reported:
                journal.say(stamp_ns, "imu.gyroscope.compass", Level.WARN, _COMPASS)
            self._is_compass_reported = True

    def _settle(self, seen: Second, journal: Journal, stamp_ns: int) -> None:
        """End the doubt when GNSS has agreed with the filter for a while, and the estimate is one of scale factors."""
        if not self.reason:
            self._doubt_again(seen, journal, stamp_ns)
            return
        scales, sds = seen.m[[*_DIAGONAL]].tolist(), np.sqrt(seen.P.diagonal()[[*_DIAGONAL]]).tolist()
        largest = max(map(abs, scales))
        if seen.nis < _CALM and largest < _LARGEST and not seen.suspected:
            self._calm, self._moved = self._calm + 1, self._moved + seen.agrees
        else:
            self._calm = self._moved = 0
        # a hover shows nothing of signs and axes, and wrong ones look like a large scale error
        needed = _REFUTED if self._suspected else _CONFIRMED if largest > _LARGE else 0
        known = {axis: s for axis, s, sd in zip("xyz", scales, sds, strict=True) if sd < _KNOWN}
        if self._calm < _CALM_FOR or self._moved < needed or not known:
            return
        self.reason, self.contradicts, self._suspected = "", False, False
        if max(map(abs, known.values())) < _RIGHT:
            text = f"the gyroscope's rates fit GNSS again{self._changed(seen.bias)}"
            journal.say(stamp_ns, "imu.gyroscope.fits", Level.INFO, text)
            return
        # the filter multiplies the rates by 1 - s
        divisors = ", ".join(f"{1.0 / (1.0 - s):.2f} ({axis})" for axis, s in known.items())
        text = (
            f"the gyroscope fits GNSS when its rates are divided by {divisors}, which the navigator does from now on: "
            "check range and unit in the driver; in steady turns, a bias that has changed looks the same"
        )
        journal.say(stamp_ns, "imu.gyroscope.scale", Level.WARN, text)

    def _doubt_again(self, seen: Second, journal: Journal, stamp_ns: int) -> None:
        """The doubt returns when GNSS contradicts a filter whose prior is wide: what it has learned was wrong."""
        self._rough = self._rough + 1 if seen.nis > _CALM or seen.suspected else 0
        if self._rough < _ROUGH_FOR:
            return
        self.reason, self._bias = _REASON, seen.bias.copy()
        self._calm = self._moved = self._rough = 0
        text = "the gyroscope's rates fit GNSS no longer: attitude and heading are uncertain until they do"
        journal.say(stamp_ns, "imu.gyroscope.doubted", Level.WARN, text)

    def _changed(self, bias: np.ndarray) -> str:
        """Clause on a bias [rad/s] that has changed since the doubt began; empty where it has not."""
        change = bias - self._bias
        axis = int(np.abs(change).argmax())
        if abs(change[axis]) < _CHANGED:
            return ""
        return f": its bias about {'xyz'[axis]} has changed by {math.degrees(change[axis]):.2f} deg/s"
