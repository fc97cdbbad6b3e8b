"""Check of the magnetic heading against the heading that GNSS motion shows, in preparation for an outage."""

from __future__ import annotations

import math

from nav_pose_estimator.core.attitude.compass_swing import CompassSwing

_TURNED = math.radians(45.0)  # mean error above which the heading is doubted: more than an unset declination explains
_STRAIGHT = math.radians(30.0)  # mean error below which that doubt ends
_SPREAD, _CALM = math.radians(25.0), math.radians(12.0)  # RMS about the mean at which a doubt begins and ends
_SPREAD_MEMORY = 20.0  # s over which that RMS is averaged
_SWING_MEMORY = 100.0  # s: memory of the compass swing
_MIN_TIME = 5.0  # s of comparison before a doubt
_PERSISTENCE = 10.0  # s that a doubt has to last before it is reported
CURE = "calibrate it (docs/calibration.md)"


def single_cause(angle: float) -> str:
    """Likely cause of a heading error ``angle`` [rad], magnetic minus true, before the vehicle has turned."""
    quarters = round(angle / (0.5 * math.pi))
    if quarters and abs(angle - quarters * 0.5 * math.pi) < math.radians(15.0):
        return f"the magnetometer is mounted {90 * abs(quarters)} deg off (aids.magnetometer_rpy), or hard iron"
    return "hard iron (attitude.hard_iron), or a magnetometer that is mounted differently (aids.magnetometer_rpy)"


class CompassCheck:
    """Monitors mean and RMS of the magnetic heading's error; ``doubted`` while the heading must not be used.

    A doubt takes effect at once, but is reported only when it lasts: just after a start the filter may be wrong.
    """

    def __init__(self, is_rejected: bool = False) -> None:
        """``is_rejected``: motion has disproved the magnetometer's heading at the start; the doubt is permanent."""
        self._swing = CompassSwing(_SWING_MEMORY)
        self._seconds = 0.0
        self._square = 0.0
        self.is_rejected = is_rejected
        self._is_turned = False
        self._is_unsteady = False
        self._doubt_lasts = 0.0
        self._is_reported = is_rejected
        self._cause_is_reported = False

    @property
    def doubted(self) -> bool:
        """Whether the magnetic heading must not be used."""
        return self.is_rejected or self._is_turned or self._is_unsteady

    @property
    def spread(self) -> float:
        """RMS [rad] of the magnetic heading's recent errors about their mean."""
        return math.sqrt(self._square)

    def add(self, north: complex, field: complex, offset: float, deviation: float, seconds: float) -> tuple[str, str]:
        """Add a comparison, ``seconds`` after the last one; returns name and sentence of an event, empty for none.

        ``north`` and ``field`` as in ``CompassSwing``; ``offset`` [rad] is the mean error so far, ``deviation`` [rad]
        the difference of this error from it.
        """
        self._seconds += seconds
        self._square += min(seconds / min(self._seconds, _SPREAD_MEMORY), 1.0) * (deviation**2 - self._square)
        self._swing.add(north, field, seconds)
        if self._seconds < _MIN_TIME:
            return "", ""
        self._is_turned = abs(offset) > (_STRAIGHT if self._is_turned else _TURNED)
        self._is_unsteady = self.spread > (_CALM if self._is_unsteady else _SPREAD)
        if not self.doubted:
            was_reported, self._is_reported, self._doubt_lasts = self._is_reported, False, 0.0
            return (
                ("mag.heading.agrees", "the magnetic heading agrees with the motion again")
                if was_reported
                else ("", "")
            )
        self._doubt_lasts += seconds
        if self._is_reported:
            return self._cause()
        return self._doubt(offset) if self._doubt_lasts >= _PERSISTENCE else ("", "")

    def _doubt(self, offset: float) -> tuple[str, str]:
        cause = self._swing.cause()
        self._is_reported, self._cause_is_reported = True, bool(cause)
        if self._is_turned:
            how = f"differs by {math.degrees(abs(offset)):.0f} deg from the heading that motion shows"
            cause = cause or single_cause(offset)
        else:
            how = f"varies by {math.degrees(self.spread):.0f} deg (rms) about the heading that motion shows"
            cause = cause or "iron or currents that turn with the vehicle"
        text = f"the magnetic heading {how}; likely cause: {cause}; it is not used, {CURE}"
        return "mag.heading.disagrees", text

    def _cause(self) -> tuple[str, str]:
        """Event with the cause, once, when turns have revealed it."""
        cause = "" if self._cause_is_reported else self._swing.cause()
        if not cause:
            return "", ""
        self._cause_is_reported = True
        return "mag.heading.cause", f"cause of the wrong magnetic heading, from the turns so far: {cause}; {CURE}"
