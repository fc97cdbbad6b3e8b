"""One run of the navigator's filter, from the first IMU sample to the next restart: all that a restart forgets.

``intake`` says what becomes of each sample that is not the IMU's; what carries the filter on, the IMU, is the business
of ``SinsEngine``.
"""

from __future__ import annotations

import copy
import math

import numpy as np

from nav_pose_estimator.core.alignment.rest import Stillness
from nav_pose_estimator.core.alignment.types import KnownBiases
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.engine.imu import physics
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.navigator import filter_setup, imu_watch, start_up
from nav_pose_estimator.engine.navigator.engine_clock import EngineClock
from nav_pose_estimator.engine.navigator.modes import ModeKeeper
from nav_pose_estimator.engine.navigator.split_filter import SplitFilter
from nav_pose_estimator.engine.navigator.timeline import Timeline
from nav_pose_estimator.engine.observation import Observation
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import GnssFix
from nav_pose_estimator.engine.sensors import declination
from nav_pose_estimator.engine.sensors.aiding import Aiding
from nav_pose_estimator.engine.sensors.aids import AIDS
from nav_pose_estimator.engine.sensors.fusion import Fusion
from nav_pose_estimator.engine.sensors.gnss.receiver import Gnss
from nav_pose_estimator.engine.sensors.imu_doubt import ImuDoubt
from nav_pose_estimator.engine.sensors.rest import Rest
from nav_pose_estimator.engine.solutions import Level, Mode

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
    ) -> None:
        """``origin``, ``use_gnss`` and, after a short gap, the ``known`` biases are what stays from the run before."""
        self.parameters, self.journal, self.origin = parameters, journal, origin
        self.clock = EngineClock()
        # Up to here IMU samples meet nothing: no observation waits, the mode stays. Other input may end it.
        self.quiet_until = -math.inf
        self.aiding = Aiding(parameters.navigator.lost_after)
        self.gnss = Gnss(parameters, self.aiding, journal)
        self.gnss.reception.enabled = use_gnss
        self.aids = {aid.sample: aid(parameters, self.aiding, journal) for aid in AIDS}
        self._rest = Rest(parameters, self.aiding, journal)
        self.imu_doubt = ImuDoubt(parameters, self.aiding, journal)
        sensors = [*self.gnss.sensors, *self.aids.values(), self._rest, self.imu_doubt]
        self._fusion = Fusion(sensors, filter_setup.gates(parameters))
        self.timeline = Timeline(filter_setup.constants(parameters), self._fusion.apply, parameters.navigator.memory)
        self.aligner = start_up.StartUp(parameters, known)
        self.modes = ModeKeeper(parameters.navigator)
        self._stillness = Stillness()
        self.imu_physics = physics.ImuPhysics()
        self.look_due = -math.inf  # when to look at the IMU's physics next
        self.imu_despair = ""  # why the filter should start again, as the IMU is none
        self.rest_due = -math.inf if parameters.aids.zero_velocity else math.inf  # when to look for rest next

    def copy(self, journal: Journal) -> FilterRun:
        """An independent copy that reports to ``journal``: of all there is, but parameters never change."""
        twin = copy.deepcopy(self, {id(self.journal): journal, id(self.parameters): self.parameters})
        twin.quiet_until = -math.inf
        return twin

    def set_parameters(self, parameters: Parameters) -> None:
        """Change what is marked mutable while the filter runs; the rest must be as it was."""
        self.parameters = parameters = declination.as_before(parameters, self.parameters)
        self.quiet_until = -math.inf
        self.timeline.filter.constants[:] = filter_setup.constants(parameters)
        self.aiding.lost_after = parameters.navigator.lost_after
        self.gnss.set_parameters(parameters)
        for sensor in (*self.aids.values(), self._rest):
            sensor.set_parameters(parameters)
        self._fusion.gates = filter_setup.gates(parameters)
        self.modes.set_parameters(parameters.navigator)

    @property
    def now(self) -> float:
        """Engine time of the last IMU sample [s]."""
        return self.timeline.filter.time if self.timeline.running else self.aligner.time

    @property
    def settled(self) -> SplitFilter:
        """The filter at the last IMU sample, with everything that has arrived."""
        self.timeline.settle()
        return self.timeline.filter

    @property
    def known_biases(self) -> KnownBiases | None:
        """What is known of the IMU's biases, by the filter or from the run before; None where that is little."""
        if not self.timeline.running:
            return self.aligner.known_biases
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
        t = float(row[0, at.IMU_T])
        if t >= self.look_due:
            imu_watch.look(self, t)
        self.timeline.remember(row)
        self.aligner.imu(row[0])
        self.try_start()

    def try_start(self) -> None:
        """Start the filter as soon as attitude and position are known."""
        start, now = self.aligner.result(), self.now
        self.modes.note_alignment(self.aligner.has_attitude and not self.imu_physics.refusal)
        if start is None or self.imu_physics.refusal:
            return
        nav, P = filter_setup.complete_start(start, self.timeline.filter.constants, self.parameters)
        if self.origin is None:
            self.origin = tuple(nav[at.LAT : at.VEL].tolist())
        self.gnss.begin(float(nav[at.TIME]), self.origin)
        self.timeline.start(nav, P, self.origin)
        text = f"aligned ({start.method}), heading to {math.degrees(math.sqrt(P[at.PHI + 2, at.PHI + 2])):.1f} deg"
        self.journal.say(self.clock.stamp(now), "aligned", Level.INFO, text)
        self.update_mode(now)

    def locate(self, fix: GnssFix) -> None:
        """The first position that is trusted tells the declination."""
        self.parameters = declination.located(self.parameters, fix, self.journal.say)
        self.aligner.set_declination(self.parameters.aids.declination)
        self.set_parameters(self.parameters)

    # --- observations ------------------------------------------------------------------------------------------------

    def observe(self, observation: Observation | None) -> None:
        """Put an observation on the time line; None is none."""
        if observation is None:
            return
        self.quiet_until = -math.inf
        name, stamp_ns = observation.kind.name, observation.stamp_ns
        if observation.t > self.now + 1.0:
            self.journal.say(stamp_ns, f"{name}.rejected.future", Level.WARN, f"{name}: stamp ahead of the IMU's time")
        elif not self.timeline.observe(observation):
            self.journal.say(stamp_ns, f"{name}.rejected.late", Level.INFO, f"{name}: {_LATE}")

    def declare_loss(self, t: float) -> None:
        """At ``t`` GNSS counts as lost."""
        self.timeline.observe(self.gnss.loss_at(t, self.clock.stamp(t)))

    def look_for_rest(self, t: float) -> None:
        """Ahead of the IMU row at ``t``, the first one of a second: did the vehicle rest up to the row before?

        The decision falls with what has arrived by then, and stays when the past is replayed.
        """
        self.rest_due = (math.floor(t / Stillness.PERIOD) + 1.0) * Stillness.PERIOD
        whole, mean_rate = self.timeline.filter, self._stillness.add(self.timeline.recent_rows(Stillness.PERIOD))
        if mean_rate is not None:
            self.observe(self._rest.observe(mean_rate, whole.view, self.clock.stamp(whole.time)))

    # --- mode --------------------------------------------------------------------------------------------------------

    def mode_at(self, t: float) -> Mode:
        """The mode at ``t``, with what is known now."""
        return self.modes.at(t, self.aiding)

    def update_mode(self, t: float) -> None:
        """Bring the mode up to ``t``."""
        self.modes.update(t, self.aiding, self.gnss.reception.refusal, self.journal, self.clock.stamp)

    def mode_deadline(self, t: float) -> float:
        """The next time after ``t`` at which the mode may change by time alone."""
        return self.modes.deadline(t, self.aiding)
