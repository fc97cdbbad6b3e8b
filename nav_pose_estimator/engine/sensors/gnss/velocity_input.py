"""GNSS velocities on arrival: whether they may be offered to the filter, and in which axes they seem to be."""

from __future__ import annotations

import copy
import math
from dataclasses import replace

import numpy as np

from nav_pose_estimator.core.gnss.climb_check import DOWN, OTHER
from nav_pose_estimator.core.gnss.climb_check import SILENT as UNFILLED
from nav_pose_estimator.core.gnss.velocity_check import NED, SILENT, TURNED, UNEXPLAINED, UNIT, VelocityCheck
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.number_checks import is_within
from nav_pose_estimator.engine.samples import GnssFix, GnssVelocity
from nav_pose_estimator.engine.solutions import Level

_LARGEST_SPEED = 1e3  # m/s: receivers stop at 500
_MOVING = 0.3  # m/s: receivers round, and hold an antenna that stands
_LONGEST_STEP = 2.0  # s between velocities that are summed up
_NO_CLOCK = 0.3  # of a scale: no clock is so wrong
_FAULTS = {
    NED: "its axes look like North-East-Down: set ros.input.velocity_frame to ned",
    TURNED: "it is as fast as the positions move, but in another direction: its axes look like {name}, "
    "not East-North-Up",
    SILENT: "it {name} while the positions move: the driver does not fill it",
    UNIT: "it points where the positions go, but is not as fast as them: it looks like {name} instead of m/s",
    UNEXPLAINED: "it does not say where the positions go",
}
_POSITION_FAULTS = {
    "North-East": "latitude and longitude look exchanged",
    "West-North": "longitude looks inverted (West is negative)",
    "East-South": "latitude looks inverted (South is negative)",
    "57 times m/s": "latitude and longitude look like radians where degrees belong",
}
"""By the mistake of the velocity that would explain it as well."""
_AS_RECEIVED = 0.005  # of squared misfit; simulated flights: the wrong sign of it within 0.0003, the right one 0.006 to 0.02
_NAMES = {
    "body": "the vehicle's own",
    "North-East": "North-East-Down",
    "": "stays zero",
    "repeats": "repeats itself",
    "East": "stays zero on its first axis (East)",
    "North": "stays zero on its second axis (North)",
}
_VERTICAL_FAULTS = {
    UNFILLED: "it stays zero while the height changes: the driver does not fill it (ros.input.vertical_velocity: false)",
    DOWN: "it has the wrong sign, positive down",
    OTHER: "heights and barometer agree that it is wrong (another unit?)",
}


class VelocityInput:
    """Drops velocities that contradict the way between fixes; positions go on without them.

    A mistake that is beyond doubt is undone, and the velocity used.
    """

    def __init__(self, journal: Journal) -> None:
        self._journal = journal
        self._check = VelocityCheck()
        self._said: tuple[str, str] = ("", "")
        self._last: tuple[float, ...] = ()
        self.repeats = 0
        """How often the last velocity has come again to the last digit, of a vehicle that moves by it."""
        self._said_vertical = self._said_height = ""
        self._is_withheld = self._is_mended = self._said_scale = False
        self.misled = False
        """Whether it has just been found out that the filter was told wrong velocities; to be set back."""
        self._learns = True
        self.way = 0j
        """Where velocities lead, East + i North [m], from anywhere."""
        self._before = (math.inf, 0j)
        self.position_fault = ""
        """What is wrong with positions, a clause; empty if nothing is known to be."""
        self._said_delay = 0.0  # s

    def forget_time(self) -> None:
        """The navigator starts again: forget samples, keep what they have proved."""
        self._check.forget_time()
        self._last, self.repeats, self.misled = (), 0, False

    def in_hindsight(self, journal: Journal) -> VelocityInput:
        """A copy for samples that this one has heard: it judges them by all that is known now, and learns nothing."""
        twin = copy.deepcopy(self, {id(self._journal): journal})
        twin._learns, twin._last, twin.repeats = False, (), 0
        return twin

    @property
    def doubted(self) -> bool:
        """Whether the velocity has lately contradicted the way between fixes."""
        return bool(self._check.fault) or self._check.suspect

    @property
    def height_fault(self) -> str:
        """What is wrong with the heights of fixes, a clause; empty if nothing is known to be."""
        return self._check.climb.height_fault

    def barometric_height(self, height: float) -> None:
        """Of the last pressure [m]: a witness of climbs."""
        if self._learns:
            self._check.climb.baro = height

    @property
    def sound_steps(self) -> int:
        """Seconds or so, in a row, in which nothing spoke against the velocity."""
        return 0 if self._check.climb.suspect else self._check.sound_steps

    def felt(self, felt: bool, as_received: float, stamp_ns: int) -> None:
        """Whether the IMU feels what velocities say, and by how much better it feels them as they were received.

        The positions are wrong then, and not the velocity that was put right by them.
        """
        self._check.felt = felt
        if not self._learns or self.position_fault or not self._is_mended or as_received < _AS_RECEIVED:
            return
        mistake = _POSITION_FAULTS.get(self._check.name)
        if mistake is not None:
            self.position_fault = mistake
            text = f"GNSS positions not used: the IMU feels the velocity as it is received: {mistake}"
            self._journal.say(stamp_ns, "gnss.position.axes", Level.ERROR, text)

    def fix(self, sample: GnssFix, t: float, sd: float) -> None:
        """A usable fix valid at ``t`` [s], horizontal deviation ``sd`` [m]: what velocities are compared with."""
        if not self._learns:
            return
        self._check.fix(t, sample.lat, sample.lon, sample.alt, sd)
        self._tell_scale(sample.stamp_ns)
        self._tell_vertical(sample.stamp_ns)
        self._watch_suspicion()
        self._tell_lateness(sample.stamp_ns)
        fault = self._check.fault
        if (fault, self._check.name) == self._said:
            return
        self._said = (fault, self._check.name)
        if fault:
            self._is_mended = False
            why = _FAULTS[fault].format(name=_in_words(self._check.name))
            text = f"GNSS velocity not used: {why} ({self._check.misfit:.1f} m/s apart)"
            self._journal.say(sample.stamp_ns, f"gnss.velocity.axes.{fault}", Level.ERROR, text)
        else:
            text = "GNSS velocity agrees with the way between fixes again and is used"
            self._journal.say(sample.stamp_ns, "gnss.velocity.axes.ended", Level.INFO, text)

    def velocity(self, sample: GnssVelocity, t: float, fix_usable: bool) -> GnssVelocity | None:
        """What of a velocity valid at ``t`` [s] may be offered to the filter; None (and counted) if nothing."""
        same = sample.vel_enu == self._last and math.hypot(*sample.vel_enu[:2]) > _MOVING
        self.repeats, self._last = self.repeats + 1 if same else 0, sample.vel_enu
        if not is_within(sample.vel_enu[:2], _LARGEST_SPEED) or abs(sample.vel_enu[2]) > _LARGEST_SPEED:
            self._journal.count("gnss.rejected.velocity_value")
            return None
        if not fix_usable:
            self._journal.count("gnss.rejected.velocity_without_fix")
            return None
        if self._learns:
            self._check.velocity(t, *sample.vel_enu)
        self._add_up(t, complex(*sample.vel_enu[:2]))
        return self._passed(sample)

    def _add_up(self, t: float, velocity: complex) -> None:
        before, last = self._before
        self._before = t, velocity
        if 0.0 < t - before < _LONGEST_STEP:
            self.way += 0.5 * (t - before) * (last + velocity)

    def _passed(self, sample: GnssVelocity) -> GnssVelocity | None:
        """What of a velocity may be offered to the filter by what is known now."""
        check = self._check
        if check.late.delay and not check.fault:
            return replace(sample, stamp_ns=sample.stamp_ns - round(check.late.delay * 1e9))
        if check.fault and check.certain:
            return self._mended(sample)
        if check.fault or check.suspect:
            self._journal.count("gnss.rejected.velocity_axes")
            return None
        up = sample.vel_enu[2]
        if check.climb.fault == DOWN:
            return replace(sample, vel_enu=(*sample.vel_enu[:2], -up))
        if check.climb.fault or check.climb.suspect:
            return replace(sample, vel_enu=(*sample.vel_enu[:2], math.nan))
        return sample

    def _watch_suspicion(self) -> None:
        is_withheld = self.doubted
        self.misled = self.misled or (is_withheld and not self._is_withheld)
        self._is_withheld = is_withheld

    def _tell_lateness(self, stamp_ns: int) -> None:
        delay = self._check.late.delay
        if delay == self._said_delay:
            return
        self._said_delay, self.misled = delay, True
        text = "GNSS velocity belongs to the positions of its stamps again"
        if delay:
            text = f"GNSS velocity is about {delay:g} s late against the positions: used as of then"
        level = Level.WARN if delay else Level.INFO
        self._journal.say(stamp_ns, "gnss.velocity.late", level, text, delay=delay)

    def _tell_vertical(self, stamp_ns: int) -> None:
        fault = self._check.climb.height_fault
        if fault and fault != self._said_height:
            self._said_height, self.misled = fault, True
            text = f"GNSS height not used: barometer and vertical velocity agree that it is {fault}"
            self._journal.say(stamp_ns, "gnss.height.unit", Level.ERROR, text)
        vertical = self._check.climb.fault
        if not vertical or vertical == self._said_vertical:
            return
        self._said_vertical, self.misled = vertical, True
        text = f"GNSS vertical velocity not used: {_VERTICAL_FAULTS[vertical]}"
        if vertical == DOWN:
            text = f"GNSS vertical velocity is turned round: {_VERTICAL_FAULTS[vertical]}"
        self._journal.say(stamp_ns, f"gnss.velocity.vertical.{vertical}", Level.WARN, text)

    def _tell_scale(self, stamp_ns: int) -> None:
        scale = self._check.scale
        if scale == 1.0 or abs(scale - 1.0) > _NO_CLOCK or self._said_scale or self.doubted:
            return
        self._said_scale = True
        amount, way = 100.0 * abs(scale - 1.0), "farther" if scale > 1.0 else "less far"
        clock = f"{100.0 * abs(1.0 - 1.0 / scale):.1f} % {'slow' if scale > 1.0 else 'fast'}"
        text = (
            f"GNSS positions move {amount:.1f} % {way} than velocities and stamps say: the clock of the stamps "
            f"probably runs {clock}, else another unit"
        )
        self._journal.say(stamp_ns, "gnss.velocity.scale", Level.WARN, text, scale=scale)

    def _mended(self, sample: GnssVelocity) -> GnssVelocity:
        """The velocity without the mistake that is beyond doubt."""
        check = self._check
        if not self._is_mended:
            self._is_mended = self.misled = True
            text = f"GNSS velocity is {_in_words(check.name)} beyond doubt: put right and used"
            if check.fault == NED:
                text += "; set ros.input.velocity_frame to ned"
            self._journal.say(sample.stamp_ns, "gnss.velocity.turned", Level.WARN, text)
        east, north, up = sample.vel_enu
        x, y = check.mended(1.0, 0.0), check.mended(0.0, 1.0)
        if check.fault == UNIT:
            up *= x[0]
        elif check.climb.goes_down:
            up = -up
        elif not check.climb.goes_up:
            up = math.nan
        A = np.array([[x[0], y[0], 0.0], [x[1], y[1], 0.0], [0.0, 0.0, x[0] if check.fault == UNIT else 1.0]])
        cov = None if sample.cov_enu is None else A @ sample.cov_enu @ A.T
        return replace(sample, vel_enu=(*check.mended(east, north), up), cov_enu=cov)


def _in_words(name: str) -> str:
    return _NAMES.get(name, name)
