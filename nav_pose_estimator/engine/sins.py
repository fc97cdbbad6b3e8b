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
from nav_pose_estimator.engine.engine_clock import NS, EngineClock
from nav_pose_estimator.engine.gnss_input import LOSS, POSITION, VELOCITY, GnssInput
from nav_pose_estimator.engine.imu_input import RESTARTS, ImuInput
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.modes import DENIED, ModeKeeper
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import (
    AttitudeSample,
    BodyVelocity,
    GnssFix,
    GnssVelocity,
    ImuBlock,
    ImuSample,
    MagSample,
    MotionEvidence,
    NavigatorVelocity,
    PressureSample,
    Sample,
    SatelliteCount,
    SetPose,
    VelocityError,
)
from nav_pose_estimator.engine.solutions import Event, Level, Mode, NavBlock, NavSolution, Output, Status
from nav_pose_estimator.engine.timeline import MOTION, Observation, Timeline

_UNEVENTFUL = frozenset((ImuSample, ImuBlock, MagSample, PressureSample, AttitudeSample, NavigatorVelocity))
"""Samples that change neither mode nor GNSS unless an observation comes of them."""
_PRIORITY = {VELOCITY: 0, POSITION: 1, LOSS: 2}  # a fix is judged together with the velocity of its epoch
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
            MotionEvidence: self._on_motion,
            SetPose: self._on_set_pose,
            AttitudeSample: self._on_attitude,
            NavigatorVelocity: lambda sample: [],  # its own, meant for the attitude filter
            VelocityError: lambda sample: [],  # meant for the outage aid around this engine
        }
        self._clear()

    def _clear(self) -> None:
        """The state of an engine that has seen nothing; counters, origin and the operator's choice stay."""
        p = self.parameters
        self._clock = EngineClock()
        # Up to here IMU samples meet nothing: no observation waits, the mode stays. Other input may end it.
        self._quiet_until = -math.inf
        self._timeline = Timeline(self._constants, self._apply, p.navigator.memory, frozenset(_PRIORITY))
        self._gnss = GnssInput(p.gnss, p.navigator.lost_after, self._gates, self._journal)
        self._gnss.enabled = self._gnss_enabled
        self._aids = AidInput(p, self._gates, self._journal)
        self._aligner = start_up.StartUp(p)
        self._modes = ModeKeeper(p.navigator)

    # --- public ------------------------------------------------------------------------------------------------------

    def feed(self, sample: Sample) -> list[Output]:
        """Take one sample; returns the solutions and events that follow from it."""
        kind = type(sample)
        if kind not in _UNEVENTFUL:
            self._quiet_until = -math.inf
        outputs = self._handlers[kind](sample)
        events = self._journal.drain()
        return [*events, *outputs] if events else outputs

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
        self._quiet_until = -math.inf
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
            stamp_ns=self._clock.stamp(t),
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
        twin = SinsEngine(self.parameters)
        twin.restore(self)
        return twin

    def restore(self, snapshot: SinsEngine) -> None:
        """Continue from ``snapshot``, which stays as it is."""
        self._journal = snapshot._journal.copy()
        self._input.restore(snapshot._input.snapshot())
        self._gnss_enabled = snapshot._gnss_enabled
        self._origin = snapshot._origin
        self._clock = snapshot._clock.copy()
        self._quiet_until = -math.inf
        self._timeline = snapshot._timeline.copy(self._apply)
        self._gnss = snapshot._gnss.copy(self._journal)
        self._aids = snapshot._aids.copy(self._journal)
        self._aligner = snapshot._aligner.copy()
        self._modes = snapshot._modes.copy()

    # --- IMU ---------------------------------------------------------------------------------------------------------

    def _on_imu(self, sample: ImuSample) -> list[Output]:
        t = (sample.stamp_ns - self._clock.zero_ns) * NS
        if t < self._quiet_until and self._input.passes(sample):
            gyro, accel = self._input.to_body(sample.gyro), self._input.to_body(sample.accel)
            values = self._timeline.advance_one(t, gyro, accel)
            return [NavSolution(sample.stamp_ns, self._modes.mode, values, self._timeline.shift, self._gnss.resets)]
        outputs: list[Output] = []
        for item in self._input.accept(sample):
            if isinstance(item, Event):
                self._note_imu(item)
            else:
                outputs += [self._solution(block) for block in self._advance(*self._clock.imu_rows(item))]
        return outputs

    def _solution(self, block: NavBlock) -> NavSolution:
        """The solution of a block of one sample, at which the filter stands."""
        values = self._timeline.complete(block.rows[0])
        return NavSolution(int(block.stamps_ns[0]), block.mode, values, block.correction_enu, block.reset_count)

    def _on_imu_block(self, block: ImuBlock) -> list[Output]:
        outputs: list[Output] = []
        for item in self._input.accept_block(block):
            if isinstance(item, Event):
                self._note_imu(item)
            else:
                outputs += self._advance(*self._clock.imu_rows(item))
        return outputs

    def _note_imu(self, event: Event) -> None:
        self._journal.add(event)
        if event.name in RESTARTS and self._clock.running:
            self._restart(event.stamp_ns, event.text)

    def _advance(self, stamps_ns: np.ndarray, rows: np.ndarray) -> list[NavBlock]:
        """Carry the filter over ``rows``; one block for each stretch of constant mode."""
        if rows[-1, at.IMU_T] < self._quiet_until:
            return [self._block(stamps_ns, self._timeline.advance(rows))]
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
                clock = self._clock  # the rows that follow count from it
                self._restart(int(blocks[-1].stamps_ns[-1]), self._gnss.despair)
                self._clock = clock
        return blocks

    def _block(self, stamps_ns: np.ndarray, out: np.ndarray) -> NavBlock:
        return NavBlock(stamps_ns, out, self._modes.mode, self._gnss.resets, self._timeline.shift)

    def _advance_in_one_mode(self, stamps_ns: np.ndarray, rows: np.ndarray) -> NavBlock:
        """As many rows as the mode stays the same for: up to a deadline or to the next observation that waits."""
        self._settle()
        times = rows[:, at.IMU_T]
        now = float(times[0])
        if self.mode is Mode.AIDED and not now - self._gnss.last_used < self.parameters.navigator.lost_after:
            self._timeline.observe(now, LOSS, (self._gnss.variance_factor,), _PRIORITY[LOSS])
        limit = min(self._modes.deadline(now, self._gnss, self._aids), self._timeline.next_observation())
        count = len(times) if times[-1] < limit else max(int(np.searchsorted(times, limit)), 1)
        out = self._timeline.advance(rows[:count])
        now = float(times[count - 1])
        self._modes.update(now, self._gnss, self._aids, self._journal, self._clock.stamp)
        deadline = self._modes.deadline(now, self._gnss, self._aids)
        self._quiet_until = min(deadline, self._timeline.next_observation())
        return self._block(stamps_ns[:count], out)

    def _settle(self) -> None:
        """Let late observations act; what they move is a correction of the map, not motion of the vehicle."""
        self._timeline.settle()

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
        nav, P = filter_setup.complete_start(start, self._constants, self.parameters)
        if self._origin is None:
            self._origin = tuple(nav[at.LAT : at.VEL].tolist())
        self._gnss.begin(float(nav[at.TIME]), self._origin)
        self._timeline.start(nav, P, self._origin)
        text = f"aligned ({start.method}), heading to {math.degrees(math.sqrt(P[at.PHI + 2, at.PHI + 2])):.1f} deg"
        self._journal.say(self._clock.stamp(now), "aligned", Level.INFO, text)
        self._modes.update(now, self._gnss, self._aids, self._journal, self._clock.stamp)

    # --- GNSS --------------------------------------------------------------------------------------------------------

    def _on_count(self, sample: SatelliteCount) -> list[Output]:
        if not self._clock.running:
            return []
        t = self._now()
        if sample.stamp_ns is not None:
            t = self._clock.seconds(sample.stamp_ns) - self.parameters.gnss.delay
        self._gnss.count(sample, t)
        return []

    def _on_fix(self, sample: GnssFix) -> list[Output]:
        t = self._clock.time_of(sample.stamp_ns, "gnss.rejected", self._journal)
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
        t = self._clock.time_of(sample.stamp_ns, "gnss.rejected", self._journal)
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
        t = self._clock.time_of(sample.stamp_ns, "mag.rejected", self._journal)
        if t is None:
            return []
        if not self._timeline.running:
            self._aligner.mag(t, sample.field)
            return []
        return self._aid(self._aids.magnetometer(sample, t), sample.stamp_ns)

    def _on_motion(self, sample: MotionEvidence) -> list[Output]:
        t = self._clock.time_of(sample.stamp_ns, "outage.rejected", self._journal)
        if t is not None and self._timeline.running and self.mode in DENIED:
            self._observe(t, MOTION, (sample,), sample.stamp_ns)
            self._aids.last_bounding = max(self._aids.last_bounding, t)
            self._journal.count("outage.evidence")
        return []

    def _on_attitude(self, sample: AttitudeSample) -> list[Output]:
        t = self._clock.time_of(sample.stamp_ns, "attitude.rejected", self._journal)
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
        t = self._clock.time_of(sample.stamp_ns, family, self._journal)
        if t is None or not self._timeline.running:
            return []
        return self._aid(prepare(sample, t), sample.stamp_ns)

    def _aid(self, prepared: tuple[float, str, Any] | None, stamp_ns: int) -> list[Output]:
        if prepared is not None:
            self._observe(*prepared, stamp_ns)
        return []

    # --- inside ------------------------------------------------------------------------------------------------------

    def _observe(self, t: float, kind: str, arguments: tuple, stamp_ns: int) -> None:
        self._quiet_until = -math.inf
        if t > self._now() + 1.0:
            self._journal.say(stamp_ns, f"{kind}.rejected.future", Level.WARN, f"{kind}: stamp ahead of the IMU's time")
        elif not self._timeline.observe(t, kind, arguments, _PRIORITY.get(kind, 5)):
            self._journal.say(stamp_ns, f"{kind}.rejected.late", Level.INFO, f"{kind}: {_LATE}")

    def _apply(self, o: Observation, nav: np.ndarray, P: np.ndarray) -> None:
        """Called by the time line when the filter stands at the observation's time."""
        if o.kind in _PRIORITY:
            self._gnss.apply(o, nav, P)
        else:
            aided = o.t - self._gnss.last_used <= self.parameters.navigator.lost_after
            self._aids.apply(o, nav, P, aided)

    def _now(self) -> float:
        return self._timeline.time if self._timeline.running else self._aligner.time
