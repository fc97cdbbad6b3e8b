"""Watch over the gyroscope's scale, signs and axes: doubt as soon as the filter's own estimate contradicts its prior.

With the doubt the prior of the scale factors is released (``prior``): attitude and heading become as uncertain as an
unknown scale makes them, and the filter learns the scale from GNSS. The doubt ends when GNSS has agreed with the filter
for a while. Other signs or axes stay in doubt, until ``engine.imu.motion_check`` names them. A bias that changes while
the vehicle turns steadily is taken for a scale: the two cannot be told apart there.
"""

from __future__ import annotations

import numpy as np

from nav_pose_estimator.core.alignment.gyro_evidence import GyroEvidence
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.solutions import Level

_CERTAIN = 8.0
"""Log Bayes factor from which the scale is wrong; see docs/plausibility.md for that of recorded flights."""
_CALM, _CALM_FOR = 1.0, 20  # NIS per row of GNSS velocity, and s below it, that end a doubt
_LARGEST = 0.7  # largest scale error that the linear error model can follow
_RIGHT, _KNOWN = 0.05, 0.1  # scale error that counts as none; deviation from which a scale is known
_DIAGONAL = (0, 4, 8)  # scale factors in the matrix, row-major


class GyroWatch:
    """The watch. It receives the filter's estimate of the gyroscope's matrix every second while GNSS aids it."""

    def __init__(self) -> None:
        self.evidence = GyroEvidence()
        self.reason = ""
        """Why the solution is less certain, one clause for the user; empty where it is not."""
        self._is_wide = self._was_wide = False  # whether the filter's prior is released, and was before its restart
        self._calm = 0

    def filter_restarts(self) -> None:
        """The filter starts again with its narrow prior; what is known of the gyroscope stays."""
        self.evidence.begin_again()
        self._was_wide, self._is_wide, self._calm = self._was_wide or self._is_wide, False, 0

    def second(self, m: np.ndarray, P: np.ndarray, nis: float, journal: Journal, stamp_ns: int) -> bool:
        """Add a second with the estimate ``m`` (9,) of covariance ``P`` (9, 9).

        ``nis``: largest NIS per row of the last GNSS velocities. True where the prior is to be released.
        """
        self.evidence.add(m, P, nis)
        if self._is_wide:
            self._settle(m, P, nis, journal, stamp_ns)
            return False
        if not (self.evidence.odds >= _CERTAIN or self._was_wide):  # nor if the odds are NaN
            return False
        self._is_wide, self._was_wide = True, False
        self.evidence.skip()
        self.reason = "the gyroscope's rates do not fit GNSS: attitude and heading are uncertain"
        text = (
            "the gyroscope's rates do not fit GNSS: its scale, signs or axes are probably wrong, or its bias has "
            "changed, or the stamps of GNSS are late; attitude and heading are uncertain until they fit"
        )
        journal.say(stamp_ns, "imu.gyroscope.doubted", Level.WARN, text)
        return True

    def _settle(self, m: np.ndarray, P: np.ndarray, nis: float, journal: Journal, stamp_ns: int) -> None:
        """End the doubt when GNSS has agreed with the filter for a while, and the estimate is one of scale factors."""
        if not self.reason:
            return
        scales, sds = m[[*_DIAGONAL]].tolist(), np.sqrt(P.diagonal()[[*_DIAGONAL]]).tolist()
        follows = nis < _CALM and max(map(abs, scales)) < _LARGEST
        self._calm = self._calm + 1 if follows else 0
        known = {axis: s for axis, s, sd in zip("xyz", scales, sds, strict=True) if sd < _KNOWN}
        if self._calm < _CALM_FOR or not known:
            return
        self.reason = ""
        if max(map(abs, known.values())) < _RIGHT:
            journal.say(stamp_ns, "imu.gyroscope.fits", Level.INFO, "the gyroscope's rates fit GNSS again")
            return
        # the filter multiplies the rates by 1 - s
        divisors = ", ".join(f"{1.0 / (1.0 - s):.2f} ({axis})" for axis, s in known.items())
        text = (
            f"the gyroscope fits GNSS when its rates are divided by {divisors}, which the navigator does from now on: "
            "check range and unit in the driver; in steady turns, a bias that has changed looks the same"
        )
        journal.say(stamp_ns, "imu.gyroscope.scale", Level.WARN, text)
