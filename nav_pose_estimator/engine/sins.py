"""The strapdown navigator: samples in, navigation solutions and events out. Node and replay use this class."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from nav_pose_estimator.core import layout as at
from nav_pose_estimator.core.kalman import predicted_horizontal_sd
from nav_pose_estimator.engine import filter_setup, rehearsal_flight, start_up
from nav_pose_estimator.engine.aid_input import AidInput
from nav_pose_estimator.engine.gnss_input import POSITION, VELOCITY, GnssInput
from nav_pose_estimator.engine.imu_input import RESTARTS, ImuInput
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.modes import ModeKeeper
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import (
    AttitudeSample,
    BodyVelocity,
    GnssFix,
    GnssVelocity,
    ImuBlock,
    ImuSample,
    MagSample,
    NavigatorVelocity,
    PressureSample,
    Prior,
    Sample,
    SatelliteCount,
    SetPose,
    VelocityError,
)
from nav_pose_estimator.engine.solutions import Event, Level, Mode, NavBlock, Output, Status
from nav_pose_estimator.engine.timeline import Observation, Timeline, single_solution, step_enu

_NS = 1e-9
_PRIORITY = {VELOCITY: 0, POSITION: 1}  # a fix is judged together with the velocity of its epoch
_LATE = "an observation arrived later than the filter's memory reaches; it is not used"


class SinsEngine:
    """Strapdown navigation with a closed-loop error-state Kalman filter (CN113777645A step 3, Groves ch. 14).

    The engine never asks a clock: time comes with the samples, and GNSS acts at stamp minus ``gnss.delay``.
    """

    def __init__(self, parameters: Parameters | None = None) -> None:
        self.parameters = parameters or Parameters()
        self._constants = filter_setup.constants(self.parameters)
        self._gates = filter_setup.gates(self.parameters)
        self._journal = Journal()
        self._input = ImuInput(self.parameters.imu)
        self._gnss_enabled = True
        self._origin: tuple[float, float, float] | None = None
        self._handlers: dict[type, Callable[[Any], list[Output]]] = {
            ImuSample: self._on_imu,
            ImuBlock: self._on_imu_block,
            GnssFix: self._on_fix,
            GnssVelocity: self._on_velocity,
            SatelliteCount: self._on_count,
            MagSample: self._on_mag,
            PressureSample: lambda s: self._on_aid(s, self._aids.barometer, "baro.rejected"),
            BodyVelocity: lambda s: self._on_aid(s, self._aids.body_velocity, "body_velocity.rejected"),
            VelocityError: lambda s: self._on_aid(s, self._aids.velocity_error, "outage.rejected"),
            Prior: lambda s: self._on_aid(s, self._aids.prior, "outage.rejected"),
            SetPose: self._on_set_pose,
            AttitudeSample: self._on_attitude,
            NavigatorVelocity: lambda sample: [],  # its own, meant for the attitude filter
        }
        self._clear()

    def _clear(self) -> None:
        """The state of an engine that has seen nothing; counters, origin and the operator's choice stay."""
        p = self.parameters
        self._epoch_ns: int | None = None
        self._timeline = Timeline(self._constants, self._apply, p.navigator.memory)
        self._gnss = GnssInput(p.gnss, p.navigator.lost_after, self._gates, self._journal)
        self._gnss.enabled = self._gnss_enabled
        self._aids = AidInput(p, self._gates, self._journal)
        self._aligner = start_up.StartUp(p)
        self._modes = ModeKeeper(p.navigator)
        self._shift = np.zeros(3)  # sum of all corrections of the position, ENU

    # --- public ------------------------------------------------------------------------------------------------------

    def feed(self, sample: Sample) -> list[Output]:
        """Take one sample; returns the solutions and events that follow from it."""
        outputs = self._handlers[type(sample)](sample)
        return [*self._journal.drain(), *outputs]

    @property
    def mode(self) -> Mode:
        """How things stand."""
        return self._modes.mode

    @property
    def origin(self) -> tuple[float, float, float] | None:
        """Latitude, longitude [rad] and height [m] of the local frame, None until the first trusted position."""
        return self._origin

    def nominal_state(self) -> np.ndarray:
        """The nominal state (``core.layout``) at the last IMU sample, with everything that has arrived; a copy."""
        self._settle()
        return self._timeline.nav.copy()

    @property
    def journal(self) -> Journal:
        """Counters of everything that was used, refused or reset."""
        return self._journal

    def set_use_gnss(self, flag: bool) -> None:
        """Switch GNSS off and on again (outage drill)."""
        self._gnss_enabled = self._gnss.enabled = flag

    def set_parameters(self, parameters: Parameters) -> None:
        """Change what is marked mutable while the filter runs; the rest must be as it was."""
        self.parameters = parameters
        self._constants = filter_setup.constants(parameters)
        self._gates = filter_setup.gates(parameters)
        self._timeline.constants[:] = self._constants
        self._gnss.set_parameters(parameters.gnss, parameters.navigator.lost_after, self._gates)
        self._aids.set_parameters(parameters, self._gates)
        self._modes.set_parameters(parameters.navigator)

    def reset(self, stamp_ns: int, reason: str) -> list[Output]:
        """Forget the solution and align again. The local frame's origin stays."""
        self._input.reset()
        self._restart(stamp_ns, reason)
        return list(self._journal.drain())

    def _restart(self, stamp_ns: int, reason: str) -> None:
        self._journal.say(stamp_ns, "reset", Level.WARN, f"the navigator starts again: {reason}")
        self._clear()

    def status(self) -> Status:
        """What a pilot wants to know."""
        t, sd, later = 0.0, math.inf, math.inf
        if self._timeline.running:
            self._timeline.settle()
            t = self._timeline.time
            P = self._timeline.P
            sd = math.sqrt(P[at.DPOS, at.DPOS] + P[at.DPOS + 1, at.DPOS + 1])
            later = predicted_horizontal_sd(self._timeline.nav, P, self._constants, 30.0)
        waiting = "" if self._timeline.running else self._aligner.waiting_for(self._gnss.refusal)
        return Status(
            stamp_ns=self._stamp(t) if self._epoch_ns is not None else 0,
            mode=self.mode,
            waiting_for=waiting,
            seconds_coasting=self._modes.seconds_unaided(t, self._gnss.last_used),
            horizontal_sd=sd,
            horizontal_sd_in_30_s=later,
            gnss_refusal=self._gnss.refusal,
            satellites=self._gnss.satellites,
            counters=dict(self._journal.counters),
            values={"alignment.restarts": float(self._aligner.restarts), **self._gnss.figures()},
        )

    def warm_up(self) -> None:
        """Compile every kernel now, so that no flight waits for a compiler."""
        start_up.warm_up(self._constants, filter_setup.states(self.parameters))
        rehearsal_flight.rehearse(lambda: SinsEngine(self.parameters))

    def snapshot(self) -> SinsEngine:
        """An independent copy of the engine as it stands."""
        twin = object.__new__(SinsEngine)
        twin.__init__(self.parameters)  # type: ignore[misc]
        twin.restore(self)
        return twin

    def restore(self, snapshot: SinsEngine) -> None:
        """Continue from ``snapshot``, which stays as it is."""
        self._journal = snapshot._journal.copy()
        self._input.restore(snapshot._input.snapshot())
        self._gnss_enabled = snapshot._gnss_enabled
        self._origin = snapshot._origin
        self._epoch_ns = snapshot._epoch_ns
        self._timeline = snapshot._timeline.copy(self._apply)
        self._gnss = snapshot._gnss.copy(self._journal)
        self._aids = snapshot._aids.copy(self._journal)
        self._aligner = snapshot._aligner.copy()
        self._modes = snapshot._modes.copy()
        self._shift = snapshot._shift.copy()

    # --- IMU ---------------------------------------------------------------------------------------------------------

    def _on_imu(self, sample: ImuSample) -> list[Output]:
        outputs: list[Output] = []
        for item in self._input.accept(sample):
            if isinstance(item, Event):
                self._note_imu(item)
            else:
                row = np.array([[self._seconds(item.stamp_ns), *item.gyro, *item.accel]])
                outputs += [
                    single_solution(block, self._timeline, self._gnss.origin)
                    for block in self._advance(np.array([item.stamp_ns]), row)
                ]
        return outputs

    def _on_imu_block(self, block: ImuBlock) -> list[Output]:
        outputs: list[Output] = []
        for item in self._input.accept_block(block):
            if isinstance(item, Event):
                self._note_imu(item)
                continue
            rows = np.empty((len(item), at.IMU_COLUMNS))
            rows[:, at.IMU_T] = self._seconds(item.stamps_ns)
            rows[:, at.IMU_GYRO : at.IMU_ACCEL] = item.gyro
            rows[:, at.IMU_ACCEL :] = item.accel
            outputs += self._advance(item.stamps_ns, rows)
        return outputs

    def _note_imu(self, event: Event) -> None:
        self._journal.add(event)
        if event.name in RESTARTS and self._epoch_ns is not None:
            self._restart(event.stamp_ns, event.text)

    def _advance(self, stamps_ns: np.ndarray, rows: np.ndarray) -> list[NavBlock]:
        """Carry the filter over ``rows``; one block for each stretch of constant mode."""
        blocks: list[NavBlock] = []
        done = 0
        while done < len(rows):
            if not self._timeline.running:
                self._align(rows[done : done + 1])
                done += 1
                continue
            blocks.append(self._advance_in_one_mode(stamps_ns[done:], rows[done:]))
            done += len(blocks[-1].stamps_ns)
            if self._gnss.despair:
                epoch = self._epoch_ns  # the rows that follow count from it
                self._restart(int(blocks[-1].stamps_ns[-1]), self._gnss.despair)
                self._epoch_ns = epoch
        return blocks

    def _advance_in_one_mode(self, stamps_ns: np.ndarray, rows: np.ndarray) -> NavBlock:
        """As many rows as the mode stays the same for: up to a deadline or to the next observation that waits."""
        self._settle()
        times = rows[:, at.IMU_T]
        limit = min(self._modes.deadline(times[0], self._gnss, self._aids), self._timeline.next_observation())
        count = max(int(np.searchsorted(times, limit)), 1)
        out = self._timeline.advance(rows[:count])
        mode = self._modes.update(float(times[count - 1]), self._gnss, self._aids, self._journal, self._stamp)
        return NavBlock(stamps_ns[:count], out, mode, self._gnss.resets, self._shift.copy())

    def _settle(self) -> None:
        """Let late observations act; what they move is a correction of the map, not motion of the vehicle."""
        if self._timeline.is_settled:
            return
        before = self._timeline.nav[at.LAT : at.VEL].copy()
        self._timeline.settle()
        self._shift += step_enu(before, self._timeline.nav)

    def _align(self, row: np.ndarray) -> None:
        self._timeline.remember(row)
        self._aligner.imu(row[0])
        self._try_start(float(row[0, at.IMU_T]))

    def _try_start(self, now: float) -> None:
        """Start the filter as soon as attitude and position are known."""
        start = self._aligner.result()
        self._modes.note_alignment(self._aligner.has_attitude)
        if start is None:
            return
        nav, P = start.nav.copy(), start.P
        if self._origin is None:
            self._origin = tuple(nav[at.LAT : at.VEL].tolist())
        P = filter_setup.with_optional_blocks(P, self.parameters)
        self._gnss.begin(float(nav[at.TIME]), self._origin)
        self._timeline.start(nav, P)
        text = f"aligned ({start.method}), heading to {math.degrees(math.sqrt(P[at.PHI + 2, at.PHI + 2])):.1f} deg"
        self._journal.say(self._stamp(now), "aligned", Level.INFO, text)
        self._modes.update(now, self._gnss, self._aids, self._journal, self._stamp)

    # --- GNSS --------------------------------------------------------------------------------------------------------

    def _on_count(self, sample: SatelliteCount) -> list[Output]:
        if self._epoch_ns is None:
            return []
        t = self._now() if sample.stamp_ns is None else self._seconds(sample.stamp_ns) - self.parameters.gnss.delay
        self._gnss.count(sample, t)
        return []

    def _on_fix(self, sample: GnssFix) -> list[Output]:
        t = self._time_of(sample.stamp_ns, "gnss.rejected")
        if t is None:
            return []
        t -= self.parameters.gnss.delay
        if not self._gnss.fix(sample, t, self._now()):
            return []
        R = self._gnss.position_noise(sample)
        if self._timeline.running:
            arguments = (sample.stamp_ns, (sample.lat, sample.lon, sample.alt), R)
            self._observe(t, POSITION, arguments, sample.stamp_ns)
        else:
            self._aligner.fix(t, sample, R)
            self._try_start(self._now())
        return []

    def _on_velocity(self, sample: GnssVelocity) -> list[Output]:
        t = self._time_of(sample.stamp_ns, "gnss.rejected")
        if t is None or not self._gnss.velocity(sample):
            return []
        t -= self.parameters.gnss.delay
        R = self._gnss.velocity_noise(sample)
        self._aligner.velocity(t, sample.vel_enu, R)
        if self._timeline.running:
            self._observe(t, VELOCITY, (sample.stamp_ns, np.array(sample.vel_enu), R), sample.stamp_ns)
        else:
            self._try_start(self._now())
        return []

    # --- aids --------------------------------------------------------------------------------------------------------

    def _on_mag(self, sample: MagSample) -> list[Output]:
        t = self._time_of(sample.stamp_ns, "mag.rejected")
        if t is None:
            return []
        if not self._timeline.running:
            self._aligner.mag(t, sample.field)
            return []
        return self._aid(self._aids.magnetometer(sample, t), sample.stamp_ns)

    def _on_attitude(self, sample: AttitudeSample) -> list[Output]:
        t = self._time_of(sample.stamp_ns, "attitude.rejected")
        if t is not None and not self._timeline.running:
            self._aligner.attitude(t, sample)
        return []

    def _on_set_pose(self, sample: SetPose) -> list[Output]:
        refusal = start_up.pose_refusal(sample, self._timeline.running)
        if refusal:
            text = f"set_pose is not used: {start_up.POSE_REFUSALS[refusal]}"
            self._journal.say(sample.stamp_ns, f"set_pose.rejected.{refusal}", Level.WARN, text)
            return []
        self._settle()
        start_up.set_pose(self._timeline.nav, self._timeline.P, sample, self._gnss.origin)
        self._timeline.start(self._timeline.nav, self._timeline.P)
        self._gnss.resets += 1
        self._journal.say(sample.stamp_ns, "set_pose", Level.INFO, "the pose was set from outside")
        return []

    def _on_aid(self, sample, prepare, family: str) -> list[Output]:
        t = self._time_of(sample.stamp_ns, family)
        if t is None or not self._timeline.running:
            return []
        return self._aid(prepare(sample, t), sample.stamp_ns)

    def _aid(self, prepared: tuple[float, str, Any] | None, stamp_ns: int) -> list[Output]:
        if prepared is not None:
            self._observe(*prepared, stamp_ns)
        return []

    # --- inside ------------------------------------------------------------------------------------------------------

    def _observe(self, t: float, kind: str, arguments: tuple, stamp_ns: int) -> None:
        if t > self._now() + 1.0:
            self._journal.say(stamp_ns, f"{kind}.rejected.future", Level.WARN, f"{kind}: stamp ahead of the IMU's time")
        elif not self._timeline.observe(t, kind, arguments, _PRIORITY.get(kind, 5)):
            self._journal.say(stamp_ns, f"{kind}.rejected.late", Level.INFO, f"{kind}: {_LATE}")

    def _apply(self, o: Observation, nav: np.ndarray, P: np.ndarray) -> None:
        """Called by the time line when the filter stands at the observation's time."""
        before = nav[at.LAT : at.VEL].copy()
        if o.kind in _PRIORITY:
            self._gnss.apply(o, nav, P)
        else:
            aided = o.t - self._gnss.last_used <= self.parameters.navigator.lost_after
            self._aids.apply(o, nav, P, aided)
        if not self._timeline.replaying:
            self._shift += step_enu(before, nav)

    def _time_of(self, stamp_ns: int, family: str) -> float | None:
        """Engine time of a stamp; None (and counted) before the first IMU sample or without a stamp."""
        if self._epoch_ns is None:
            self._journal.count(f"{family}.before_imu")
            return None
        if stamp_ns <= 0:
            self._journal.say(stamp_ns, f"{family}.zero_stamp", Level.WARN, "a message came without a time stamp")
            return None
        return self._seconds(stamp_ns)

    def _now(self) -> float:
        return self._timeline.time if self._timeline.running else self._aligner.time

    def _seconds(self, stamp_ns):
        if self._epoch_ns is None:
            self._epoch_ns = int(stamp_ns if np.isscalar(stamp_ns) else stamp_ns[0])
        return (stamp_ns - self._epoch_ns) * _NS

    def _stamp(self, t: float) -> int:
        return int(self._epoch_ns or 0) + round(t * 1e9)
