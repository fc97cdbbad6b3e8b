"""GNSS velocities on arrival: whether they may be offered to the filter, and in which axes they seem to be."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from nav_pose_estimator.core.gnss.velocity_check import DOWN, NED, SILENT, TURNED, UNIT, VelocityCheck
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.number_checks import is_within
from nav_pose_estimator.engine.samples import GnssFix, GnssVelocity
from nav_pose_estimator.engine.solutions import Level

_LARGEST_SPEED = 1e3  # m/s: receivers stop at 500
_MOVING = 0.3  # m/s: receivers round, and hold an antenna that stands
_FAULTS = {
    NED: "its axes look like North-East-Down: set ros.input.velocity_frame to ned",
    TURNED: "it is as fast as the positions move, but in another direction: its axes look like the vehicle's own, "
    "not East-North-Up",
    SILENT: "it stays zero while the positions move: the driver does not fill it",
    UNIT: "it points where the positions go, but is too fast for them: it looks like {unit} instead of m/s",
}
_VERTICAL_FAULTS = {
    SILENT: "it stays zero while the height changes: the driver does not fill it (ros.input.vertical_velocity: false)",
    DOWN: "it has the wrong sign, positive down",
}


class VelocityInput:
    """Drops velocities whose axes contradict the way between fixes; positions go on without them.

    Once they are North-East-Down beyond doubt they are turned.
    """

    def __init__(self, journal: Journal) -> None:
        self._journal = journal
        self._check = VelocityCheck()
        self._said = ""
        self._last: tuple[float, ...] = ()
        self.repeats = 0
        """How often the last velocity has come again to the last digit, of a vehicle that moves by it."""
        self._said_vertical = ""
        self._said_turned = self._said_scale = False
        self.misled = False
        """Whether it has just been found out that the filter was told wrong velocities; to be set back."""

    def forget_time(self) -> None:
        """The navigator starts again: forget samples, keep what they have proved."""
        self._check.forget_time()
        self._last, self.repeats, self.misled = (), 0, False

    @property
    def doubted(self) -> bool:
        """Whether the axes of the velocity have lately contradicted the way between fixes."""
        return bool(self._check.fault) or self._check.suspect

    def fix(self, sample: GnssFix, t: float, sd: float) -> None:
        """A usable fix valid at ``t`` [s], horizontal deviation ``sd`` [m]: what velocities are compared with."""
        self._check.fix(t, sample.lat, sample.lon, sample.alt, sd)
        self._tell_scale(sample.stamp_ns)
        fault = self._check.fault
        if fault == self._said:
            return
        self._said = fault
        if fault:
            self.misled = True
            why = _FAULTS[fault].format(unit=self._check.unit)
            text = f"GNSS velocity not used: {why} ({self._check.misfit:.1f} m/s apart)"
            self._journal.say(sample.stamp_ns, f"gnss.velocity.axes.{fault}", Level.ERROR, text)
        else:
            text = "GNSS velocity agrees with the way between fixes again and is used"
            self._journal.say(sample.stamp_ns, "gnss.velocity.axes.ended", Level.INFO, text)

    def velocity(self, sample: GnssVelocity, t: float, fix_usable: bool) -> GnssVelocity | None:
        """What of a velocity valid at ``t`` [s] may be offered to the filter; None (and counted) if nothing."""
        up = sample.vel_enu[2]
        same = sample.vel_enu == self._last and math.hypot(*sample.vel_enu[:2]) > _MOVING
        self.repeats, self._last = self.repeats + 1 if same else 0, sample.vel_enu
        if not is_within(sample.vel_enu[:2], _LARGEST_SPEED) or abs(up) > _LARGEST_SPEED:
            self._journal.count("gnss.rejected.velocity_value")
            return None
        if not fix_usable:
            self._journal.count("gnss.rejected.velocity_without_fix")
            return None
        self._check.velocity(t, *sample.vel_enu)
        if self._check.fault == NED and self._check.certain:
            return self._turned(sample)
        if self._check.fault or self._check.suspect:
            self._journal.count("gnss.rejected.velocity_axes")
            return None
        vertical = self._check.vertical_fault
        if not (vertical or self._check.vertical_suspect):
            return sample
        if vertical and vertical != self._said_vertical:
            self._said_vertical = vertical
            text = f"GNSS vertical velocity not used: {_VERTICAL_FAULTS[vertical]}"
            self._journal.say(sample.stamp_ns, f"gnss.velocity.vertical.{vertical}", Level.WARN, text)
        return replace(sample, vel_enu=(*sample.vel_enu[:2], math.nan))

    def _tell_scale(self, stamp_ns: int) -> None:
        scale = self._check.scale
        if scale == 1.0 or self._said_scale:
            return
        self._said_scale = True
        amount, way = 100.0 * abs(scale - 1.0), "farther" if scale > 1.0 else "less far"
        clock = f"{100.0 * abs(1.0 - 1.0 / scale):.1f} % {'slow' if scale > 1.0 else 'fast'}"
        text = (
            f"GNSS positions move {amount:.1f} % {way} than velocities and stamps say: the clock of the stamps "
            f"probably runs {clock}, else another unit"
        )
        self._journal.say(stamp_ns, "gnss.velocity.scale", Level.WARN, text, scale=scale)

    def _turned(self, sample: GnssVelocity) -> GnssVelocity:
        """North-East-Down as East-North-Up."""
        if not self._said_turned:
            self._said_turned = True
            text = "GNSS velocity is North-East-Down beyond doubt: turned and used; set ros.input.velocity_frame to ned"
            self._journal.say(sample.stamp_ns, "gnss.velocity.turned", Level.WARN, text)
            self.misled = True
        north, east, down = sample.vel_enu
        turn = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
        cov = None if sample.cov_enu is None else turn @ sample.cov_enu @ turn.T
        return replace(sample, vel_enu=(east, north, -down), cov_enu=cov)
