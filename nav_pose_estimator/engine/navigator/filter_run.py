"""One run of the navigator's filter, from the first IMU sample to the next restart: all that a restart forgets.

``intake`` handles each sample that is not the IMU's; the IMU, which carries the filter on, is the business
of ``SinsEngine``.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from nav_pose_estimator.core.alignment.carried_heading import CarriedHeading
from nav_pose_estimator.core.alignment.rest import Stillness
from nav_pose_estimator.core.alignment.types import Alignment, FixNoise, KnownBiases
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.filter.blocks import keep_blocks
from nav_pose_estimator.core.filter.noise_identification import NoiseIdentification
from nav_pose_estimator.core.numerics.deep_copy import deep_copy
from nav_pose_estimator.core.numerics.jit import COMPILED
from nav_pose_estimator.engine.engine_clock import EngineClock
from nav_pose_estimator.engine.imu.physics import ImuPhysics
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.navigator import filter_setup, start_up
from nav_pose_estimator.engine.navigator.modes import ModeKeeper
from nav_pose_estimator.engine.navigator.past import Past
from nav_pose_estimator.engine.navigator.split_filter import SplitFilter
from nav_pose_estimator.engine.navigator.timeline import Timeline
from nav_pose_estimator.engine.observation import Observation
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import GnssFix
from nav_pose_estimator.engine.sensors.aiding import Aiding
from nav_pose_estimator.engine.sensors.aids import AIDS
from nav_pose_estimator.engine.sensors.fusion import Fusion
from nav_pose_estimator.engine.sensors.gnss.receiver import Gnss
from nav_pose_estimator.engine.sensors.imu_doubt import ImuDoubt
from nav_pose_estimator.engine.sensors.magnetic import declination
from nav_pose_estimator.engine.sensors.rest import Rest
from nav_pose_estimator.engine.sensors.routine.kinds import kinds
from nav_pose_estimator.engine.sensors.routine.routine import Routine
from nav_pose_estimator.engine.solutions import Level

Origin = tuple[float, float, float]
"""Latitude, longitude [rad] and height [m] of the local frame."""
_KNOWN_GYRO_SD = 0.01  # rad/s: a bias less certain than that tells no turn from rest
_LATE = "an observation arrived later than the filter's memory reaches; it is not used"


class FilterRun:
    """The filter on its time line, its sensors, what aligns it, and the mode it is in."""

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
        self.origin_is_fixed = parameters.origin.place() is not None  # by the operator: it is never given up
        self.clock = EngineClock()
        # Up to here IMU samples meet nothing: no observation waits, the mode stays. Other input may end it.
        self.quiet_until = -math.inf
        # While IMU rows wait to be flown (``stretch.Backlog``): the time of the last one, and who takes observations.
        self.waiting_until: float | None = None
        self.take_observation: Callable[[Observation], bool] | None = None
        self.aiding = Aiding(parameters.navigator.lost_after)
        self.gnss = Gnss(parameters, self.aiding, journal)
        self.gnss.reception.enabled = use_gnss
        self.aids = {aid.sample: aid(parameters, self.aiding, journal) for aid in AIDS}
        self.rest = Rest(parameters, self.aiding, journal)
        self.imu_doubt = ImuDoubt(parameters, self.aiding, journal)
        sensors = [*self.gnss.sensors, *self.aids.values(), self.rest, self.imu_doubt]
        self._fusion = Fusion(sensors, filter_setup.gates(parameters))
        self.noise = noise or NoiseIdentification()
        self.gnss.reception.shown = self.noise
        constants = filter_setup.constants(parameters, self.noise)
        # without a compiler it would be no faster
        expected = kinds(self.gnss, self.aids.values(), self.aiding)
        routine = Routine(expected, self.aiding, self._fusion) if COMPILED else None
        self.timeline = Timeline(constants, self._fusion.apply, parameters.navigator.memory, routine)
        fix_noise = FixNoise(self.gnss.position.noise, self.gnss.velocity.noise)
        self.start_up = start_up.StartUp(parameters, fix_noise, known)
        self.trial: CarriedHeading | None = None  # see ``heading_trial``
        self.modes = ModeKeeper(parameters.navigator)
        self.stillness = Stillness()
        self.imu_physics = ImuPhysics()
        self.imu_despair = ""  # why the IMU cannot be one, where that has spoiled the filter
        self.second_due = -math.inf  # when to look back on the last second next
        self.past = Past()

    def copy(self, journal: Journal) -> FilterRun:
        """An independent copy that reports to ``journal``: of all there is, but parameters never change."""
        twin = deep_copy(self, {id(self.journal): journal, id(self.parameters): self.parameters})
        twin.quiet_until = -math.inf
        return twin

    def set_parameters(self, parameters: Parameters) -> None:
        """Change what is marked mutable while the filter runs; the rest must be as it was."""
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
        """Renew the filter's constants with the noise identified in flight, keeping the states that it has."""
        vibration = self.imu_physics.vibration
        constants = filter_setup.constants(
            self.parameters,
            self.noise,
            (vibration.rate_noise, vibration.force_noise),
            self.gnss.reception.lasting,
        )
        keep_blocks(constants, self.timeline.filter.constants)
        self.timeline.filter.constants[:] = constants

    @property
    def now(self) -> float:
        """Engine time of the last IMU sample [s]."""
        if self.waiting_until is not None:
            return self.waiting_until
        return self.timeline.filter.time if self.timeline.running else self.start_up.time

    @property
    def despair(self) -> str:
        """Why the filter should start again; empty where it need not."""
        return self.gnss.position.despair or self.imu_despair

    @property
    def settled(self) -> SplitFilter:
        """The filter at the last IMU sample, with everything that has arrived."""
        self.timeline.settle()
        return self.timeline.filter

    @property
    def known_biases(self) -> KnownBiases | None:
        """What is known of the IMU's biases, by the filter or from the run before; None where that is little."""
        if not self.timeline.running:
            return self.start_up.known_biases
        nav, variances = self.settled.nav, self.settled.P.diagonal()
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
        self.start_up.imu(row[0])
        self.try_start()

    def try_start(self) -> None:
        """Start the filter as soon as attitude and position are known."""
        start, warm = self.start_up.result(), self.start_up.warm_start
        if start is not None and (why := self.start_up.contradiction(start)):
            self.forget_saved(why)
            if warm is not None and warm.is_fresh:  # the alignment may rest on it
                self.start_up = self.start_up.afresh(self.parameters)
                return
        self.modes.note_alignment(self.start_up.has_attitude and not self.imu_physics.refusal)
        if start is None or self.imu_physics.refusal:
            return
        self.begin(start)

    def begin(self, start: Alignment) -> None:
        """Start the filter at a state with a position, not later than the last IMU sample."""
        nav, P = filter_setup.complete_start(start, self.timeline.filter.constants, self.parameters)
        place = tuple(nav[at.LAT : at.VEL].tolist())
        if start.last_fix is not None:
            self.gnss.go_on(start.last_fix, place)
        else:
            self.gnss.begin(float(nav[at.TIME]), place)
        if self.origin is None:
            self.origin = place
        elif start_up.is_far(place, self.origin):
            text = "the fixed origin is more than 100 km from here: are origin.latitude and origin.longitude right?"
            self.journal.say(self.clock.stamp(self.now), "origin.far", Level.WARN, text)
        now = self.now
        self.timeline.start(nav, P, self.origin)
        if start.from_magnetometer or start.continues:
            attitude = nav[at.QUAT : at.GYRO_BIAS].copy()
            self.trial = CarriedHeading(float(nav[at.TIME]), attitude, start.from_magnetometer)
            self.start_up.aligner.go_on_without_magnetometer()
        text = f"aligned ({start.method}), heading to {math.degrees(math.sqrt(P[at.PHI + 2, at.PHI + 2])):.1f} deg"
        self.journal.say(self.clock.stamp(now), "aligned", Level.INFO, text)
        self.update_mode(now)

    def forget_saved(self, why: str) -> None:
        """Nothing of the state before the restart is true of this vehicle."""
        text = f"the saved state is not used: {why}"
        self.journal.say(self.clock.stamp(self.now), "resume.refused.moved", Level.WARN, text)
        if not self.origin_is_fixed:
            self.origin = None
        self.noise = self.gnss.reception.shown = NoiseIdentification()
        self.timeline.shift = np.zeros(3)
        self.renew_constants()

    def locate(self, fix: GnssFix) -> None:
        """The first position that is trusted tells the declination."""
        self.parameters = declination.located(self.parameters, fix, self.journal.say)
        self.start_up.aligner.set_declination(self.parameters.aids.declination)
        self.set_parameters(self.parameters)

    # --- observations ------------------------------------------------------------------------------------------------

    def observe(self, observation: Observation | None) -> None:
        """Put an observation, if there is one, on the time line."""
        if observation is None:
            return
        self.quiet_until = -math.inf
        if self.take_observation is not None and self.take_observation(observation):
            return
        name, stamp_ns = observation.kind.name, observation.stamp_ns
        if observation.t > self.now + 1.0:
            self.journal.say(stamp_ns, f"{name}.rejected.future", Level.WARN, f"{name}: stamp ahead of the IMU's time")
        elif not self.timeline.observe(observation):
            self.journal.say(stamp_ns, f"{name}.rejected.late", Level.INFO, f"{name}: {_LATE}")

    # --- mode --------------------------------------------------------------------------------------------------------

    def update_mode(self, t: float) -> None:
        """Bring the mode up to ``t``."""
        self.modes.update(t, self.aiding, self.gnss.reception.refusal, self.journal, self.clock.stamp)
