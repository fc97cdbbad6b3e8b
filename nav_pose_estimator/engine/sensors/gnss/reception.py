"""Reception of GNSS: validation and quality gate of fixes, their noise, and the reason where one is not used."""

from __future__ import annotations

import math
from dataclasses import replace
from operator import sub

import numpy as np

from nav_pose_estimator.core.earth.ellipsoid import step_of
from nav_pose_estimator.core.filter.noise_identification import NoiseIdentification
from nav_pose_estimator.core.gnss import clock_offset
from nav_pose_estimator.core.gnss.quality_gate import GateSettings, GnssGate, Notice
from nav_pose_estimator.engine.events.catalogue import in_words
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.number_checks import is_covariance, is_position, why_impossible
from nav_pose_estimator.engine.parameters.gnss import GnssParameters
from nav_pose_estimator.engine.samples import GnssFix, GnssVelocity, SatelliteCount
from nav_pose_estimator.engine.sensors.aiding import Aiding
from nav_pose_estimator.engine.sensors.gnss import lasting_error
from nav_pose_estimator.engine.sensors.gnss.digits import CELLS, Repeats, Rounding
from nav_pose_estimator.engine.sensors.gnss.stated_accuracy import Scatter, VelocityScatter
from nav_pose_estimator.engine.sensors.gnss.velocity_input import VelocityInput
from nav_pose_estimator.engine.solutions import Level

_PERIOD_MEMORY = 6  # fixes from which the period is estimated
_MOVED = 8.0  # m: displacement by velocities beyond which a repeated position is stuck or rounded
_AHEAD = 1.0  # s: a fix whose stamp is further ahead of the IMU is rejected
_LEVELS = {"info": Level.INFO, "warn": Level.WARN, "error": Level.ERROR}


class GnssReception:
    """Quality gate, receiver noise, and the reason why the last fix was not used."""

    def __init__(self, parameters: GnssParameters, aiding: Aiding, journal: Journal) -> None:
        self._journal, self._aiding = journal, aiding
        self.gate = GnssGate(_gate_settings(parameters))
        self.set_parameters(parameters)
        self.enabled = True
        self.refusal = "no fix has arrived yet"
        self.satellites: int | None = None
        self.identified = NoiseIdentification()  # noise identified in flight, set by the run
        self.velocities = VelocityInput(journal)
        self.rounding, self.scatter = Rounding(journal), Scatter(journal)
        self.velocity_scatter = VelocityScatter(journal)
        self._usable = False  # the last fix
        self.fix_track = FixTrack()
        self._fix_times: list[float] = []  # of the newest fixes, in order of time
        self.fix_period = 1.0
        """Time between fixes [s]: the shortest of the last few, so that it is the same when one comes late."""
        self.repeats = Repeats(journal)
        self._no_height_reported = False
        self._reported_ahead = math.nan  # s: clock offset that was reported last

    def set_parameters(self, parameters: GnssParameters) -> None:
        """Take new thresholds and noises; the gate stays open or closed."""
        self.gate.settings = _gate_settings(parameters)
        self._parameters = parameters
        self.lasting = lasting_error.LastingPosition(parameters) if parameters.error_states else None
        position = np.array([parameters.position_sd] * 2 + [parameters.vertical_sd])
        velocity = np.array([parameters.velocity_sd] * 2 + [parameters.velocity_vertical_sd])
        self._position_floor, self._velocity_floor = np.diag(position**2), np.diag(velocity**2)
        self._velocity_variance, self.least_velocity_sd = velocity**2, parameters.velocity_sd

    def count(self, sample: SatelliteCount, t: float) -> None:
        """Process a satellite count valid at ``t`` [s]."""
        self.satellites = sample.count
        self.gate.update_count(t, sample.count)

    def fix(self, sample: GnssFix, t: float, now: float) -> bool:
        """Assess a fix valid at ``t`` [s] that arrives ``now`` [s]; True where it may be used."""
        was_usable, self._usable = self._usable, False
        if sample.status < 0:
            return self.refuse(sample.stamp_ns, "gnss.rejected.status", "the receiver has no fix")
        if not is_position(sample.lat, sample.lon, 0.0 if math.isnan(sample.alt) else sample.alt):
            return self.refuse(
                sample.stamp_ns, "gnss.rejected.value", why_impossible(sample.lat, sample.lon, sample.alt)
            )
        if sample.lat == 0.0 and sample.lon == 0.0:
            why = "latitude and longitude are exactly zero, which is what drivers send before the first fix"
            return self.refuse(sample.stamp_ns, "gnss.rejected.null_island", why)
        moved = self.repeats.note(sample, t, self.velocities)
        self.rounding.fix(sample.lat, sample.lon, _MOVED < moved < math.inf, sample.stamp_ns)
        if self.repeats.is_copy and not self.rounding.is_on:
            self._usable = was_usable
            self._journal.count("gnss.rejected.copy")
            return False
        if moved > max(_MOVED, CELLS * self.rounding.step):
            why = "the position repeats to the last digit while the vehicle moves: the receiver is stuck"
            return self.refuse(sample.stamp_ns, "gnss.rejected.stuck", why)
        if self.velocities.position_fault:
            return self.refuse(sample.stamp_ns, "gnss.rejected.axes", self.velocities.position_fault)
        if t - now > _AHEAD:
            return self.refuse(sample.stamp_ns, "gnss.rejected.future", self._clocks(sample, t - now))
        if not self.enabled:
            return self.refuse(sample.stamp_ns, "gnss.rejected.disabled", "GNSS is switched off by the operator")
        horizontal = vertical = None
        cov = None if sample.cov_enu is None else self._known(_horizontal(sample.alt, sample.cov_enu), "position")
        if cov is not None:
            east, north, up = cov.diagonal().tolist()
            horizontal = math.sqrt(max(east, north))
            vertical = None if math.isnan(sample.alt) else math.sqrt(up)
        verdict = self.gate.assess_fix(t, sample.status, horizontal, vertical, age=max(now - t, 0.0))
        self._aiding.fix_period = self.gate.period
        for notice in verdict.notices:
            self.report(sample.stamp_ns, notice)
        if not verdict.usable:
            late = verdict.reason == "gnss.rejected.age"
            why = self._clocks(sample, t - now) if late else _gate_reason(verdict.reason, self.gate.settings)
            return self.refuse(sample.stamp_ns, verdict.reason, why)
        self.fix_period = _period_with(self._fix_times, t)
        self._usable = True
        self._aiding.fix_offered = t
        self.fix_track.add(sample.lat, sample.lon)
        if math.isnan(sample.alt):
            self._report_no_height(sample.stamp_ns)
        if self.repeats.is_new and not self.rounding.is_on:
            walk = self.velocity_scatter.sd * math.sqrt(self.fix_period)
            self.velocities.fix(self.repeats.without_bad_height(sample), t, horizontal or 0.0, walk)
            # adaptive noise models estimate such noise themselves
            if self._parameters.noise == "fixed" and self.velocities.is_fresh(t) and not self.velocities.doubted:
                stated = max(horizontal or 0.0, self._parameters.position_sd)
                self.scatter.fix(
                    t, self.fix_track.position - self.velocities.integral, sample.alt, stated, sample.stamp_ns
                )
        return True

    def without_bad_height(self, sample: GnssFix) -> GnssFix:
        """A fix that has passed, without its height where that is known to be wrong."""
        sample = self.repeats.without_bad_height(sample)
        return replace(sample, alt=math.nan) if self.velocities.height_fault else sample

    def velocity(self, sample: GnssVelocity, t: float) -> GnssVelocity | None:
        """The usable part of a velocity valid at ``t`` [s]: only while fixes are usable and its axes are right."""
        return self.velocities.velocity(sample, t, self._usable and self.enabled)

    def position_noise(self, sample: GnssFix, in_filter: bool = False) -> np.ndarray:
        """R (3, 3) [m^2]: the stated covariance, at least the floor, inflated for the correlation between fixes.

        ``in_filter``: without the part for which the filter has states.
        """
        cov = None if sample.cov_enu is None else self._known(_horizontal(sample.alt, sample.cov_enu))
        R = _floored(cov, self._position_floor)
        if self.rounding.is_on:
            R = R + np.diag([self.rounding.sd[0] ** 2, self.rounding.sd[1] ** 2, 0.0])
        shared = 1.0 + self._parameters.position_correlation / self.fix_period
        if in_filter and self.lasting is not None:
            self.lasting.receive(R)
            R = lasting_error.white_position(R, shared, self.lasting.variance, self.identified)
        else:
            R = R * self.identified.gnss_variance * shared
        if self.scatter.is_on:
            horizontal, vertical = self.scatter.sd
            R[np.diag_indices(3)] += (horizontal**2, horizontal**2, vertical**2)
        return R

    def velocity_noise(self, sample: GnssVelocity, in_filter: bool = False) -> np.ndarray:
        """R (3, 3) [(m/s)^2]: the floor, or what the receiver states where that is larger; ``in_filter`` as above."""
        cov = None if sample.cov_enu is None else self._known(sample.cov_enu, "velocity")
        R = _floored(cov, self._velocity_floor)
        if in_filter and self._parameters.error_states:
            R = lasting_error.white_velocity(R, self._velocity_variance, self.identified)
        else:
            R = self.identified.gnss_variance * R
        if self.velocity_scatter.is_on:
            R[np.diag_indices(3)] += self.velocity_scatter.sd**2
        return R

    def refuse(self, stamp_ns: int, name: str, why: str) -> bool:
        """Reject a fix: with an event where the reason is new, else counted only; returns False."""
        self._journal.catch_up()
        if why != self.refusal:
            self._journal.say(stamp_ns, name, Level.INFO, f"GNSS not used: {why}")
        else:
            self._journal.count(name)
        self.refusal = why
        return False

    @property
    def is_quick(self) -> bool:
        """Whether GNSS counts as lost after ``Aiding.patience`` whenever the next fix comes."""
        return self._aiding.is_quick(max(self.gate.state.steps, default=math.inf))

    def use(self, t: float, with_height: bool) -> None:
        """Note that a fix valid at ``t`` [s] has corrected the filter."""
        self._aiding.use_fix(t, with_height)
        self.refusal = ""
        self._journal.count("gnss.used.position")

    def report(self, stamp_ns: int, notice: Notice, **data: float) -> None:
        """Report an event of gate or guard."""
        self._journal.say(stamp_ns, notice.name, _LEVELS[notice.severity], notice.text, **data)

    def _report_no_height(self, stamp_ns: int) -> None:
        if self._no_height_reported:
            self._journal.count("gnss.height.missing")
            return
        self._no_height_reported = True
        text = "a fix without altitude: latitude and longitude are used, the height is the barometer's or held"
        self._journal.say(stamp_ns, "gnss.height.missing", Level.WARN, text)

    def _clocks(self, sample: GnssFix, ahead: float) -> str:
        """Clause on the clock offset and its cause; the same words as long as the offset is the same."""
        if not abs(ahead - self._reported_ahead) < 0.5 + 0.01 * abs(ahead):
            self._reported_ahead = ahead
        stamp = 1e-9 * sample.stamp_ns
        return clock_offset.in_words(self._reported_ahead, stamp, stamp - self._reported_ahead)

    def _known(self, cov: np.ndarray, what: str = "") -> np.ndarray | None:
        """``cov`` unless it is no covariance: then it counts as unknown, and as a flaw of ``what``."""
        if is_covariance(cov, 3):
            return cov
        if what:
            self._journal.count(f"gnss.{what}.covariance.flawed")
        return None


class FixTrack:
    """Position of the last fix that may be used, relative to the first one, in a level frame of its own."""

    def __init__(self) -> None:
        self.position = 0j
        """East + i North [m]."""
        self._last: tuple[float, float] | None = None  # latitude and longitude [rad]

    def add(self, lat: float, lon: float) -> None:
        """Add a fix at ``lat``, ``lon`` [rad]."""
        before, self._last = self._last or (lat, lon), (lat, lon)
        east, north, _ = step_of(*before, 0.0, lat, lon, 0.0)
        self.position += complex(east, north)


def _gate_reason(reason: str, settings: GateSettings) -> str:
    """Why the gate rejects a fix, one clause for the user."""
    if reason == "gnss.rejected.satellites":
        return f"too few satellites, {settings.min_satellites_enter} are needed"
    if reason == "gnss.rejected.accuracy":
        limits = f"{settings.max_horizontal_sd:.3g} m horizontal, {settings.max_vertical_sd:.3g} m vertical"
        return f"{in_words(reason)}: {limits}"
    return in_words(reason)


def _horizontal(alt: float, cov: np.ndarray) -> np.ndarray:
    """The covariance of a fix; without a height ``alt``, its vertical part is zero."""
    if not math.isnan(alt) or cov.shape != (3, 3):
        return cov
    cov = np.array(cov, dtype=float)
    cov[2, :] = cov[:, 2] = 0.0
    return cov


def _floored(cov: np.ndarray | None, floor: np.ndarray) -> np.ndarray:
    """``cov`` with at least the diagonal of ``floor`` (3, 3), the floor itself where the receiver states none: never to
    be written to."""
    if cov is None:
        return floor
    R = np.array(cov, dtype=float, order="C")
    lasting_error.raise_to(floor, R)
    return R


def _period_with(times: list[float], t: float) -> float:
    """Time between fixes [s] at the last few ``times`` [s], to which that of another fix ``t`` is added."""
    times.append(t)
    if len(times) == 1:
        return 1.0
    if t < times[-2]:
        times.sort()
    if len(times) > _PERIOD_MEMORY:
        del times[0]
    return min(max(min(map(sub, times[1:], times)), 0.02), 5.0)


def _gate_settings(parameters: GnssParameters) -> GateSettings:
    return GateSettings(**{name: getattr(parameters.gate, name) for name in GateSettings.__slots__})
