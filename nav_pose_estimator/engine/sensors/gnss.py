"""GNSS on its way into the filter: gate, time of validity, noise, and the decision whether to trust it."""

import copy
import math
from collections import deque
from itertools import pairwise

import numpy as np

from nav_pose_estimator.core.earth.ellipsoid import radii
from nav_pose_estimator.core.filter import bias_noise, measurements
from nav_pose_estimator.core.filter.kalman import correct, gated_correct
from nav_pose_estimator.core.filter.layout import ALT, DPOS, DVEL, LAT, LON, VEL
from nav_pose_estimator.core.gnss.quality_gate import GateSettings, GnssGate, Notice
from nav_pose_estimator.core.gnss.reacquisition import Reacquisition, ReacquisitionSettings
from nav_pose_estimator.core.gnss.return_evidence import distance, unexplained
from nav_pose_estimator.core.gnss.spoof_drift import WalkOff
from nav_pose_estimator.engine.catalogue import in_words
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.navigator.timeline import Observation
from nav_pose_estimator.engine.number_checks import is_covariance, is_position, is_within
from nav_pose_estimator.engine.parameters.gnss import GnssParameters
from nav_pose_estimator.engine.samples import GnssFix, GnssVelocity, SatelliteCount
from nav_pose_estimator.engine.solutions import Level

POSITION, VELOCITY, LOSS = "gnss_position", "gnss_velocity", "gnss_loss"
_SAME_MOTION = 1.0  # s: over this time the navigator knows the change of velocity better than a receiver
_CHANCE = 2.5  # deviations by which two fixes minutes apart may differ
_PERIOD_MEMORY = 6  # fixes that the period is taken from
_NIS_MEMORY = 300  # fixes that the 99th percentile is taken from
_NIS_TIME = 10.0  # s over which innovations are averaged
_LARGEST_FACTOR = 9.0  # of the covariance: three times the deviation
_LARGEST_SPEED = 1e3  # m/s: receivers stop at 500
_RESET_VELOCITY_SD = (0.3, 0.3, 0.5)  # m/s
_LEVELS = {"info": Level.INFO, "warn": Level.WARN, "error": Level.ERROR}


class GnssInput:
    """Turns fixes and velocities into observations, and applies them when their time has come."""

    def __init__(
        self, parameters: GnssParameters, lost_after: float, gates: list[tuple[float, float]], journal: Journal
    ):
        """``gates``: chi-square thresholds per degree-of-freedom function, see ``filter_setup.gates``."""
        self._journal = journal
        self._gate = GnssGate(_gate_settings(parameters))
        self._guard = Reacquisition(_return_settings(parameters, lost_after))
        self._walk_off = WalkOff()
        self._drifts = self._velocity_refused = False
        self.set_parameters(parameters, lost_after, gates)
        self.enabled = True
        self.refusal = "no fix has arrived yet"
        self.satellites: int | None = None
        self.last_used = -math.inf  # time of validity of the last fix that corrected the filter
        self.last_offered = -math.inf  # ... that was good enough to be considered
        self.resets = 0
        self.last_reset_m = math.nan  # size of the last one
        self.nis = {POSITION: 0.0, VELOCITY: 0.0}  # sliding mean per degree of freedom
        self._recent_nis: dict[str, deque[float]] = {kind: deque(maxlen=_NIS_MEMORY) for kind in self.nis}
        self.despair = ""  # why the filter should start again: what GNSS says cannot be mended by a reset
        self._velocity_apart = 0.0  # deviations between the two velocities at the last fix
        self._gate_radius = math.nan  # m: how far off a fix may lie and still be taken as it is
        self._usable = False
        # of the receiver's last velocity: time, navigator minus receiver [m/s], R, the velocity itself
        self._misfit: tuple[float, np.ndarray, np.ndarray, list[float]] | None = None
        self._origin: tuple[float, float, float] | None = None
        self._fix_times: tuple[float, ...] = ()  # of the newest fixes, in order of time

    def set_parameters(self, parameters: GnssParameters, lost_after: float, gates: list[tuple[float, float]]) -> None:
        """New thresholds and noises; gate and re-acquisition stay as they stand."""
        self._parameters, self._gates, self._lost_after = parameters, gates, lost_after
        self._lever = np.array(parameters.lever_arm)
        self._gate.settings = _gate_settings(parameters)
        self._guard.settings = _return_settings(parameters, lost_after)

    def copy(self, journal: Journal) -> "GnssInput":
        """An independent copy that reports to ``journal``."""
        twin = copy.copy(self)
        twin._journal = journal
        twin._gate = copy.deepcopy(self._gate)
        twin._guard = copy.deepcopy(self._guard)
        twin._walk_off = copy.copy(self._walk_off)  # its state is immutable
        twin.nis = dict(self.nis)
        twin._recent_nis = {kind: values.copy() for kind, values in self._recent_nis.items()}
        return twin

    # --- arrival -----------------------------------------------------------------------------------------------------

    def count(self, sample: SatelliteCount, t: float) -> None:
        """Take a satellite count valid at ``t``."""
        self.satellites = sample.count
        self._gate.update_count(t, sample.count)

    def fix(self, sample: GnssFix, t: float, now: float) -> bool:
        """Judge a fix valid at ``t`` that arrives ``now``; True when it may be offered to the filter."""
        self._usable = False
        if sample.status < 0:
            return self._refuse(sample.stamp_ns, "gnss.rejected.status", "the receiver has no fix")
        if not is_position(sample.lat, sample.lon, sample.alt):
            return self._refuse(sample.stamp_ns, "gnss.rejected.value", "the fix holds NaN or is no place on Earth")
        if not self.enabled:
            return self._refuse(sample.stamp_ns, "gnss.rejected.disabled", "GNSS is switched off by the operator")
        cov = self._known(sample.cov_enu, "position")
        sd = None if cov is None else np.sqrt(np.diag(cov))
        horizontal = None if sd is None else float(max(sd[0], sd[1]))
        vertical = None if sd is None else float(sd[2])
        verdict = self._gate.assess_fix(t, sample.status, horizontal, vertical, age=max(now - t, 0.0))
        for notice in verdict.notices:
            self._tell(sample.stamp_ns, notice)
        if not verdict.usable:
            return self._refuse(sample.stamp_ns, verdict.reason, in_words(verdict.reason))
        self._fix_times = tuple(sorted((*self._fix_times, t))[-_PERIOD_MEMORY:])
        self._usable = True
        self.last_offered = t
        return True

    def velocity(self, sample: GnssVelocity) -> bool:
        """Judge a velocity: it is as good as the last fix."""
        up = sample.vel_enu[2]
        if not is_within(sample.vel_enu[:2], _LARGEST_SPEED) or abs(up) > _LARGEST_SPEED:
            self._journal.count("gnss.rejected.velocity_value")
            return False
        if not (self._usable and self.enabled):
            self._journal.count("gnss.rejected.velocity_without_fix")
            return False
        return True

    def position_noise(self, sample: GnssFix) -> np.ndarray:
        """R (3, 3) [m^2]: what the receiver states, at least the floor, inflated for errors shared between fixes."""
        floor = np.array([self._parameters.position_sd] * 2 + [self._parameters.vertical_sd]) ** 2
        R = _floored(self._known(sample.cov_enu), floor)
        return R * (1.0 + self._parameters.position_correlation / self._fix_period())

    def _fix_period(self) -> float:
        """Time between fixes [s]: the shortest of the last few, so that it is the same when one comes late."""
        steps = [b - a for a, b in pairwise(self._fix_times)]
        return min(max(min(steps, default=1.0), 0.02), 5.0)

    def velocity_noise(self, sample: GnssVelocity) -> np.ndarray:
        """R (3, 3) [(m/s)^2]: the floor, or what the receiver states where that is larger."""
        floor = np.array([self._parameters.velocity_sd] * 2 + [self._parameters.velocity_vertical_sd]) ** 2
        return _floored(self._known(sample.cov_enu, "velocity"), floor)

    def _known(self, cov: np.ndarray | None, what: str = "") -> np.ndarray | None:
        """``cov`` unless it is no covariance: then it is as good as unknown, and counted as ``what``."""
        if cov is None or is_covariance(cov, 3):
            return cov
        if what:
            self._journal.count(f"gnss.{what}.covariance.flawed")
        return None

    def begin(self, t: float, origin: tuple[float, float, float]) -> None:
        """The filter starts at ``t`` on the strength of GNSS."""
        self._origin = origin
        self.last_used = max(self.last_used, t)
        self.refusal = ""

    # --- application, in the order of the times of validity ----------------------------------------------------------

    def apply(self, o: Observation, nav: np.ndarray, P: np.ndarray, constants: np.ndarray) -> None:
        """Let one observation of this input act on the filter."""
        if o.kind == LOSS:
            P *= o.arguments[0] * bias_noise.overstatement(nav)
            return
        if o.kind == POSITION:
            self._apply_position(o, nav, P, constants)
        else:
            self._apply_velocity(o, nav, P, constants)
        if o.t - self.last_used <= self._lost_after:
            bias_noise.observe(nav, P)

    def _apply_position(self, o: Observation, nav: np.ndarray, P: np.ndarray, constants: np.ndarray) -> None:
        stamp, position, R = o.arguments
        z, H = measurements.gnss_position(nav, len(P), *position, self._lever)
        first = not o.memory
        if first:
            o.memory["action"] = self._decide(o, nav, P, z, H)
        action = o.memory["action"]
        if action == "reset":
            self._reset(o, nav, P, z, R, first)
        elif action == "ungated":
            correct(nav, P, constants, z, H, R)
        elif action == "gated":
            status, nis = gated_correct(nav, P, constants, z, H, R, *self._gates[2])
            if first:
                self._note(POSITION, stamp, o.t, status, nis, 3)
            return
        if first and action in ("reset", "ungated"):
            self._used(o.t)

    def _decide(self, o: Observation, nav: np.ndarray, P: np.ndarray, z: np.ndarray, H: np.ndarray) -> str:
        stamp, _, R = o.arguments
        # what the guard remembers must be the receiver's alone: a filter gone astray would bend it
        fix = self._local(*o.arguments[1])
        predicted = [f + d for f, d in zip(fix, z.tolist(), strict=True)]
        sd = np.sqrt(R.diagonal()).tolist()
        predicted_sd = np.sqrt(P.diagonal()[DPOS : DPOS + 3]).tolist()
        gap = max(o.t - self.last_used, 0.0)
        self._gate_radius = self._guard.settings.sigmas * math.hypot(max(sd[:2]), max(predicted_sd[:2]))
        velocity, strange = self._velocity_now(o, nav, P, z, H)
        broken = self._velocity_apart > self._guard.settings.sigmas and gap < self._parameters.reacquisition.despair_gap
        if broken:  # not GNSS but the filter is what contradicts itself
            strange = 0.0
        decision = self._guard.offer(o.t, fix, velocity, sd, predicted, predicted_sd, gap, strange)
        if decision.notice is not None:
            self._tell(stamp, decision.notice, offset_m=math.hypot(*decision.offset), gap_s=gap)
        if decision.action in ("wait", "reject"):
            self._refuse(stamp, decision.reason, in_words(decision.reason))
            return decision.action
        self._watch_drift(o, fix, velocity, _CHANCE * max(sd[:2]))
        if decision.action == "fuse":
            return "gated" if decision.gated else "ungated"
        o.memory["velocity"] = velocity
        if broken:
            self.despair = f"GNSS was there all the time, yet velocities differ by {self._velocity_apart:.0f} sigma"
        return "reset"

    def _watch_drift(self, o: Observation, fix: list[float], velocity: list[float] | None, scatter: float) -> None:
        """Tell when positions leave the receiver's own velocities, and when they agree again."""
        speed = self._walk_off.update(o.t, fix, velocity, scatter)
        if speed > 0.0:
            self._journal.count("gnss.drift.fixes")
        if (speed > 0.0) == self._drifts:
            return
        self._drifts = speed > 0.0
        if self._drifts:
            text = f"GNSS positions drift by {speed:.1f} m/s against the receiver's own velocity: do not trust them"
            self._journal.say(o.arguments[0], "gnss.drift", Level.WARN, text, speed=speed)
        else:
            text = "GNSS positions agree with the receiver's velocity again"
            self._journal.say(o.arguments[0], "gnss.drift.ended", Level.INFO, text)

    def _velocity_now(
        self, o: Observation, nav: np.ndarray, P: np.ndarray, z: np.ndarray, H: np.ndarray
    ) -> tuple[list[float] | None, float]:
        """The receiver's last velocity, and what of it and the fix together no drift explains; None without one."""
        if self._misfit is None or not 0.0 <= o.t - self._misfit[0] <= _SAME_MOTION:
            self._velocity_apart = 0.0
            return None, 0.0
        _, misfit, velocity_R, velocity = self._misfit
        rows = len(misfit)
        _, velocity_H = measurements.gnss_velocity(nav, len(P), np.zeros(3), self._lever)
        R = np.zeros((3 + rows, 3 + rows))
        R[:3, :3], R[3:, 3:] = o.arguments[2], velocity_R
        self._velocity_apart = distance(misfit, velocity_H[:rows], P, velocity_R)
        strange = unexplained(np.concatenate([z, misfit]), np.concatenate([H, velocity_H[:rows]]), P, R)
        return velocity, strange

    def _apply_velocity(self, o: Observation, nav: np.ndarray, P: np.ndarray, constants: np.ndarray) -> None:
        stamp, velocity, R = o.arguments
        first = not o.memory
        if first:
            o.memory["use"] = o.t - self.last_used <= self._lost_after
        z, H = measurements.gnss_velocity(nav, len(P), velocity, self._lever)
        rows = 3 if math.isfinite(velocity[2]) else 2
        if o.memory["use"]:
            status, nis = gated_correct(nav, P, constants, z[:rows], H[:rows], R[:rows, :rows], *self._gates[rows - 1])
            if first:
                self._note(VELOCITY, stamp, o.t, status, nis, rows)
                z, _ = measurements.gnss_velocity(nav, len(P), velocity, self._lever)
        elif first:
            self._journal.count("gnss.rejected.velocity_without_position")
        if first:
            self._misfit = (o.t, z[:rows], R[:rows, :rows], velocity.tolist())

    def _reset(self, o: Observation, nav: np.ndarray, P: np.ndarray, z: np.ndarray, R: np.ndarray, first: bool) -> None:
        """Put position (and velocity where known) on the fix and forget their correlations."""
        r_m, r_n = radii(nav[LAT])
        nav[LON] -= z[0] / ((r_n + nav[ALT]) * math.cos(nav[LAT]))
        nav[LAT] -= z[1] / (r_m + nav[ALT])
        nav[ALT] -= z[2]
        _decorrelate(P, DPOS, np.asarray(R))
        for axis, value in enumerate(o.memory["velocity"] or ()):
            if math.isfinite(value):
                nav[VEL + axis] = value
                _decorrelate(P, DVEL + axis, np.array([[_RESET_VELOCITY_SD[axis] ** 2]]))
        if first:
            self.resets += 1
            self.last_reset_m = float(np.linalg.norm(z))

    def _used(self, t: float) -> None:
        self.last_used = max(self.last_used, t)
        self.refusal = ""
        self._journal.count("gnss.used.position")

    def _note(self, kind: str, stamp: int, t: float, status: int, nis: float, dof: int) -> None:
        if math.isfinite(nis):
            self.nis[kind] += min(self._fix_period() / _NIS_TIME, 0.2) * (min(nis / dof, 100.0) - self.nis[kind])
            self._recent_nis[kind].append(nis / dof)
        if status == 0:
            self._refuse_innovation(kind, stamp)
            return
        if status == 2:
            self._journal.count(f"gnss.inflated.{kind.removeprefix('gnss_')}")
        if kind == POSITION:
            self._used(t)
        else:
            self._velocity_refused = False
            self._journal.count("gnss.used.velocity")

    def _refuse_innovation(self, kind: str, stamp: int) -> None:
        """The filter's own gate: told once for velocities, which have no place in ``refusal`` beside the positions."""
        if kind == POSITION:
            self._refuse(stamp, "gnss.rejected.position_innovation", "the position disagrees with the filter")
        elif self._velocity_refused:
            self._journal.count("gnss.rejected.velocity_innovation")
        else:
            text = "GNSS velocity not used: it disagrees with the filter"
            self._journal.say(stamp, "gnss.rejected.velocity_innovation", Level.INFO, text)
            self._velocity_refused = True

    def figures(self) -> dict[str, float]:
        """How GNSS agrees with the filter: NIS per degree of freedom (1 is honest), the gate's width, the resets."""
        figures = {f"nis.{kind}": value for kind, value in self.nis.items()}
        for kind, values in self._recent_nis.items():
            figures[f"nis.{kind}.p99"] = float(np.quantile(values, 0.99)) if values else math.nan
        figures["gnss.gate_radius_m"] = self._gate_radius
        figures["gnss.resets"], figures["gnss.last_reset_m"] = float(self.resets), self.last_reset_m
        return figures

    @property
    def variance_factor(self) -> float:
        """By how much the covariance is too small as far as the last innovations tell, at least 1.

        The variance of unit weight of adjustment theory: states and noises are scaled together, the gains stay. While
        GNSS corrects the filter nothing depends on it; the covariance at a loss takes it along (``LOSS``).
        """
        return min(max(1.0, *self.nis.values()), _LARGEST_FACTOR)

    @property
    def origin(self) -> tuple[float, float, float]:
        """Origin of the local frame; only a running filter has one."""
        assert self._origin is not None, "the filter does not run yet"
        return self._origin

    # --- small things ------------------------------------------------------------------------------------------------

    def _refuse(self, stamp_ns: int, name: str, why: str) -> bool:
        if why != self.refusal:
            self._journal.say(stamp_ns, name, Level.INFO, f"GNSS not used: {why}")
        else:
            self._journal.count(name)
        self.refusal = why
        return False

    def _tell(self, stamp_ns: int, notice: Notice, **data: float) -> None:
        self._journal.say(stamp_ns, notice.name, _LEVELS[notice.severity], notice.text, **data)

    def _local(self, lat: float, lon: float, alt: float) -> list[float]:
        lat0, lon0, alt0 = self._origin or (lat, lon, alt)
        r_m, r_n = radii(lat0)
        east = math.remainder(lon - lon0, 2.0 * math.pi) * (r_n + alt0) * math.cos(lat0)
        return [east, (lat - lat0) * (r_m + alt0), alt - alt0]


def _floored(cov: np.ndarray | None, floor: np.ndarray) -> np.ndarray:
    """``cov`` with at least ``floor`` on its diagonal; the floor alone where the receiver states nothing."""
    if cov is None:
        return np.diag(floor)
    R = np.array(cov, dtype=float)
    R[np.diag_indices(3)] = np.maximum(np.diag(R), floor)
    return R


def _decorrelate(P: np.ndarray, start: int, R: np.ndarray) -> None:
    end = start + len(R)
    P[start:end, :] = 0.0
    P[:, start:end] = 0.0
    P[start:end, start:end] = R


def _gate_settings(parameters: GnssParameters) -> GateSettings:
    return GateSettings(**{name: getattr(parameters.gate, name) for name in GateSettings.__slots__})


def _return_settings(parameters: GnssParameters, lost_after: float) -> ReacquisitionSettings:
    shared = (name for name in ReacquisitionSettings.__slots__ if name != "loss_time")
    return ReacquisitionSettings(
        loss_time=lost_after, **{name: getattr(parameters.reacquisition, name) for name in shared}
    )
