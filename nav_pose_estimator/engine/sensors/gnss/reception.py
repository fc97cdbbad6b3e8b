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
from nav_pose_estimator.core.numerics.jit import kernel
from nav_pose_estimator.engine.events.catalogue import in_words
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.number_checks import is_covariance, is_position
from nav_pose_estimator.engine.parameters.gnss import GnssParameters
from nav_pose_estimator.engine.samples import GnssFix, GnssVelocity, SatelliteCount
from nav_pose_estimator.engine.sensors.aiding import Aiding
from nav_pose_estimator.engine.sensors.frozen import FROZEN, LIVE, Frozen, take_value
from nav_pose_estimator.engine.sensors.gnss import lasting_error
from nav_pose_estimator.engine.sensors.gnss.rounding import Rounding
from nav_pose_estimator.engine.sensors.gnss.stated_accuracy import Scatter, VelocityScatter
from nav_pose_estimator.engine.sensors.gnss.velocity_input import VelocityInput
from nav_pose_estimator.engine.solutions import Level

_PERIOD_MEMORY = 6  # fixes from which the period is estimated
_STUCK = 4  # consecutive repetitions of a position after which the receiver may be stuck
_MOVED = 8.0  # m: displacement by velocities beyond which a repeated position is stuck or rounded
_ZEROS_UNFILLED = 2  # heights of exactly zero, from the start and at different positions, that show an unfilled field
_CELLS = 2.0  # like ``_MOVED`` for rounded positions, in steps of the grid
_INTEGER_DEGREES = 1e5  # deg: larger values are probably degrees times 1e7
_HIGHEST = 1e5  # m: larger heights are probably in mm
_CLIMBED = 4.0  # m: change of the barometric height at which a receiver's static hold should have ended
_WEATHER = 0.02  # m/s: change of the barometric height by weather and warming up, which is no evidence
_AHEAD = 1.0  # s: a fix whose stamp is further ahead of the IMU is rejected
_UNFILLED = FROZEN + 1  # another verdict on heights besides those of ``frozen``
_HEIGHT_FAULTS = {
    _UNFILLED: "it is exactly zero, as drivers send it that do not fill it",
    FROZEN: "it repeats to the last digit while latitude and longitude change",
}
"""Why heights are not used, one clause for the user."""
_LEVELS = {"info": Level.INFO, "warn": Level.WARN, "error": Level.ERROR}

# --- the state of ``_Repeats``: index of each quantity, with its size if that is not 1 -------------------------------
_PLACE, _T = 0, 3  # (3) rad, rad, m: last fix, and its time [s]
_REPEATS, _STAYS = 4, 5  # its repetitions, and those of latitude and longitude
_INTEGRAL = 6  # (2) m: integral of the velocities when the position came for the first time, East and North
_HEIGHT = 8  # m: pressure altitude then, which follows the weather
_HEIGHT_T, _ZEROS, _VERDICT = (
    9,
    10,
    11,
)  # s: last height; heights of zero so far (none once the field is filled); the verdict
_SIZE = 12


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
        self._repeats = _Repeats(journal)
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
        self._usable = False
        if sample.status < 0:
            return self.refuse(sample.stamp_ns, "gnss.rejected.status", "the receiver has no fix")
        if not is_position(sample.lat, sample.lon, 0.0 if math.isnan(sample.alt) else sample.alt):
            return self.refuse(sample.stamp_ns, "gnss.rejected.value", _invalid_position(sample))
        if sample.lat == 0.0 and sample.lon == 0.0:
            why = "latitude and longitude are exactly zero, which is what drivers send before the first fix"
            return self.refuse(sample.stamp_ns, "gnss.rejected.null_island", why)
        moved = self._repeats.note(sample, t, self.velocities)
        self.rounding.fix(sample.lat, sample.lon, _MOVED < moved < math.inf, sample.stamp_ns)
        if moved > _MOVED and moved > _CELLS * self.rounding.step:
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
        if self._repeats.is_new and not self.rounding.is_on:
            walk = self.velocity_scatter.sd * math.sqrt(self.fix_period)
            self.velocities.fix(self._repeats.without_bad_height(sample), t, horizontal or 0.0, walk)
            # adaptive noise models estimate such noise themselves
            if self._parameters.noise == "fixed" and self.velocities.is_fresh(t) and not self.velocities.doubted:
                stated = max(horizontal or 0.0, self._parameters.position_sd)
                self.scatter.fix(
                    t, self.fix_track.position - self.velocities.integral, sample.alt, stated, sample.stamp_ns
                )
        return True

    def without_bad_height(self, sample: GnssFix) -> GnssFix:
        """A fix that has passed, without its height where that is known to be wrong."""
        sample = self._repeats.without_bad_height(sample)
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


class _Repeats:
    """Detection of positions that repeat exactly, and of a height that the driver never fills or that is frozen."""

    def __init__(self, journal: Journal) -> None:
        self._journal, self._frozen = journal, Frozen()
        self._state = np.full(_SIZE, math.nan)
        self._state[_T] = self._state[_HEIGHT_T] = -math.inf
        self._state[_REPEATS] = self._state[_STAYS] = self._state[_ZEROS] = 0.0
        self._state[_VERDICT] = LIVE
        self._verdict = LIVE  # on the height
        self.is_new = True
        """Whether the last fix differed from the one before it."""

    def note(self, sample: GnssFix, t: float, velocities: VelocityInput) -> float:
        """Displacement [m] by velocities while the position has repeated up to the fix valid at ``t`` [s].

        It is infinite if velocities repeat as well, or are zero while the barometer climbs or sinks. An event
        reports a height that is not filled or frozen, and its recovery.
        """
        place, integral = (sample.lat, sample.lon, sample.alt), velocities.integral
        others = integral.real, integral.imag, velocities.pressure_altitude, velocities.is_zero, velocities.repeats
        was = self._verdict
        self.is_new, moved, self._verdict = _take_place(self._state, self._frozen.state, t, place, others)
        if self._verdict != was:
            self._report_height(was in _HEIGHT_FAULTS, sample.stamp_ns)
        return moved

    def _report_height(self, was_at_fault: bool, stamp_ns: int) -> None:
        reason = _HEIGHT_FAULTS.get(self._verdict)
        if reason and not was_at_fault:
            text = f"GNSS height not used: {reason}; it is the barometer's or held"
            self._journal.say(stamp_ns, "gnss.height.stuck", Level.WARN, text)
        elif was_at_fault and not reason:
            self._journal.say(stamp_ns, "gnss.height.stuck.ended", Level.INFO, "GNSS heights change again")

    def without_bad_height(self, sample: GnssFix) -> GnssFix:
        """The fix, without its height while that is or may be at fault."""
        return sample if self._verdict == LIVE else replace(sample, alt=math.nan)


@kernel
def _take_place(state, frozen, t, place, others):
    """``_Repeats.note``; ``others``: integral of the velocities [m], East and North, pressure altitude [m], whether the
    velocity is zero, and how often it has been repeated. Returns also ``is_new`` and the verdict on the height."""
    integral_east, integral_north, altitude, is_zero, repeated = others
    stays = place[0] == state[_PLACE] and place[1] == state[_PLACE + 1]
    repeats = stays and place[2] == state[_PLACE + 2]
    state[_STAYS] = state[_STAYS] + 1.0 if stays else 0.0
    state[_REPEATS] = state[_REPEATS] + 1.0 if repeats else 0.0
    for axis in range(3):
        state[_PLACE + axis] = place[axis]
    if not stays:
        state[_INTEGRAL], state[_INTEGRAL + 1], state[_HEIGHT] = integral_east, integral_north, altitude
    climbed = altitude - state[_HEIGHT]
    if t > state[_T] > -math.inf and math.isfinite(climbed):
        state[_HEIGHT] += math.copysign(min(abs(climbed), _WEATHER * (t - state[_T])), climbed)
    state[_T] = t
    if not repeats and not math.isnan(place[2]) and t > state[_HEIGHT_T]:
        _take_height(state, frozen, t, place[2])
    moved = 0.0
    if state[_STAYS] >= _STUCK:
        held = is_zero and abs(climbed) > _CLIMBED
        moved = math.hypot(integral_east - state[_INTEGRAL], integral_north - state[_INTEGRAL + 1])
        if held or min(state[_REPEATS], repeated) >= _STUCK:
            moved = math.inf
    return not repeats, moved, int(state[_VERDICT])


@kernel
def _take_height(state, frozen, t, alt):
    """Judge the height [m] of a fix that differs from the one before it."""
    state[_HEIGHT_T] = t
    if alt != 0.0:
        state[_ZEROS] = -math.inf  # it is filled
    state[_ZEROS] += 1.0
    verdict = take_value(frozen, t, alt)
    state[_VERDICT] = _UNFILLED if state[_ZEROS] >= _ZEROS_UNFILLED else verdict


def _invalid_position(sample: GnssFix) -> str:
    """Why a fix is not a position on Earth, one clause for the user."""
    largest = math.degrees(max(abs(sample.lat), abs(sample.lon)))
    if _INTEGER_DEGREES < largest < math.inf:
        return f"a latitude or longitude of {largest:.4g} deg is not a place on Earth: is it in degrees times 1e7?"
    if _HIGHEST < abs(sample.alt) < math.inf:
        return f"a height of {sample.alt:.4g} m is not a place on Earth: is it in mm?"
    return "the fix holds NaN or is not a place on Earth"


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
