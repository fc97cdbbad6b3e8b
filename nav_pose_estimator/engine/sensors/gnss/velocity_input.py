"""Input of GNSS velocities: whether they may be used, and the correction of errors in axes, unit and timing."""

from __future__ import annotations

import copy
import math
from dataclasses import replace

import numpy as np

from nav_pose_estimator.core.gnss.climb_check import DOWN
from nav_pose_estimator.core.gnss.velocity_check import VelocityCheck
from nav_pose_estimator.core.gnss.velocity_mistakes import UNIT
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.samples import GnssFix, GnssVelocity
from nav_pose_estimator.engine.sensors.gnss.velocity_report import VelocityReport

_LARGEST_SPEED = 1e3  # m/s: a larger component is rejected (receivers end at 500 m/s)
_MOVING = 0.3  # m/s: slower velocities may repeat, because receivers round and hold them
_LONGEST_STEP = 2.0  # s: longest interval over which velocities are integrated
# Smallest reduction of the squared misfit by the velocities as received with which positions are wrong. In simulated
# flights it is 0.006 to 0.02 then, and -0.016 to 0 where the velocity is wrong.
_AS_RECEIVED = 0.005


class VelocityInput:
    """Rejects velocities that contradict the displacement between fixes; positions are still used.

    An error that is established beyond doubt is corrected, and the velocity used.
    """

    def __init__(self, journal: Journal) -> None:
        self._journal, self._report = journal, VelocityReport(journal)
        self._check = VelocityCheck()
        self._last: tuple[float, ...] = ()
        self.repeats = 0
        """Number of exact repetitions of the last velocity, if it is not near zero."""
        self.is_zero = False
        """Whether the last velocity was exactly zero, as receivers send it that hold their position at rest."""
        self._is_withheld = self._is_corrected = False
        self.misled = False
        """Whether wrong velocities that the filter has used were just found; to be cleared by the caller."""
        self.position_fault = ""
        """Established error of the positions, one clause for the user; empty without one."""
        self.integral = 0j
        """Integral of the velocities, East + i North [m], from an arbitrary start."""
        self._before = (math.inf, 0j)
        self._place = (math.nan, math.nan)  # deg, of the last fix
        self._learns = True

    def forget_time(self) -> None:
        """The navigator starts again: forget the samples, keep established errors."""
        self._check.forget_time()
        self._last, self.repeats, self.misled = (), 0, False

    def in_hindsight(self, journal: Journal) -> VelocityInput:
        """A copy for a second pass over past samples: it applies the present knowledge and learns nothing."""
        twin = copy.deepcopy(self, {id(self._journal): journal})
        twin._learns, twin._last, twin.repeats = False, (), 0
        return twin

    @property
    def doubted(self) -> bool:
        """Whether the velocity contradicts the displacement between fixes."""
        return bool(self._check.fault) or self._check.suspect

    @property
    def height_fault(self) -> str:
        """Established error of the heights of fixes, one clause for the user; empty without one."""
        return self._check.climb.height_fault

    @property
    def sound_steps(self) -> int:
        """Consecutive steps (of about one second) that agree with a correct velocity."""
        return 0 if self._check.climb.suspect else self._check.sound_steps

    def barometric_height(self, height: float) -> None:
        """Set the pressure altitude [m], with which climbs are compared."""
        if self._learns:
            self._check.climb.baro = height

    def is_fresh(self, t: float) -> bool:
        """Whether ``integral`` extends to ``t`` [s], up to one interval."""
        return abs(t - self._before[0]) < _LONGEST_STEP

    @property
    def pressure_altitude(self) -> float:
        """The last one [m], NaN without a barometer."""
        return self._check.climb.baro

    def imu_evidence(self, agrees: bool, as_received: float, stamp_ns: int) -> None:
        """Take the evidence of the IMU: whether it confirms the velocities (``agrees``).

        ``as_received``: reduction of the squared misfit by the velocities as received. If they fit better than after
        the correction, the positions are wrong and not the velocity.
        """
        self._check.imu_agrees = agrees
        if not self._learns or self.position_fault or not self._check.fault:
            return
        if agrees if self._check.stands_still else self._is_corrected and as_received > _AS_RECEIVED:
            self.position_fault = self._report.positions(self._check, self._place, stamp_ns)

    def fix(self, sample: GnssFix, t: float, sd: float, walk: float) -> None:
        """Compare velocities with a usable fix valid at ``t`` [s], of horizontal deviation ``sd`` [m].

        ``walk`` [m/sqrt(s)]: random walk of the integrated velocities that is not stated.
        """
        if not self._learns:
            return
        check, stamp_ns = self._check, sample.stamp_ns
        self._place = math.degrees(sample.lat), math.degrees(sample.lon)
        check.expect_walk(walk)
        check.fix(t, sample.lat, sample.lon, sample.alt, sd)
        if not check.is_new:
            return
        check.is_new = False
        is_withheld = self.doubted
        new = [is_withheld and not self._is_withheld]
        self._is_withheld = is_withheld
        if not is_withheld:
            self._report.scale(check.scale, stamp_ns)
        new += [self._report.vertical(check, stamp_ns), self._report.lateness(check.late.delay, stamp_ns)]
        self._report.horizontal(check, stamp_ns)
        self._is_corrected = bool(check.fault) and check.certain
        if self._is_corrected:
            new.append(self._report.corrected(check, stamp_ns))
        self.misled = self.misled or any(new)

    def velocity(self, sample: GnssVelocity, t: float, fix_usable: bool) -> GnssVelocity | None:
        """The usable part of a velocity valid at ``t`` [s], corrected where necessary; None (and counted) without."""
        east, north, up = sample.vel_enu
        same = sample.vel_enu == self._last and math.hypot(east, north) > _MOVING
        self.repeats, self._last = self.repeats + 1 if same else 0, sample.vel_enu
        self.is_zero = east == north == up == 0.0
        if not (abs(east) <= _LARGEST_SPEED and abs(north) <= _LARGEST_SPEED) or abs(up) > _LARGEST_SPEED:
            self._journal.count("gnss.rejected.velocity_value")
            return None
        if not fix_usable:
            self._journal.count("gnss.rejected.velocity_without_fix")
            return None
        if self._learns:
            self._check.velocity(t, east, north, up)
        self._integrate(t, complex(east, north))
        return self._usable_part(sample)

    def _integrate(self, t: float, velocity: complex) -> None:
        (before, last), self._before = self._before, (t, velocity)
        if 0.0 < t - before < _LONGEST_STEP:
            self.integral += 0.5 * (t - before) * (last + velocity)

    def _usable_part(self, sample: GnssVelocity) -> GnssVelocity | None:
        """The usable part of a velocity according to the present knowledge."""
        check = self._check
        if self._is_corrected:
            return self._corrected(sample)
        if self.doubted:
            self._journal.count("gnss.rejected.velocity_axes")
            return None
        if check.late.delay:
            sample = replace(sample, stamp_ns=sample.stamp_ns - round(check.late.delay * 1e9))
        up = sample.vel_enu[2]
        if check.climb.fault == DOWN:
            return replace(sample, vel_enu=(*sample.vel_enu[:2], -up))
        if check.climb.fault or check.climb.suspect:
            return replace(sample, vel_enu=(*sample.vel_enu[:2], math.nan))
        return sample

    def _corrected(self, sample: GnssVelocity) -> GnssVelocity:
        """The velocity corrected for the established error."""
        check, (east, north, up) = self._check, sample.vel_enu
        x, y = check.corrected(1.0, 0.0), check.corrected(0.0, 1.0)
        vertical = x[0] if check.fault == UNIT else 1.0
        if check.fault == UNIT:
            up *= vertical
        elif check.climb.goes_down:
            up = -up
        elif not check.climb.goes_up:
            up = math.nan
        A = np.array([[x[0], y[0], 0.0], [x[1], y[1], 0.0], [0.0, 0.0, vertical]])
        cov = None if sample.cov_enu is None else A @ sample.cov_enu @ A.T
        return replace(sample, vel_enu=(*check.corrected(east, north), up), cov_enu=cov)
