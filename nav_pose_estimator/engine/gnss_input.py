"""GNSS on its way into the filter: gate, time of validity, noise, and the decision whether to trust it."""

import copy
import math

import numpy as np

from nav_pose_estimator.core import measurements
from nav_pose_estimator.core.earth import radii
from nav_pose_estimator.core.gnss_monitor import GateSettings, GnssGate, Notice
from nav_pose_estimator.core.kalman import correct, gated_correct
from nav_pose_estimator.core.layout import ALT, DPOS, DVEL, LAT, LON, VEL
from nav_pose_estimator.core.reacquisition import Reacquisition, ReacquisitionSettings
from nav_pose_estimator.engine.catalogue import in_words
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.parameters.gnss import GnssParameters
from nav_pose_estimator.engine.samples import GnssFix, GnssVelocity, SatelliteCount
from nav_pose_estimator.engine.solutions import Level
from nav_pose_estimator.engine.timeline import Observation

POSITION, VELOCITY = "gnss_position", "gnss_velocity"
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
        self.set_parameters(parameters, lost_after, gates)
        self.enabled = True
        self.refusal = "no fix has arrived yet"
        self.satellites: int | None = None
        self.last_used = -math.inf  # time of validity of the last fix that corrected the filter
        self.last_offered = -math.inf  # ... that was good enough to be considered
        self.lost_since = math.nan
        self.resets = 0
        self.nis = {POSITION: 0.0, VELOCITY: 0.0}
        self._usable = False
        self._origin: tuple[float, float, float] | None = None
        self._last_fix_t = -math.inf
        self._fix_period = 1.0

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
        twin.nis = dict(self.nis)
        return twin

    # --- arrival -----------------------------------------------------------------------------------------------------

    def count(self, sample: SatelliteCount, t: float) -> None:
        """Take a satellite count valid at ``t``."""
        self.satellites = sample.count
        self._gate.update_count(t, sample.count)

    def fix(self, sample: GnssFix, t: float, now: float) -> bool:
        """Judge a fix valid at ``t`` that arrives ``now``; True when it may be offered to the filter."""
        if not all(map(math.isfinite, (sample.lat, sample.lon, sample.alt))) or abs(sample.lat) > math.pi / 2:
            return self._refuse(sample.stamp_ns, "gnss.rejected.value", "the fix holds NaN or an impossible latitude")
        if not self.enabled:
            return self._refuse(sample.stamp_ns, "gnss.rejected.disabled", "GNSS is switched off by the operator")
        sd = None if sample.cov_enu is None else np.sqrt(np.maximum(np.diag(sample.cov_enu), 0.0))
        horizontal = None if sd is None else float(max(sd[0], sd[1]))
        vertical = None if sd is None else float(sd[2])
        verdict = self._gate.assess_fix(t, sample.status, horizontal, vertical, age=max(now - t, 0.0))
        for notice in verdict.notices:
            self._tell(sample.stamp_ns, notice)
        if not verdict.usable:
            return self._refuse(sample.stamp_ns, verdict.reason, in_words(verdict.reason))
        if t > self._last_fix_t:
            self._fix_period = min(max(t - self._last_fix_t, 0.02), 5.0)
            self._last_fix_t = t
        self._usable = True
        self.last_offered = t
        return True

    def velocity(self, sample: GnssVelocity) -> bool:
        """Judge a velocity: it is as good as the last fix."""
        if not all(map(math.isfinite, sample.vel_enu[:2])):
            self._journal.count("gnss.rejected.velocity_value")
            return False
        if not (self._usable and self.enabled):
            self._journal.count("gnss.rejected.velocity_without_fix")
            return False
        return True

    def position_noise(self, sample: GnssFix) -> np.ndarray:
        """R (3, 3) [m^2]: what the receiver states, at least the floor, inflated for errors shared between fixes."""
        floor = np.array([self._parameters.position_sd] * 2 + [self._parameters.vertical_sd]) ** 2
        R = _floored(sample.cov_enu, floor)
        return R * (1.0 + self._parameters.position_correlation / self._fix_period)

    def velocity_noise(self, sample: GnssVelocity) -> np.ndarray:
        """R (3, 3) [(m/s)^2]: the floor, or what the receiver states where that is larger."""
        floor = np.array([self._parameters.velocity_sd] * 2 + [self._parameters.velocity_vertical_sd]) ** 2
        return _floored(sample.cov_enu, floor)

    def begin(self, t: float, origin: tuple[float, float, float]) -> None:
        """The filter starts at ``t`` on the strength of GNSS."""
        self._origin = origin
        self.last_used = max(self.last_used, t)
        self.refusal = ""

    # --- application, in the order of the times of validity ----------------------------------------------------------

    def apply(self, o: Observation, nav: np.ndarray, P: np.ndarray) -> None:
        """Let one observation of this input act on the filter."""
        if o.kind == POSITION:
            self._apply_position(o, nav, P)
        else:
            self._apply_velocity(o, nav, P)

    def _apply_position(self, o: Observation, nav: np.ndarray, P: np.ndarray) -> None:
        stamp, position, velocity, R = o.arguments
        z, H = measurements.gnss_position(nav, len(P), *position, self._lever)
        first = not o.memory
        if first:
            o.memory["action"] = self._decide(o, nav, P, z)
        action = o.memory["action"]
        if action == "reset":
            self._reset(nav, P, z, velocity, R, first)
        elif action == "ungated":
            correct(nav, P, z, H, R)
        elif action == "gated":
            status, nis = gated_correct(nav, P, z, H, R, *self._gates[2])
            if first:
                self._note(POSITION, stamp, o.t, status, nis, 3)
            return
        if first and action in ("reset", "ungated"):
            self._used(o.t)

    def _decide(self, o: Observation, nav: np.ndarray, P: np.ndarray, z: np.ndarray) -> str:
        stamp, _, velocity, R = o.arguments
        predicted = self._local(nav)
        fix = [p - d for p, d in zip(predicted, z.tolist(), strict=True)]
        sd = np.sqrt(np.diag(R)).tolist()
        predicted_sd = np.sqrt(np.diag(P)[DPOS : DPOS + 3]).tolist()
        gap = max(o.t - self.last_used, 0.0)
        decision = self._guard.offer(o.t, fix, velocity, sd, predicted, predicted_sd, gap)
        if decision.notice is not None:
            self._tell(stamp, decision.notice, offset_m=math.hypot(*decision.offset))
        if decision.action in ("wait", "reject"):
            self._refuse(stamp, decision.reason, in_words(decision.reason))
            return decision.action
        if decision.action == "fuse":
            return "gated" if decision.gated else "ungated"
        return "reset"

    def _apply_velocity(self, o: Observation, nav: np.ndarray, P: np.ndarray) -> None:
        stamp, velocity, R = o.arguments
        if not o.memory:
            o.memory["use"] = o.t - self.last_used <= self._lost_after
            if not o.memory["use"]:
                self._journal.count("gnss.rejected.velocity_without_position")
        if not o.memory["use"]:
            return
        z, H = measurements.gnss_velocity(nav, len(P), velocity, self._lever)
        rows = 3 if math.isfinite(velocity[2]) else 2
        soft_hard = self._gates[rows - 1]
        status, nis = gated_correct(nav, P, z[:rows], H[:rows], R[:rows, :rows], *soft_hard)
        if "counted" not in o.memory:
            o.memory["counted"] = True
            self._note(VELOCITY, stamp, o.t, status, nis, rows)

    def _reset(self, nav, P, z, velocity, R, first: bool) -> None:
        """Put position (and velocity where known) on the fix and forget their correlations."""
        r_m, r_n = radii(nav[LAT])
        nav[LON] -= z[0] / ((r_n + nav[ALT]) * math.cos(nav[LAT]))
        nav[LAT] -= z[1] / (r_m + nav[ALT])
        nav[ALT] -= z[2]
        _decorrelate(P, DPOS, R)
        if velocity is not None:
            for i, value in enumerate(velocity):
                if math.isfinite(value):
                    nav[VEL + i] = value
            _decorrelate(P, DVEL, np.diag([0.3, 0.3, 0.5]) ** 2)
        if first:
            self.resets += 1

    def _used(self, t: float) -> None:
        self.last_used = max(self.last_used, t)
        self.refusal = ""
        self._journal.count("gnss.used.position")

    def _note(self, kind: str, stamp: int, t: float, status: int, nis: float, dof: int) -> None:
        self.nis[kind] += 0.02 * (nis / dof - self.nis[kind])
        name = kind.removeprefix("gnss_")
        if status == 0:
            self._refuse(stamp, f"gnss.rejected.{name}_innovation", f"the {name} disagrees with the filter")
            return
        if status == 2:
            self._journal.count(f"gnss.inflated.{name}")
        if kind == POSITION:
            self._used(t)
        else:
            self._journal.count("gnss.used.velocity")

    @property
    def origin(self) -> tuple[float, float, float]:
        """Origin of the local frame; only a running filter has one."""
        assert self._origin is not None, "the filter does not run yet"
        return self._origin

    # --- small things ------------------------------------------------------------------------------------------------

    def _refuse(self, stamp_ns: int, name: str, why: str) -> bool:
        self._usable = self._usable and name.endswith("innovation")
        if why != self.refusal:
            self._journal.say(stamp_ns, name, Level.INFO, f"GNSS not used: {why}")
        else:
            self._journal.count(name)
        self.refusal = why
        return False

    def _tell(self, stamp_ns: int, notice: Notice, **data: float) -> None:
        self._journal.say(stamp_ns, notice.name, _LEVELS[notice.severity], notice.text, **data)

    def _local(self, nav: np.ndarray) -> list[float]:
        lat, lon, alt = self._origin or (nav[LAT], nav[LON], nav[ALT])
        r_m, r_n = radii(lat)
        east = math.remainder(nav[LON] - lon, 2.0 * math.pi) * (r_n + alt) * math.cos(lat)
        return [east, (nav[LAT] - lat) * (r_m + alt), nav[ALT] - alt]


def _floored(cov: np.ndarray | None, floor: np.ndarray) -> np.ndarray:
    """``cov`` with at least ``floor`` on its diagonal; the floor alone where the receiver states nothing."""
    if cov is None:
        return np.diag(floor)
    R = np.array(cov, dtype=float)
    R[np.diag_indices(3)] = np.maximum(np.diag(R), floor)
    return R


def _decorrelate(P: np.ndarray, start: int, R: np.ndarray) -> None:
    P[start : start + 3, :] = 0.0
    P[:, start : start + 3] = 0.0
    P[start : start + 3, start : start + 3] = R


def _gate_settings(parameters: GnssParameters) -> GateSettings:
    return GateSettings(**{name: getattr(parameters.gate, name) for name in GateSettings.__slots__})


def _return_settings(parameters: GnssParameters, lost_after: float) -> ReacquisitionSettings:
    shared = (name for name in ReacquisitionSettings.__slots__ if name != "loss_time")
    return ReacquisitionSettings(
        loss_time=lost_after, **{name: getattr(parameters.reacquisition, name) for name in shared}
    )
