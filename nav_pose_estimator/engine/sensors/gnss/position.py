"""GNSS position on its way into the filter: the decision whether to trust it, wait for more, or start from it."""

from __future__ import annotations

import math

import numpy as np

from nav_pose_estimator.core.earth.ellipsoid import radii
from nav_pose_estimator.core.filter import bias_noise, measurements
from nav_pose_estimator.core.filter.layout import DPOS
from nav_pose_estimator.core.gnss.reacquisition import Reacquisition, ReacquisitionSettings
from nav_pose_estimator.core.gnss.return_evidence import distance, unexplained
from nav_pose_estimator.core.gnss.spoof_drift import WalkOff
from nav_pose_estimator.engine.catalogue import in_words
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.observation import GATED, LEFT_OUT, UNGATED, Decision, FilterView, Kind, Observation, Use
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.gnss import GnssParameters
from nav_pose_estimator.engine.samples import GnssFix
from nav_pose_estimator.engine.sensors.aiding import Aiding
from nav_pose_estimator.engine.sensors.gnss.innovation_record import InnovationRecord
from nav_pose_estimator.engine.sensors.gnss.reception import GnssReception
from nav_pose_estimator.engine.sensors.gnss.stated_accuracy import StatedAccuracy
from nav_pose_estimator.engine.sensors.gnss.velocity import GnssVelocitySensor
from nav_pose_estimator.engine.sensors.sensor import Linearised, Sensor
from nav_pose_estimator.engine.solutions import Level

_SAME_MOTION = 1.0  # s: over this time the navigator knows the change of velocity better than a receiver
_CHANCE = 2.5  # deviations by which two fixes minutes apart may differ


class GnssPositionSensor(Sensor):
    """Three rows, East, North, Up, of the antenna's position."""

    kind = Kind("gnss_position", precedence=1, whole=True)

    def __init__(
        self,
        parameters: Parameters,
        aiding: Aiding,
        journal: Journal,
        reception: GnssReception,
        velocity: GnssVelocitySensor,
    ) -> None:
        self._guard = Reacquisition(_return_settings(parameters.gnss, aiding.lost_after))
        super().__init__(parameters, aiding, journal)
        self._reception, self._velocity = reception, velocity
        self.record = InnovationRecord()
        self._accuracy = StatedAccuracy("position")
        self._walk_off = WalkOff()
        self._drifts = False
        self.origin: tuple[float, float, float] | None = None
        self.resets = 0
        self.last_reset_m = math.nan  # size of the last one
        self.despair = ""  # why the filter should start again: what GNSS says cannot be mended by a reset
        self._velocity_apart = 0.0  # deviations between the two velocities at the last fix
        self.gate_radius = math.nan  # m: how far off a fix may lie and still be taken as it is

    @classmethod
    def noise_model(cls, parameters: Parameters) -> str:
        """By ``gnss.noise``."""
        return parameters.gnss.noise

    def set_parameters(self, parameters: Parameters) -> None:
        """New lever arm and thresholds; what the guard has seen stays."""
        self._lever = np.array(parameters.gnss.lever_arm)
        self._despair_gap = parameters.gnss.reacquisition.despair_gap
        self._guard.settings = _return_settings(parameters.gnss, self._aiding.lost_after)

    def observe(self, sample: GnssFix, t: float) -> Observation:
        """The observation of a fix valid at ``t`` that passed the reception."""
        R = self._reception.position_noise(sample)
        return Observation(t, sample.stamp_ns, self.kind, (sample.lat, sample.lon, sample.alt), R)

    def linearise(self, o: Observation, f: FilterView) -> Linearised:
        """Position of the antenna in metres."""
        assert o.stated_R is not None
        return *measurements.gnss_position(f.nav, len(f.P), *o.measured, self._lever), o.stated_R

    def decide(self, o: Observation, f: FilterView) -> Decision:
        """Ask the guard of the return, which is offered every fix."""
        z, H, stated = self.linearise(o, f)
        R = self._accuracy.lasting(o, stated, self.noise, self._journal)
        # what the guard remembers must be the receiver's alone: a filter gone astray would bend it
        fix = self._local(*o.measured)
        predicted = [f + d for f, d in zip(fix, z.tolist(), strict=True)]
        sd = np.sqrt(R.diagonal()).tolist()
        predicted_sd = np.sqrt(f.P.diagonal()[DPOS : DPOS + 3]).tolist()
        gap = max(o.t - self._aiding.fix_used, 0.0)
        self.gate_radius = self._guard.settings.sigmas * math.hypot(max(sd[:2]), max(predicted_sd[:2]))
        velocity, strange = self._velocity_now(o, f, (z, H, R))
        broken = self._velocity_apart > self._guard.settings.sigmas and gap < self._despair_gap
        if broken:  # not GNSS but the filter is what contradicts itself
            strange = 0.0
        decision = self._guard.offer(o.t, fix, velocity, sd, predicted, predicted_sd, gap, strange)
        if decision.notice is not None:
            self._reception.tell(o.stamp_ns, decision.notice, offset_m=math.hypot(*decision.offset), gap_s=gap)
        if decision.action in ("wait", "reject"):
            self._reception.refuse(o.stamp_ns, decision.reason, in_words(decision.reason))
            return LEFT_OUT
        self._watch_drift(o, fix, velocity, _CHANCE * max(sd[:2]))
        if decision.action == "fuse":
            return GATED if decision.gated else UNGATED
        if broken:
            self.despair = f"GNSS was there all the time, yet velocities differ by {self._velocity_apart:.0f} sigma"
        return Decision(Use.RESET, velocity=tuple(velocity or ()))

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
            self._journal.say(o.stamp_ns, "gnss.drift", Level.WARN, text, speed=speed)
        else:
            text = "GNSS positions agree with the receiver's velocity again"
            self._journal.say(o.stamp_ns, "gnss.drift.ended", Level.INFO, text)

    def _velocity_now(self, o: Observation, f: FilterView, position: Linearised) -> tuple[list[float] | None, float]:
        """The receiver's last velocity, and what of it and the fix together no drift explains; None without one."""
        last = self._velocity.misfit
        if last is None or not 0.0 <= o.t - last.t <= _SAME_MOTION:
            self._velocity_apart = 0.0
            return None, 0.0
        z, H, position_R = position
        rows = len(last.difference)
        _, velocity_H = measurements.gnss_velocity(f.nav, len(f.P), np.zeros(3), self._lever)
        R = np.zeros((3 + rows, 3 + rows))
        R[:3, :3], R[3:, 3:] = position_R, last.R
        self._velocity_apart = distance(last.difference, velocity_H[:rows], f.P, last.R)
        strange = unexplained(np.concatenate([z, last.difference]), np.concatenate([H, velocity_H[:rows]]), f.P, R)
        return last.velocity, strange

    def note(self, o: Observation, f: FilterView, z: np.ndarray, status: int, nis: float) -> None:
        """Count it, and keep the innovations of fixes that had to pass the gate."""
        assert o.decision is not None
        if o.decision.use is Use.RESET:
            self.resets += 1
            self.last_reset_m = float(np.linalg.norm(z))
        elif o.decision.use is Use.GATED:
            self.record.add(nis, 3, self._reception.fix_period)
            if status == 0:
                reason = "gnss.rejected.position_innovation"
                self._reception.refuse(o.stamp_ns, reason, "the position disagrees with the filter")
                return
            if status == 2:
                self._journal.count("gnss.inflated.position")
        self._reception.use(o.t)

    def settle(self, o: Observation, f: FilterView) -> None:
        """GNSS shows how far the gyroscope's bias moves."""
        if self._aiding.gnss_is_good(o.t):
            bias_noise.observe(f.nav, f.P)

    def decide_return(self, accept: bool) -> bool:
        """What the operator says of a return that waits for that; False where none does."""
        return self._guard.decide(accept)

    def _local(self, lat: float, lon: float, alt: float) -> list[float]:
        lat0, lon0, alt0 = self.origin or (lat, lon, alt)
        r_m, r_n = radii(lat0)
        east = math.remainder(lon - lon0, 2.0 * math.pi) * (r_n + alt0) * math.cos(lat0)
        return [east, (lat - lat0) * (r_m + alt0), alt - alt0]


def _return_settings(parameters: GnssParameters, lost_after: float) -> ReacquisitionSettings:
    shared = (name for name in ReacquisitionSettings.__slots__ if name != "loss_time")
    return ReacquisitionSettings(
        loss_time=lost_after, **{name: getattr(parameters.reacquisition, name) for name in shared}
    )
