"""GNSS position as an observation of the filter: the decision to use it, to wait for more, or to reset to it."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np

from nav_pose_estimator.core.earth.ellipsoid import radii
from nav_pose_estimator.core.filter import bias_noise, measurements
from nav_pose_estimator.core.filter.kalman import ACCEPTED
from nav_pose_estimator.core.filter.layout import ALT, DPOS, VEL
from nav_pose_estimator.core.filter.strapdown import note_gnss
from nav_pose_estimator.core.gnss import height_reference
from nav_pose_estimator.core.gnss.height_reference import HeightReference
from nav_pose_estimator.core.gnss.reacquisition import Reacquisition, ReacquisitionSettings
from nav_pose_estimator.core.gnss.return_evidence import distance, unexplained
from nav_pose_estimator.core.gnss.slow_height import SlowHeight
from nav_pose_estimator.engine.events.catalogue import in_words
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.observation import LEFT_OUT, Decision, FilterView, Kind, Observation, Use
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.gnss import GnssParameters
from nav_pose_estimator.engine.samples import GnssFix, Vector3
from nav_pose_estimator.engine.sensors.aiding import Aiding
from nav_pose_estimator.engine.sensors.gnss.innovation_record import InnovationRecord
from nav_pose_estimator.engine.sensors.gnss.lasting_error import whole_variance
from nav_pose_estimator.engine.sensors.gnss.lasting_jump import Contradiction, LastingJump
from nav_pose_estimator.engine.sensors.gnss.position_monitors import PositionMonitors
from nav_pose_estimator.engine.sensors.gnss.pull import Pull
from nav_pose_estimator.engine.sensors.gnss.reception import GnssReception
from nav_pose_estimator.engine.sensors.gnss.stated_accuracy import StatedAccuracy
from nav_pose_estimator.engine.sensors.gnss.velocity import GnssVelocitySensor
from nav_pose_estimator.engine.sensors.gnss.velocity_input import VelocityInput
from nav_pose_estimator.engine.sensors.gnss.velocity_report import DoubtReport
from nav_pose_estimator.engine.sensors.sensor import Linearised, Sensor
from nav_pose_estimator.engine.solutions import Level

_ANOTHER_PLACE = 5e4  # m: a reset by more means that the start was wrong, and the origin with it
_SAME_STEP = 20.0  # s without a rejected height after which the next one is an event again
_EITHER = 0.71  # RMS error, relative to the step, where either of two height references may be right
CHANCE = 2.5
"""Standard deviations by which two fixes minutes apart may differ."""


class GnssPositionSensor(Sensor):
    """Three rows: position of the antenna, ENU; two rows without a valid height.

    The reference of its decisions is subtracted from the height [m]; it is NaN where the height is left out.
    """

    kind = Kind("gnss_position", precedence=1, whole=True)

    def __init__(
        self,
        parameters: Parameters,
        aiding: Aiding,
        journal: Journal,
        reception: GnssReception,
        velocity: GnssVelocitySensor,
    ) -> None:
        self.guard = Reacquisition(_return_settings(parameters.gnss, aiding))
        super().__init__(parameters, aiding, journal)
        self.reception, self.velocity = reception, velocity
        self.record = InnovationRecord()
        self._accuracy = StatedAccuracy("position")
        self.heights = HeightReference()
        self.slow_height = SlowHeight()
        self._height_left_out = -math.inf  # s: time at which a height was last left out
        self.origin: tuple[float, float, float] | None = None
        self.resets = 0
        self.last_reset_m = math.nan  # size of the last reset
        self.failure = ""  # why the filter has to start again, because a reset is not sufficient
        self.jump, self.contradiction = LastingJump(), Contradiction()
        self.pull = Pull(journal, parameters.gnss.reacquisition.probation)
        self.monitors = PositionMonitors(journal, reception.rounding, reception.scatter)
        self.abandons_origin = False  # whether the start, and with it the origin, was far from the true position
        self._doubt_report = DoubtReport(journal)
        self._velocity_sigmas = 0.0  # Mahalanobis distance of the velocity at the last fix
        self.gate_radius = math.nan  # m: largest horizontal innovation of an expected fix

    @classmethod
    def noise_model(cls, parameters: Parameters) -> str:
        """The model of ``gnss.noise``."""
        return parameters.gnss.noise

    def set_parameters(self, parameters: Parameters) -> None:
        """Take a new lever arm and thresholds; the state of the guard is kept."""
        self.lever = np.array(parameters.gnss.lever_arm)
        self._despair_gap = parameters.gnss.reacquisition.despair_gap
        self._parameters = parameters.gnss
        self.vertical_sd = parameters.gnss.vertical_sd  # m, of a fix at least
        self.guard.settings = _return_settings(parameters.gnss, self._aiding)

    def observe(self, sample: GnssFix, t: float) -> Observation:
        """The observation of a fix valid at ``t`` [s] that has passed the reception."""
        if self.guard.settings.loss_time != self._aiding.lost_after:  # the receiver's period has changed
            self.guard.settings = _return_settings(self._parameters, self._aiding)
        R = self.reception.position_noise(sample, in_filter=True)
        return Observation(t, sample.stamp_ns, self.kind, (sample.lat, sample.lon, sample.alt), R)

    def linearise(self, o: Observation, f: FilterView) -> Linearised:
        """Two or three rows: position of the antenna [m]."""
        assert o.stated_R is not None
        reference = self.heights.shift if o.decision is None else o.decision.reference
        lat, lon, alt = o.measured
        height = alt - reference
        rows = 3 if math.isfinite(height) else 2
        z, H = measurements.gnss_position(f.nav, len(f.P), lat, lon, height if rows == 3 else 0.0, self.lever)
        measurements.see_gnss_error(z, H, f.nav, f.constants, measurements.POSITION)
        return z[:rows], H[:rows], o.stated_R[:rows, :rows]

    def decide(self, o: Observation, f: FilterView) -> Decision:
        """The guard's decision, with the covariance factor and the floors of all monitors."""
        widening = self._consistency_factor(o, f) if self._aiding.gnss_is_good(o.t) else 1.0
        decision = self._guard_decision(o, f)
        if self.velocity.doubt.is_hopeless(o.t) and o.t - self._aiding.fix_used < self._despair_gap:
            self.failure = "GNSS was never away, yet velocities differ, and positions too"
        pull_sd, pull_speed_sd = self.pull.least_sd()
        monitored_sd, height_sd, speed_sd = self.monitors.least_sd(_speed(f))
        vertical = max(_EITHER * self.heights.span, height_sd)
        if decision.use in (Use.GATED, Use.UNGATED) and not math.isnan(decision.reference):
            self.slow_height.note(o.t, -float(self.linearise(o, f)[0][2]))
            vertical = max(vertical, self.slow_height.least_sd(self.vertical_sd))
        least_sd = (max(self.jump.least_sd(o.t), pull_sd, monitored_sd), vertical, max(pull_speed_sd, speed_sd))
        return replace(decision, widening=widening, least_sd=least_sd)

    def doubt(self, t: float) -> str:
        """Why the position at ``t`` [s] is less certain than usual, one clause for the user; empty where it is not."""
        reason = self.jump.reason(t) or self.contradiction.reason(t) or self.monitors.reason() or self.pull.reason()
        reason = reason or _unknown_height(self.reception.velocities)
        if reason or not self._aiding.gnss_is_good(t):
            return reason
        return self.velocity.doubt.lately(t)

    def _consistency_factor(self, o: Observation, f: FilterView) -> float:
        """Factor on the covariance by the consistency test of velocities and positions, with its events."""
        z, H, R = (part[:2] for part in self.linearise(o, f))
        doubt = self.velocity.doubt
        was = doubt.reason
        factor = doubt.position(o.t, distance(z, H, f.P, R[:, :2]), z.tolist())
        self._doubt_report.note(o.t, o.stamp_ns, was, doubt.reason, self.monitors.latency.reason())
        return factor

    def _guard_decision(self, o: Observation, f: FilterView) -> Decision:
        """Offer the fix to the guard, and turn its decision into one of the filter."""
        reference = self._height_reference(o, f)
        z, H, R = self.linearise(o, f)
        if math.isnan(reference):
            z, H, R = z[:2], H[:2], R[:2, :2]
        R = self._accuracy.lasting(o, R, self.noise, self._journal)
        # the guard receives positions of the receiver alone, so that an error of the filter cannot distort its tracks
        fix = local(o.measured, reference, float(f.nav[ALT]), self.origin)
        offset, sd = [*z.tolist(), 0.0][:3], [*np.sqrt(whole_variance(R, self.reception.lasting)).tolist(), 0.0][:3]
        self.pull.fix(o.t, (-offset[0], -offset[1]), o.stamp_ns)
        self.monitors.fix(offset[0], offset[1], o.stamp_ns)
        predicted = [place + difference for place, difference in zip(fix, offset, strict=True)]
        predicted_sd = np.sqrt(f.P.diagonal()[DPOS : DPOS + 3]).tolist()
        gap = max(o.t - self._aiding.fix_used, 0.0)
        self.gate_radius = self.guard.settings.sigmas * math.hypot(max(sd[:2]), max(predicted_sd[:2]))
        velocity, unexplained_sigmas = self._velocity_now(o, f, (z, H, R))
        filter_is_wrong = self._velocity_sigmas > self.guard.settings.sigmas and gap < self._despair_gap
        if filter_is_wrong:
            unexplained_sigmas = 0.0
        decision = self.guard.offer(o.t, fix, velocity, sd, predicted, predicted_sd, gap, unexplained_sigmas)
        if decision.notice is not None:
            self.reception.report(o.stamp_ns, decision.notice, offset_m=math.hypot(*decision.offset), gap_s=gap)
        self.contradiction.note(o.t, decision, self.guard.settings)
        if decision.action in ("wait", "reject"):
            self.reception.refuse(o.stamp_ns, decision.reason, in_words(decision.reason))
            return LEFT_OUT
        self.monitors.used(o, fix, velocity, CHANCE * max(sd[:2]))
        if not decision.gated:
            self.jump.returned(o.t, gap, decision)
        if decision.action == "fuse":
            return Decision(Use.GATED if decision.gated else Use.UNGATED, reference)
        self.jump.note(o.t, gap, decision, self.guard.settings)
        if math.hypot(*decision.offset) > _ANOTHER_PLACE:
            self.abandons_origin = True
            self.failure = f"GNSS is {1e-3 * math.hypot(*decision.offset):.0f} km from where the navigator started"
        elif filter_is_wrong:
            self.failure = f"GNSS was never away, yet velocities differ by {self._velocity_sigmas:.0f} sigma"
        return Decision(Use.RESET, reference, tuple(velocity or ()))

    def _height_reference(self, o: Observation, f: FilterView) -> float:
        """Reference to subtract from the height of a fix [m]; NaN without a height, or after a jump of it alone."""
        z, _, R = self.linearise(o, f)
        if len(z) < 3:
            return math.nan
        own = whole_variance(R, self.reception.lasting)
        sigmas, variances = self.guard.settings.sigmas, own + f.P.diagonal()[DPOS : DPOS + 3]
        if np.any(np.abs(z[:2]) > sigmas * np.sqrt(variances[:2])):
            return self.heights.shift
        offset, known = -float(z[2]), self._aiding.height_is_good(o.t) and not self.velocity.doubt.reason
        outcome = self.heights.offer(
            o.t, offset, sigmas * math.sqrt(variances[2]), 0.5 * sigmas * math.sqrt(own[2]), known
        )
        if outcome == height_reference.USED:
            return self.heights.shift
        if outcome == height_reference.MOVED:
            text = (
                f"GNSS heights stay {offset:+.1f} m off: taken as another reference (geoid, ellipsoid) and shifted back"
            )
            self._journal.say(o.stamp_ns, "gnss.height.moved", Level.WARN, text, shift_m=self.heights.shift)
            return self.heights.shift
        last_left_out, self._height_left_out = self._height_left_out, o.t
        if o.t - last_left_out < _SAME_STEP:
            self._journal.count("gnss.rejected.height")
        else:
            text = (
                f"GNSS height not used: it jumped by {offset:+.0f} m while the position stayed: "
                "geoid against ellipsoid?"
            )
            self._journal.say(o.stamp_ns, "gnss.rejected.height", Level.WARN, text)
        return math.nan

    def _velocity_now(self, o: Observation, f: FilterView, position: Linearised) -> tuple[Vector3 | None, float]:
        """The receiver's last velocity (None without one), and the joint distance that no drift explains."""
        last = self.velocity.misfit_at(o.t)
        if last is None:
            self._velocity_sigmas = 0.0
            return None, 0.0
        z, H, position_R = position
        difference = np.array(last.difference)
        placed, rows = len(z), len(difference)
        velocity_z, velocity_H = measurements.gnss_velocity(f.nav, len(f.P), np.zeros(3), self.lever)
        measurements.see_gnss_error(velocity_z, velocity_H, f.nav, f.constants, measurements.VELOCITY)
        R = np.zeros((placed + rows, placed + rows))
        R[:placed, :placed], R[placed:, placed:] = position_R, last.R
        self._velocity_sigmas = distance(difference, velocity_H[:rows], f.P, last.R)
        both = np.concatenate([z, difference]), np.concatenate([H, velocity_H[:rows]])
        unexplained_sigmas = unexplained(*both, f.P, R, placed)
        return last.velocity, unexplained_sigmas

    def note(self, o: Observation, f: FilterView, z: np.ndarray, status: int, nis: float) -> None:
        """Count the outcome, and record the innovations of gated fixes."""
        assert o.decision is not None
        if o.decision.use is Use.RESET:
            self.resets += 1
            self.last_reset_m = float(np.linalg.norm(z))
        elif o.decision.use is Use.GATED:
            self.record.add(nis, z, self.reception.fix_period, accepted=status == ACCEPTED)
            if status == 0:
                reason = "gnss.rejected.position_innovation"
                self.reception.refuse(o.stamp_ns, reason, "the position disagrees with the filter")
                return
            if status == 2:
                self._journal.count("gnss.inflated.position")
        self.reception.use(o.t, with_height=len(z) == 3)

    def settle(self, o: Observation, f: FilterView) -> None:
        """Identify the gyroscope bias's noise, and keep the velocity, while GNSS is good."""
        if self._aiding.gnss_is_good(o.t):
            bias_noise.observe(f.nav, f.P)
            note_gnss(f.nav)

    def decide_return(self, accept: bool) -> bool:
        """The operator's decision on a held return, or on a change that no force explains; False without either."""
        return self.guard.decide(accept) or (accept and self.pull.dismiss())


def _speed(f: FilterView) -> float:
    """Horizontal speed over ground [m/s]."""
    return math.hypot(f.nav[VEL], f.nav[VEL + 1])


def _unknown_height(velocities: VelocityInput) -> str:
    """Why there is no true height, one clause for the user; empty where there is one."""
    if not velocities.height_fault or math.isfinite(velocities.pressure_altitude):
        return ""
    return f"the height of GNSS is {velocities.height_fault}, and no barometer gives another"


def local(
    place: tuple[float, float, float], reference: float, height: float, origin: tuple[float, float, float] | None
) -> Vector3:
    """A fix in the local frame (3,) [m], its height minus ``reference``, or ``height`` where it has none."""
    lat, lon, alt = place[0], place[1], place[2] - reference
    if math.isnan(alt):
        alt = height
    lat0, lon0, alt0 = origin or (lat, lon, alt)
    north, to_axis, cosine = _metres_per_radian(lat0, alt0)
    return math.remainder(lon - lon0, 2.0 * math.pi) * to_axis * cosine, (lat - lat0) * north, alt - alt0


@lru_cache(maxsize=8)  # of the same origin for hours
def _metres_per_radian(lat: float, alt: float) -> tuple[float, float, float]:
    """Radii of curvature plus height [m], along the meridian and across it, and the cosine of the latitude."""
    r_m, r_n = radii(lat)
    return r_m + alt, r_n + alt, math.cos(lat)


def _return_settings(parameters: GnssParameters, aiding: Aiding) -> ReacquisitionSettings:
    named = {
        name: getattr(parameters.reacquisition, name) for name in ReacquisitionSettings.__slots__ if name != "loss_time"
    }
    if aiding.lost_after > aiding.patience:  # a slow receiver
        named["track_timeout"] = max(named["track_timeout"], aiding.lost_after)
    return ReacquisitionSettings(loss_time=aiding.lost_after, **named)
