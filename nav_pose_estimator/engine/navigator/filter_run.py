"""One run of the navigator's filter, from the first IMU sample to the next restart, and the transfer to the next run.

``intake`` processes all samples other than IMU; ``SinsEngine`` processes the IMU, which propagates the filter.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

import numpy as np

from nav_pose_estimator.core.alignment.carried_heading import CarriedHeading
from nav_pose_estimator.core.alignment.rest import Stillness
from nav_pose_estimator.core.alignment.types import Alignment, FixNoise, KnownBiases
from nav_pose_estimator.core.filter import bias_noise
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.filter.blocks import keep_blocks
from nav_pose_estimator.core.filter.noise_identification import NoiseIdentification
from nav_pose_estimator.core.gnss import clock_offset
from nav_pose_estimator.core.numerics.deep_copy import deep_copy
from nav_pose_estimator.core.numerics.jit import COMPILED
from nav_pose_estimator.engine.continuation.saved_state import SavedState
from nav_pose_estimator.engine.continuation.warm_start import LONGEST, WarmStart
from nav_pose_estimator.engine.engine_clock import NS, EngineClock
from nav_pose_estimator.engine.imu.physics import ImuPhysics
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.navigator import filter_setup, start_up
from nav_pose_estimator.engine.navigator.modes import ModeKeeper
from nav_pose_estimator.engine.navigator.past import Past
from nav_pose_estimator.engine.navigator.split_filter import SplitFilter
from nav_pose_estimator.engine.navigator.timeline import Timeline
from nav_pose_estimator.engine.observation import Observation
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import BodyVelocity, GnssFix, MagSample, PressureSample
from nav_pose_estimator.engine.sensors.aiding import Aiding
from nav_pose_estimator.engine.sensors.aids import AIDS
from nav_pose_estimator.engine.sensors.barometer import Barometer
from nav_pose_estimator.engine.sensors.body_velocity import BodyVelocitySensor
from nav_pose_estimator.engine.sensors.fusion import Fusion
from nav_pose_estimator.engine.sensors.gnss.receiver import Gnss
from nav_pose_estimator.engine.sensors.gyroscope.prior import GyroMatrix
from nav_pose_estimator.engine.sensors.gyroscope.watch import GyroWatch
from nav_pose_estimator.engine.sensors.imu_doubt import ImuDoubt
from nav_pose_estimator.engine.sensors.magnetic import declination
from nav_pose_estimator.engine.sensors.magnetometer import Magnetometer
from nav_pose_estimator.engine.sensors.rest import Rest
from nav_pose_estimator.engine.sensors.routine.kinds import kinds
from nav_pose_estimator.engine.sensors.routine.routine import Routine
from nav_pose_estimator.engine.solutions import Level

Origin = tuple[float, float, float]
"""Latitude, longitude [rad] and height [m] of the local frame."""
_SURE_HEADING = 0.35  # rad: with fixes, a state with a larger heading deviation is not continued from
_NOISE_LIFE = 3600.0  # s for which the identified noise is kept; later batteries, payload or propellers may differ
_AHEAD, _LATE = 1.0, 1.0  # s ahead of the IMU's time: refused; behind, where refused: not the delay of a message


class FilterRun:
    """The filter on its time line, with its sensors, alignment, monitors and mode."""

    def __init__(
        self,
        parameters: Parameters,
        journal: Journal,
        origin: Origin | None,
        use_gnss: bool,
        known: KnownBiases | None = None,
        noise: NoiseIdentification | None = None,
    ) -> None:
        """``origin``, ``use_gnss`` and, after a short gap, ``known`` biases and ``noise`` come from the run before."""
        self.parameters, self.journal, self.origin = parameters, journal, origin
        self.origin_is_fixed = parameters.origin.place() is not None  # set by the operator: it is never abandoned
        self.clock = EngineClock()
        # Up to this time no observation is pending and the mode cannot change, so that IMU samples take a short cut.
        # Other input resets it.
        self.quiet_until = -math.inf
        # While IMU rows are in a ``stretch.Backlog``: the time of the last one, and the receiver of observations.
        self.waiting_until: float | None = None
        self.take_observation: Callable[[Observation], bool] | None = None
        self.aiding = Aiding(parameters.navigator.lost_after)
        self.gnss = Gnss(parameters, self.aiding, journal)
        self.gnss.reception.enabled = use_gnss
        self.aids = {aid.sample: aid(parameters, self.aiding, journal) for aid in AIDS}
        self.rest = Rest(parameters, self.aiding, journal)
        self.imu_doubt = ImuDoubt(parameters, self.aiding, journal)
        self.gyro_matrix = GyroMatrix(parameters, self.aiding, journal)
        sensors = [*self.gnss.sensors, *self.aids.values(), self.rest, self.imu_doubt, self.gyro_matrix]
        self._fusion = Fusion(sensors, filter_setup.gates(parameters))
        self.noise = noise or NoiseIdentification()
        self.gnss.reception.identified = self.noise
        constants = filter_setup.constants(parameters, self.noise)
        # without a compiler the routine would not be faster
        expected = kinds(self.gnss, self.aids.values(), self.aiding)
        routine = Routine(expected, self.aiding, self._fusion) if COMPILED else None
        self.timeline = Timeline(constants, self._fusion.apply, parameters.navigator.memory, routine)
        fix_noise = FixNoise(self.gnss.position.noise, self.gnss.velocity.noise)
        self.start_up = start_up.StartUp(parameters, fix_noise, known)
        self.trial: CarriedHeading | None = None  # see ``heading_trial``
        self.modes = ModeKeeper(parameters.navigator)
        self.stillness = Stillness()
        self.imu_physics = ImuPhysics()
        self.gyro_watch = GyroWatch()
        self.imu_failure = ""  # why the IMU is implausible, where that has made the filter wrong
        self.second_due = -math.inf  # s: time at which the last second is evaluated next
        self.past = Past()
        self.gyro_wander = bias_noise.Wander()  # initial result of the bias identification
        self._began, self._unseen = math.inf, 0.0  # s: start of the filter, and its ``Alignment.unseen``
        self.pose_given = False  # by set_pose since the filter started

    def copy(self, journal: Journal, shared: Iterable[object] = ()) -> FilterRun:
        """An independent copy that reports to ``journal``.

        Only the parameters, which are immutable, are shared, and parts of the run that the caller will replace.
        """
        kept = {id(part): part for part in (self.parameters, *shared)}
        twin = deep_copy(self, {id(self.journal): journal, **kept})
        twin.quiet_until = -math.inf
        return twin

    def set_parameters(self, parameters: Parameters) -> None:
        """Change the mutable parameters of the running filter; the others must be unchanged."""
        self.parameters = parameters = declination.as_before(parameters, self.parameters)
        self.quiet_until = -math.inf
        self.past.forget()
        self.renew_constants()
        self.aiding.patience = parameters.navigator.lost_after
        self.gnss.set_parameters(parameters)
        for sensor in (*self.aids.values(), self.rest):
            sensor.set_parameters(parameters)
        self._fusion.gates = filter_setup.gates(parameters)
        self.modes.set_parameters(parameters.navigator)

    def renew_constants(self) -> None:
        """Compute the filter's constants again with the noise identified in flight; its states stay."""
        vibration = self.imu_physics.vibration
        constants = filter_setup.constants(
            self.parameters,
            self.noise,
            (vibration.rate_noise, vibration.force_noise),
            self.gnss.reception.lasting,
            self.imu_physics.motion.latency,
        )
        keep_blocks(constants, self.timeline.filter.constants)
        self.timeline.filter.set_constants(constants)

    @property
    def now(self) -> float:
        """Engine time of the last IMU sample [s]."""
        if self.waiting_until is not None:
            return self.waiting_until
        return self.timeline.filter.time if self.timeline.running else self.start_up.time

    @property
    def failure(self) -> str:
        """Why the filter has to start again; empty where it need not."""
        return self.gnss.position.failure or self.imu_failure

    @property
    def settled(self) -> SplitFilter:
        """The filter at the last IMU sample, with all observations applied."""
        self.timeline.settle()
        return self.timeline.filter

    @property
    def unseen(self) -> float:
        """s without IMU data since the last fix that corrected the position; 0 without such a gap."""
        return self._unseen if self.aiding.fix_used <= self._began else 0.0

    # --- start -------------------------------------------------------------------------------------------------------

    def align(self, row: np.ndarray) -> None:
        """Process one IMU row (1, 7) before the filter runs."""
        self.timeline.remember(row)
        self.start_up.imu(row[0])
        self.try_start()

    def try_start(self) -> None:
        """Start the filter as soon as attitude and position are known."""
        start, warm = self.start_up.result(), self.start_up.warm_start
        if start is not None and (why := self.start_up.contradiction(start)):
            self.forget_saved(why, warm is not None and warm.is_own)
            if warm is not None and warm.is_fresh:  # the alignment may be based on it
                self.start_up = self.start_up.afresh(self.parameters)
                return
        self.modes.note_alignment(self.start_up.has_attitude and not self.imu_physics.refusal)
        if start is None or self.imu_physics.refusal:
            return
        self.begin(start)

    def begin(self, start: Alignment) -> None:
        """Start the filter at a complete state that is not later than the last IMU sample."""
        nav, P = filter_setup.complete_start(start, self.timeline.filter.constants, self.parameters)
        bias_noise.go_on(nav, self.gyro_wander)
        place = tuple(nav[at.LAT : at.VEL].tolist())
        self._began, self._unseen, self.pose_given = float(nav[at.TIME]), start.unseen, False
        if start.last_fix is not None:
            self.gnss.go_on(start.last_fix, place)
        else:
            self.gnss.begin(self._began, place)
        if self.origin is None:
            self.origin = place
        elif start_up.is_far(place, self.origin):
            text = "the fixed origin is more than 100 km away: check origin.latitude and origin.longitude"
            self.journal.say(self.clock.stamp(self.now), "origin.far", Level.WARN, text)
        now = self.now
        self.timeline.start(nav, P, self.origin)
        if start.from_magnetometer or start.continues:
            attitude = nav[at.QUAT : at.GYRO_BIAS].copy()
            self.trial = CarriedHeading(self._began, attitude, start.from_magnetometer)
            self.start_up.aligner.go_on_without_magnetometer()
        text = f"aligned ({start.method}), heading to {math.degrees(math.sqrt(P[at.PHI + 2, at.PHI + 2])):.1f} deg"
        self.journal.say(self.clock.stamp(now), "aligned", Level.INFO, text)
        self.update_mode(now)

    def forget_saved(self, why: str, is_own: bool) -> None:
        """Discard the saved state; ``is_own``: it is of this process, so that origin and noise are still valid."""
        text = f"the saved state is not used: {why}"
        self.journal.say(self.clock.stamp(self.now), "resume.refused.moved", Level.WARN, text)
        if not (self.origin_is_fixed or is_own):
            self.origin = None
        if not is_own:
            self.noise, self.gyro_wander = NoiseIdentification(), bias_noise.Wander()
            self.gnss.reception.identified = self.noise
        self.timeline.shift = np.zeros(3)
        self.renew_constants()

    def locate(self, fix: GnssFix) -> None:
        """Set the declination from the first trusted position."""
        self.parameters = declination.located(self.parameters, fix, self.journal.say)
        self.start_up.aligner.set_declination(self.parameters.aids.declination)
        self.set_parameters(self.parameters)

    # --- observations ------------------------------------------------------------------------------------------------

    def observe(self, observation: Observation | None) -> None:
        """Put an observation, if there is one, on the time line; too early or too late ones are rejected."""
        if observation is None:
            return
        self.quiet_until = -math.inf
        if self.take_observation is not None and self.take_observation(observation):
            return
        if observation.t > self.now + _AHEAD or not self.timeline.observe(observation):
            refuse_stamp(self, observation.kind.name, observation.stamp_ns, observation.t)

    # --- mode --------------------------------------------------------------------------------------------------------

    def update_mode(self, t: float) -> None:
        """Update the mode to ``t`` [s]."""
        self.modes.update(t, self.aiding, self.gnss.reception.refusal, self.journal, self.clock.stamp)


def refuse_stamp(run: FilterRun, name: str, stamp_ns: int, t: float) -> None:
    """Report a measurement ``name`` whose time ``t`` [s] the IMU has not reached or left too long ago."""
    ahead = t - run.now
    which, level = ("future", Level.WARN) if ahead > 0.0 else ("late", Level.WARN if ahead < -_LATE else Level.INFO)
    stamp = stamp_ns * NS
    text = f"{name} not used: {clock_offset.in_words(ahead, stamp, stamp - ahead)}"
    run.journal.say(run.clock.stamp(run.now), f"{name}.rejected.{which}", level, text)


def state_of(run: FilterRun) -> SavedState | None:
    """State of ``run`` for the next one; before its start, the fresh saved state that it was given; else None."""
    if not run.timeline.running or run.origin is None:
        warm = run.start_up.warm_start
        return warm.saved if warm is not None and warm.is_fresh else None
    whole, t = run.settled, run.now
    east, north, up = run.timeline.shift.tolist()
    nav, base = whole.nav, slice(at.BASE_STATES)
    gate = run.gnss.reception.gate.state
    magnetometer, barometer = run.aids[MagSample], run.aids[PressureSample]
    assert isinstance(magnetometer, Magnetometer)
    assert isinstance(barometer, Barometer)
    return SavedState(
        stamp_ns=run.clock.stamp(t),
        origin=run.origin,
        position=tuple(nav[at.LAT : at.VEL].tolist()),
        velocity=tuple(nav[at.VEL : at.QUAT].tolist()),
        q_nb=tuple(nav[at.QUAT : at.GYRO_BIAS].tolist()),
        gyro_bias=tuple(nav[at.GYRO_BIAS : at.ACCEL_BIAS].tolist()),
        accel_bias=tuple(nav[at.ACCEL_BIAS : at.ACCEL_BIAS + 3].tolist()),
        cov=_with_latency(whole.P[base, base], nav, whole.constants),
        unaided=max(t - run.aiding.fix_used, 0.0),
        correction_enu=(east, north, up),
        resets=run.gnss.position.resets,
        imu_variance=run.noise.imu_variance,
        gnss_variance=run.noise.gnss_variance,
        trials=run.noise.trials,
        error_shares=run.noise.error_shares,
        gyro_wander=bias_noise.learned(nav),
        compass_offset=magnetometer.offset,
        baro_offset=barometer.offset,
        baro_variance=barometer.offset_variance,
        baro_least_sd=barometer.least_sd,
        body_velocity_error=_body_velocity_error(run),
        gate_is_open=gate.open or gate.inactive,
        is_sound=_is_sound(run, t),
    )


def _is_sound(run: FilterRun, t: float) -> bool:
    """Whether the next run may continue with attitude and position."""
    if run.modes.distrust_reason or run.gnss.position.doubt(t) or run.imu_physics.refusal or run.failure:
        return False
    # With fixes an alignment finds a better heading; without, there is no other. A heading on trial remains on trial.
    heading_sd = math.sqrt(run.settled.P[at.PHI + 2, at.PHI + 2])
    return heading_sd < _SURE_HEADING or not run.aiding.gnss_is_good(t)


def _body_velocity_error(run: FilterRun) -> float:
    """Possible error of a confirmed body velocity, relative to the speed; NaN where it is not confirmed or in doubt."""
    body, sensor = run.imu_physics.motion.body, run.aids[BodyVelocity]
    assert isinstance(sensor, BodyVelocitySensor)
    return body.possible_error if body.is_proven and not sensor.reason else math.nan


def take_over(run: FilterRun, before: FilterRun) -> None:
    """Pass to ``run`` what ``before`` knew and what does not age: the origin's status, findings on IMU and receiver."""
    run.origin_is_fixed = before.origin_is_fixed
    run.imu_physics = before.imu_physics
    run.imu_physics.forget_time()
    run.gyro_watch = before.gyro_watch
    run.gyro_watch.filter_restarts()
    run.gnss.reception.velocities = before.gnss.reception.velocities
    run.gnss.reception.velocities.forget_time()
    run.gnss.reception.velocity_scatter = before.gnss.reception.velocity_scatter


def _with_latency(P: np.ndarray, nav: np.ndarray, constants: np.ndarray) -> np.ndarray:
    """Covariance (15, 15) of a state whose position is displaced by the unknown latency of GNSS, which is not saved."""
    cov, displaced = P.copy(), constants[at.GNSS_DELAY_SD] * nav[at.GNSS_VEL : at.GNSS_VEL + 3]
    cov[at.DPOS : at.DPOS + 3, at.DPOS : at.DPOS + 3] += np.outer(displaced, displaced)
    return cov


def resumed(saved: SavedState, before: FilterRun, stamp_ns: int, why: str = "") -> FilterRun:
    """The run that replaces ``before`` and continues from ``saved`` at its first IMU sample, at ``stamp_ns``.

    ``why``: the interruption of ``before``, which left ``saved``; empty in a new process. The origin is kept at any
    age, so that the map stays the same. The identified noise is that of IMU, receiver and airframe, and its factors are
    one or more; it is kept for an hour. Everything else is kept for a minute.
    """
    gap = 1e-9 * (stamp_ns - saved.stamp_ns)
    warm, noise = WarmStart(saved, -gap, before.parameters, is_own=bool(why)), before.noise
    noise.interrupt()
    if not warm.is_own and 0.0 < gap <= _NOISE_LIFE:
        noise.imu_variance, noise.gnss_variance = saved.imu_variance, saved.gnss_variance
        noise.trials, noise.error_shares = saved.trials, saved.error_shares
    origin = before.origin if before.origin_is_fixed else saved.origin
    known = saved.known_biases if warm.is_fresh and saved.is_sound else None
    twin = FilterRun(before.parameters, before.journal, origin, before.gnss.reception.enabled, known, noise)
    take_over(twin, before)
    twin.start_up.warm_start = warm
    twin.gnss.position.resets = saved.resets + 1
    if 0.0 < gap <= _NOISE_LIFE:
        twin.gyro_wander = bias_noise.Wander(*saved.gyro_wander)
    if warm.is_fresh:
        twin.timeline.shift = np.array(saved.correction_enu)
        twin.gnss.reception.gate.state.open = saved.gate_is_open
        _begin_with_offsets(twin, saved)
    if warm.is_own and warm.is_fresh and saved.is_sound:
        for sample, aid in twin.aids.items():
            aid.take_over(before.aids[sample])
    before.journal.say(stamp_ns, *_resumption_said(saved, gap, why))
    return twin


def _begin_with_offsets(run: FilterRun, saved: SavedState) -> None:
    """Pass the saved offsets, where they are known, to magnetometer and barometer, and trust in the body velocity."""
    magnetometer, barometer = run.aids[MagSample], run.aids[PressureSample]
    if isinstance(magnetometer, Magnetometer) and math.isfinite(saved.compass_offset):
        magnetometer.begin_with(saved.compass_offset)
    if isinstance(barometer, Barometer) and math.isfinite(saved.baro_offset):
        barometer.begin_with(saved.baro_offset, saved.baro_variance, saved.baro_least_sd)
    if math.isfinite(saved.body_velocity_error):
        run.imu_physics.motion.body.begin_with(saved.body_velocity_error)


def _resumption_said(saved: SavedState, gap: float, why: str) -> tuple[str, Level, str]:
    """Name, level and text of the event with which the next run begins ``gap`` [s] after ``saved``."""
    doubt = "" if saved.is_sound else "; that state was in doubt, so attitude and position are found again"
    if why:
        text = f"{why}: the navigator continues from its state of {gap:.1f} s ago{doubt}"
        return "resume.begun", Level.WARN, text
    if 0.0 < gap <= LONGEST:
        text = f"a state from {gap:.1f} s ago was found: origin and noise are kept{doubt}"
        return "resume.begun", Level.INFO, text
    if gap > 0.0:
        kept = "origin and noise are kept" if gap <= _NOISE_LIFE else "only its origin is kept"
        text = f"a state from {gap:.0f} s ago was found, too old to continue from: {kept}"
        return "resume.origin", Level.INFO, text
    text = f"the saved state is {-gap:.1f} s newer than the IMU data: another clock or run; only its origin is kept"
    return "resume.origin", Level.WARN, text
