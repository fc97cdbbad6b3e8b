"""Events of GNSS velocities that contradict positions, and of heights and positions that contradict velocities."""

from __future__ import annotations

import math

from nav_pose_estimator.core.gnss.climb_check import DOWN, OTHER
from nav_pose_estimator.core.gnss.climb_check import SILENT as UNFILLED
from nav_pose_estimator.core.gnss.velocity_check import VelocityCheck
from nav_pose_estimator.core.gnss.velocity_mistakes import NED, SILENT, TURNED, UNEXPLAINED, UNIT
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.solutions import Level

_NO_CLOCK = 0.3  # largest relative error of a clock; a larger scale error has another cause
_FAULTS = {
    NED: "its axes look like North-East-Down: set ros.input.velocity_frame to ned",
    TURNED: "it has the speed of the motion but another direction: its axes look like {name}, not East-North-Up",
    SILENT: "it {name} while the positions move: the driver does not fill it",
    UNIT: "it has the direction of the motion but not its speed: it looks like {name} instead of m/s",
    UNEXPLAINED: "it does not fit the motion of the positions",
}
_VERTICAL_FAULTS = {
    UNFILLED: "not used: it stays zero while the height changes: the driver does not fill it "
    "(ros.input.vertical_velocity: false)",
    DOWN: "inverted and used: it has the wrong sign, positive down",
    OTHER: "not used: heights and barometer agree that it is wrong (another unit?)",
}
_NAMES = {
    "body": "the vehicle's own",
    "North-East": "North-East-Down",
    "": "stays zero",
    "repeats": "repeats itself",
    "East": "stays zero on its first axis (East)",
    "North": "stays zero on its second axis (North)",
}
_POSITION_FAULTS = {
    "North-East": "latitude and longitude look exchanged",
    "West-North": "longitude looks inverted (West is negative)",
    "East-South": "latitude looks inverted (South is negative)",
}
"""Errors of positions, by the error of the velocity that would explain the contradiction equally well."""


_RADIANS = "they hardly move: latitude and longitude look like radians where degrees belong"
_FROZEN = "they hardly move: the receiver is frozen, or its positions are not this vehicle's"
_QUARTER, _HALF = math.radians(90.0), math.radians(180.0)

_SAME_DOUBT = 60.0  # s after a doubt in which another one is no news


class VelocityReport:
    """Reports each finding once."""

    def __init__(self, journal: Journal) -> None:
        self._journal = journal
        self._reported: tuple[str, str] = ("", "")
        self._vertical = self._height = ""
        self._is_scale_reported = self._is_correction_reported = False
        self._delay = 0.0  # s

    def horizontal(self, check: VelocityCheck, stamp_ns: int) -> None:
        """Report errors of the horizontal velocity (axes, unit), and their end."""
        if (check.fault, check.name) == self._reported:
            return
        self._reported, self._is_correction_reported = (check.fault, check.name), False
        if check.fault:
            why = _FAULTS[check.fault].format(name=_in_words(check.name))
            text = f"GNSS velocity not used: {why} ({check.misfit:.1f} m/s apart)"
            self._journal.say(stamp_ns, f"gnss.velocity.axes.{check.fault}", Level.ERROR, text)
        else:
            text = "GNSS velocity agrees with the motion between fixes again and is used"
            self._journal.say(stamp_ns, "gnss.velocity.axes.ended", Level.INFO, text)

    def corrected(self, check: VelocityCheck, stamp_ns: int) -> bool:
        """Report that an established error is corrected; returns whether that is new."""
        if self._is_correction_reported:
            return False
        self._is_correction_reported = True
        text = f"GNSS velocity is {_in_words(check.name)} beyond doubt: corrected and used"
        if check.fault == NED:
            text += "; set ros.input.velocity_frame to ned"
        self._journal.say(stamp_ns, "gnss.velocity.turned", Level.WARN, text)
        return True

    def vertical(self, check: VelocityCheck, stamp_ns: int) -> bool:
        """Report errors of vertical velocity and height; returns whether a new one has to be undone."""
        fault, new = check.climb.height_fault, False
        if fault and fault != self._height:
            self._height, new = fault, True
            standard = "barometer" if math.isfinite(check.climb.baro) else "receiver's vertical velocity"
            text = f"GNSS height not used: by the {standard} it is {fault}"
            self._journal.say(stamp_ns, "gnss.height.unit", Level.ERROR, text)
        fault = check.climb.fault
        if fault and fault != self._vertical:
            self._vertical, new = fault, True
            text = f"GNSS vertical velocity {_VERTICAL_FAULTS[fault]}"
            self._journal.say(stamp_ns, f"gnss.velocity.vertical.{fault}", Level.WARN, text)
        return new

    def lateness(self, delay: float, stamp_ns: int) -> bool:
        """Report the latency ``delay`` [s] of velocities; returns whether it is new."""
        if delay == self._delay:
            return False
        self._delay = delay
        text = "GNSS velocity belongs to the positions of its stamps again"
        if delay:
            text = f"GNSS velocity is about {delay:g} s late against the positions: used as of then"
        self._journal.say(stamp_ns, "gnss.velocity.late", Level.WARN if delay else Level.INFO, text, delay=delay)
        return True

    def scale(self, scale: float, stamp_ns: int) -> None:
        """Report a clock that is slow or fast."""
        if scale == 1.0 or abs(scale - 1.0) > _NO_CLOCK or self._is_scale_reported:
            return
        self._is_scale_reported = True
        amount, degree = 100.0 * abs(scale - 1.0), "farther" if scale > 1.0 else "less far"
        clock = f"{100.0 * abs(1.0 - 1.0 / scale):.1f} % {'slow' if scale > 1.0 else 'fast'}"
        text = (
            f"GNSS positions move {amount:.1f} % {degree} than velocities and stamps imply: the clock of the stamps "
            f"probably runs {clock}, else another unit"
        )
        self._journal.say(stamp_ns, "gnss.velocity.scale", Level.WARN, text, scale=scale)

    def positions(self, check: VelocityCheck, place: tuple[float, float], stamp_ns: int) -> str:
        """Error of the positions where the IMU confirms the velocity as received; empty if no known error fits.

        ``place``: latitude and longitude as received [deg].
        """
        fault = _POSITION_FAULTS.get(check.name, "")
        if check.stands_still:
            fault = _RADIANS if abs(place[0]) <= _QUARTER and abs(place[1]) <= _HALF else _FROZEN
        if fault:
            text = f"GNSS positions not used: the IMU confirms the velocity as it is received: {fault}"
            self._journal.say(stamp_ns, "gnss.position.axes", Level.ERROR, text)
        return fault


class DoubtReport:
    """Events of the doubt between navigator and GNSS. One that comes back within a minute is counted only: the status
    shows it, and it has the same cause."""

    def __init__(self, journal: Journal) -> None:
        self._journal = journal
        self._ended, self._is_news = -math.inf, True  # s: end of the last doubt; whether the present one is told

    def note(self, t: float, stamp_ns: int, before: str, now: str, cause: str) -> None:
        """Report the reason ``now`` of the doubt at ``t`` [s], which was ``before``; ``cause``: a clause, or empty."""
        if now and not before:
            self._is_news = t - self._ended > _SAME_DOUBT
            likely = f" (likely cause: {cause})" if cause else ""
            self._tell(
                stamp_ns,
                "begun",
                Level.WARN,
                f"the navigator is in doubt: {now}{likely}; its sigma grows until they agree",
            )
        elif before and not now:
            self._ended = t
            self._tell(stamp_ns, "ended", Level.INFO, "navigator and GNSS agree again")

    def _tell(self, stamp_ns: int, what: str, level: Level, text: str) -> None:
        if self._is_news:
            self._journal.say(stamp_ns, f"doubt.{what}", level, text)
        else:
            self._journal.count(f"doubt.{what}")


def _in_words(name: str) -> str:
    return _NAMES.get(name, name)
