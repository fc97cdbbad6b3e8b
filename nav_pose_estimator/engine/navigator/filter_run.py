"""One run of the navigator's filter, from the first IMU sample to the next restart: all that a restart forgets.

Samples other than the IMU's end here: each becomes an observation on the time line, or something for the alignment
while the filter does not run yet. What carries the filter on, the IMU, is the business of ``SinsEngine``.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from nav_pose_estimator.core.alignment.rest import Stillness
from nav_pose_estimator.core.alignment.types import KnownBiases
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.filter import noise_identification
from nav_pose_estimator.core.filter.noise_identification import NoiseIdentification
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.navigator import filter_setup, start_up
from nav_pose_estimator.engine.navigator.engine_clock import EngineClock
from nav_pose_estimator.engine.navigator.modes import DENIED, ModeKeeper
from nav_pose_estimator.engine.navigator.timeline import MOTION, Observation, Timeline
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import (
    AttitudeSample,
    BodyVelocity,
    GnssFix,
    GnssVelocity,
    MagSample,
    MotionEvidence,
    NavigatorVelocity,
    PressureSample,
    Sample,
    SatelliteCount,
    SetPose,
    VelocityError,
)
from nav_pose_estimator.engine.sensors import declination
from nav_pose_estimator.engine.sensors.aids import AidInput
from nav_pose_estimator.engine.sensors.gnss import LOSS, POSITION, VELOCITY, GnssInput
from nav_pose_estimator.engine.solutions import Level, Mode

Origin = tuple[float, float, float]
"""Latitude, longitude [rad] and height [m] of the local frame."""
_UNEVENTFUL = frozenset((MagSample, PressureSample, AttitudeSample, NavigatorVelocity))
"""Samples that change neither mode nor GNSS unless an observation comes of them."""
_PRIORITY = {VELOCITY: 0, POSITION: 1, LOSS: 2}  # a fix is judged together with the velocity of its epoch
_KNOWN_GYRO_SD = 0.01  # rad/s: a bias less certain than that tells no turn from rest
_GROUNDED = 1.0  # m/s
_LOOK_BACK = 1.5 * noise_identification.PERIOD  # s: rows beyond the last second, which began with the row before it
_LATE = "an observation arrived later than the filter's memory reaches; it is not used"


class FilterRun:
    """The filter on its time line, what aligns it, and what turns samples into its observations."""

    def __init__(
        self,
        parameters: Parameters,
        journal: Journal,
        origin: Origin | None,
        use_gnss: bool,
        known: KnownBiases | None = None,
        noise: NoiseIdentification | None = None,
    ) -> None:
        """``origin``, ``use_gnss`` and, after a short gap, ``known`` biases and ``noise`` stay from the run before."""
        self.parameters, self.journal, self.origin = parameters, journal, origin
        self.noise = noise or NoiseIdentification()
        constants, gates = self._constants(), filter_setup.gates(parameters)
        self.clock = EngineClock()
        # Up to here IMU samples meet nothing: no observation waits, the mode stays. Other input may end it.
        self.quiet_until = -math.inf
        self.timeline = Timeline(constants, self._apply, parameters.navigator.memory, frozenset(_PRIORITY))
        self.gnss = GnssInput(parameters.gnss, parameters.navigator.lost_after, gates, journal)
        self.gnss.enabled = use_gnss
        self.aids = AidInput(parameters, gates, journal)
        self.aligner = start_up.StartUp(parameters, known)
        self.modes = ModeKeeper(parameters.navigator)
        self._stillness = Stillness()
        self.second_due = -math.inf  # when to look back on the last second next

    def copy(self, journal: Journal) -> FilterRun:
        """An independent copy that reports to ``journal``."""
        twin = copy.copy(self)
        twin.journal = journal
        twin.clock = self.clock.copy()
        twin.quiet_until = -math.inf
        twin.timeline = self.timeline.copy(twin._apply)
        twin.gnss = self.gnss.copy(journal)
        twin.aids = self.aids.copy(journal)
        twin.aligner = self.aligner.copy()
        twin.modes = self.modes.copy()
        twin._stillness = self._stillness.copy()
        twin.noise = self.noise.copy()
        return twin

    def set_parameters(self, parameters: Parameters) -> None:
        """Change what is marked mutable while the filter runs; the rest must be as it was."""
        self.parameters = parameters = declination.as_before(parameters, self.parameters)
        gates = filter_setup.gates(parameters)
        self.quiet_until = -math.inf
        self.timeline.constants[:] = self._constants()
        self.gnss.set_parameters(parameters.gnss, parameters.navigator.lost_after, gates)
        self.aids.set_parameters(parameters, gates)
        self.modes.set_parameters(parameters.navigator)

    def take(self, sample: Sample) -> None:
        """Take one sample that is not the IMU's."""
        kind = type(sample)
        if kind not in _UNEVENTFUL:
            self.quiet_until = -math.inf
        _HANDLERS[kind](self, sample)

    @property
    def now(self) -> float:
        """Engine time of the last IMU sample [s]."""
        return self.timeline.time if self.timeline.running else self.aligner.time

    @property
    def known_biases(self) -> KnownBiases | None:
        """What is known of the IMU's biases, by the filter or from the run before; None where that is little."""
        if not self.timeline.running:
            return self.aligner.known_biases
        self.timeline.settle()
        nav, variances = self.timeline.nav, self.timeline.P.diagonal()
        gyro_sd, accel_sd = (
            2.0 * math.sqrt(variances[start : start + 3].max()) for start in (at.D_GYRO_BIAS, at.D_ACCEL_BIAS)
        )
        if gyro_sd > _KNOWN_GYRO_SD:
            return None
        gyro, accel = (tuple(nav[start : start + 3].tolist()) for start in (at.GYRO_BIAS, at.ACCEL_BIAS))
        return KnownBiases(gyro, accel, gyro_sd, accel_sd)

    # --- start -------------------------------------------------------------------------------------------------------

    def align(self, row: np.ndarray) -> None:
        """One IMU row (1, 7) while the filter does not run yet."""
        self.timeline.remember(row)
        self.aligner.imu(row[0])
        self._try_start()

    def _try_start(self) -> None:
        """Start the filter as soon as attitude and position are known."""
        start, now = self.aligner.result(), self.now
        self.modes.note_alignment(self.aligner.has_attitude)
        if start is None:
            return
        nav, P = filter_setup.complete_start(start, self.timeline.constants, self.parameters)
        if self.origin is None:
            self.origin = tuple(nav[at.LAT : at.VEL].tolist())
        self.gnss.begin(float(nav[at.TIME]), self.origin)
        self.timeline.start(nav, P, self.origin)
        text = f"aligned ({start.method}), heading to {math.degrees(math.sqrt(P[at.PHI + 2, at.PHI + 2])):.1f} deg"
        self.journal.say(self.clock.stamp(now), "aligned", Level.INFO, text)
        self.update_mode(now)

    # --- GNSS --------------------------------------------------------------------------------------------------------

    def declare_loss(self, t: float) -> None:
        """At ``t`` GNSS counts as lost: the covariance takes along what the last innovations told of it."""
        self.timeline.observe(t, LOSS, (self.gnss.variance_factor,), _PRIORITY[LOSS])

    def _on_count(self, sample: SatelliteCount) -> None:
        if not self.clock.running:
            return
        t = self.now
        if sample.stamp_ns is not None:
            t = self.clock.seconds(sample.stamp_ns) - self.parameters.gnss.delay
        self.gnss.count(sample, t)

    def _on_fix(self, sample: GnssFix) -> None:
        t = self.clock.time_of(sample.stamp_ns, "gnss.rejected", self.journal)
        if t is None:
            return
        t -= self.parameters.gnss.delay
        if not self.gnss.fix(sample, t, self.now):
            return
        if self.parameters.aids.declination_from_model:
            self._locate(sample)
        R = self.noise.gnss_variance * self.gnss.position_noise(sample)
        if self.timeline.running:
            arguments = (sample.stamp_ns, (sample.lat, sample.lon, sample.alt), R)
            self._observe(t, POSITION, arguments, sample.stamp_ns)
        else:
            self.aligner.fix(t, sample, R)
            self._try_start()

    def _locate(self, sample: GnssFix) -> None:
        """The first position that is trusted tells the declination."""
        self.parameters = declination.located(self.parameters, sample, self.journal.say)
        self.aligner.set_declination(self.parameters.aids.declination)
        self.set_parameters(self.parameters)

    def _on_velocity(self, sample: GnssVelocity) -> None:
        t = self.clock.time_of(sample.stamp_ns, "gnss.rejected", self.journal)
        if t is None or not self.gnss.velocity(sample):
            return
        t -= self.parameters.gnss.delay
        R = self.noise.gnss_variance * self.gnss.velocity_noise(sample)
        self.aligner.velocity(t, sample.vel_enu, R)
        if self.timeline.running:
            self._observe(t, VELOCITY, (sample.stamp_ns, np.array(sample.vel_enu), R), sample.stamp_ns)
        else:
            self._try_start()

    # --- aids --------------------------------------------------------------------------------------------------------

    def _on_mag(self, sample: MagSample) -> None:
        t = self.clock.time_of(sample.stamp_ns, "mag.rejected", self.journal)
        if t is None:
            return
        if self.timeline.running:
            self._aid(self.aids.magnetometer(sample, t), sample.stamp_ns)
        else:
            self.aligner.mag(t, sample.field)

    def _on_pressure(self, sample: PressureSample) -> None:
        t = self.clock.time_of(sample.stamp_ns, "baro.rejected", self.journal)
        if t is not None and self.timeline.running:
            self._aid(self.aids.barometer(sample, t), sample.stamp_ns)

    def _on_body_velocity(self, sample: BodyVelocity) -> None:
        t = self.clock.time_of(sample.stamp_ns, "body_velocity.rejected", self.journal)
        if t is not None and self.timeline.running:
            self._aid(self.aids.body_velocity(sample, t), sample.stamp_ns)

    def look_back(self, t: float) -> None:
        """Ahead of the IMU row at ``t``, the first one of a second: what did the rows up to the one before show?

        Whether the vehicle rests, and how noisy its sensors are. That is decided with what has arrived by then, and
        stays when the past is replayed.
        """
        self.second_due = (math.floor(t / Stillness.PERIOD) + 1.0) * Stillness.PERIOD
        timeline = self.timeline
        mean_rate = self._stillness.add(timeline.recent_rows(Stillness.PERIOD))
        if self.parameters.imu.learn_noise:
            self._identify_noise(rests=mean_rate is not None)
        if mean_rate is not None and self.parameters.aids.zero_velocity:
            self._aid(self.aids.rest(mean_rate, timeline.nav, timeline.P), self.clock.stamp(timeline.time))

    def _identify_noise(self, rests: bool) -> None:
        timeline = self.timeline
        # a smooth cruise looks like rest; motors that do not run tell nothing of vibration
        grounded = rests and math.hypot(*timeline.nav[at.VEL : at.VEL + 3].tolist()) < _GROUNDED
        aided = timeline.time - self.gnss.last_used <= self.parameters.navigator.lost_after
        if grounded or not aided or timeline.branches is not None:
            self.noise.interrupt()
        elif self.noise.note(timeline.nav, timeline.P, timeline.constants, timeline.recent_rows(_LOOK_BACK)):
            timeline.constants[:] = self._constants()

    def _constants(self) -> np.ndarray:
        constants = filter_setup.constants(self.parameters)
        constants[noise_identification.IMU_NOISE] *= self.noise.imu_variance
        return constants

    def _on_motion(self, sample: MotionEvidence) -> None:
        t = self.clock.time_of(sample.stamp_ns, "outage.rejected", self.journal)
        if t is not None and self.timeline.running and self.modes.mode in DENIED:
            self._observe(t, MOTION, (sample,), sample.stamp_ns)
            self.aids.last_bounding = max(self.aids.last_bounding, t)
            self.journal.count("outage.evidence")

    def _on_attitude(self, sample: AttitudeSample) -> None:
        t = self.clock.time_of(sample.stamp_ns, "attitude.rejected", self.journal)
        if t is not None and not self.timeline.running:
            self.aligner.attitude(t, sample)

    def _on_set_pose(self, sample: SetPose) -> None:
        refusal = start_up.pose_refusal(sample, self.timeline.running)
        if refusal:
            text = f"set_pose is not used: {start_up.POSE_REFUSALS[refusal]}"
            self.journal.say(sample.stamp_ns, f"set_pose.rejected.{refusal}", Level.WARN, text)
            return
        self.timeline.settle()
        start_up.set_pose(self.timeline.nav, self.timeline.P, sample, self.gnss.origin)
        self.timeline.start(self.timeline.nav, self.timeline.P)
        self.gnss.resets += 1
        self.noise.interrupt()
        self.journal.say(sample.stamp_ns, "set_pose", Level.INFO, "the pose was set from outside")

    def _not_for_us(self, sample: Sample) -> None:
        """Meant for the estimators around this one."""

    # --- observations ------------------------------------------------------------------------------------------------

    def _aid(self, prepared: tuple[float, str, Any] | None, stamp_ns: int) -> None:
        if prepared is not None:
            self._observe(*prepared, stamp_ns)

    def _observe(self, t: float, kind: str, arguments: tuple, stamp_ns: int) -> None:
        self.quiet_until = -math.inf
        if t > self.now + 1.0:
            self.journal.say(stamp_ns, f"{kind}.rejected.future", Level.WARN, f"{kind}: stamp ahead of the IMU's time")
        elif not self.timeline.observe(t, kind, arguments, _PRIORITY.get(kind, 5)):
            self.journal.say(stamp_ns, f"{kind}.rejected.late", Level.INFO, f"{kind}: {_LATE}")

    def _apply(self, o: Observation, nav: np.ndarray, P: np.ndarray) -> None:
        """Called by the time line when the filter stands at the observation's time."""
        if o.kind in _PRIORITY:
            self.gnss.apply(o, nav, P)
        else:
            aided = o.t - self.gnss.last_used <= self.parameters.navigator.lost_after
            self.aids.apply(o, nav, P, aided)

    # --- mode --------------------------------------------------------------------------------------------------------

    def mode_at(self, t: float) -> Mode:
        """The mode at ``t``, with what is known now."""
        return self.modes.at(t, self.gnss, self.aids)

    def update_mode(self, t: float) -> None:
        """Bring the mode up to ``t``."""
        self.modes.update(t, self.gnss, self.aids, self.journal, self.clock.stamp)

    def mode_deadline(self, t: float) -> float:
        """The next time after ``t`` at which the mode may change by time alone."""
        return self.modes.deadline(t, self.gnss, self.aids)


_HANDLERS: dict[type, Callable[[FilterRun, Any], None]] = {
    GnssFix: FilterRun._on_fix,
    GnssVelocity: FilterRun._on_velocity,
    SatelliteCount: FilterRun._on_count,
    MagSample: FilterRun._on_mag,
    PressureSample: FilterRun._on_pressure,
    BodyVelocity: FilterRun._on_body_velocity,
    MotionEvidence: FilterRun._on_motion,
    SetPose: FilterRun._on_set_pose,
    AttitudeSample: FilterRun._on_attitude,
    NavigatorVelocity: FilterRun._not_for_us,
    VelocityError: FilterRun._not_for_us,
}
