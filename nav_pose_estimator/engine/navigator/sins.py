"""The strapdown navigator: samples in, navigation solutions and events out. Node and replay use this class."""

from __future__ import annotations

import math

import numpy as np

from nav_pose_estimator.core.alignment.types import KnownBiases
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.filter.kalman import horizontal_sd, predicted_horizontal_sd
from nav_pose_estimator.engine import warm_up_flight
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.navigator import filter_setup, start_up
from nav_pose_estimator.engine.navigator.engine_clock import NS
from nav_pose_estimator.engine.navigator.filter_run import FilterRun, Origin
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import ImuBlock, ImuSample, Sample
from nav_pose_estimator.engine.sensors.aids import UNEVENTFUL
from nav_pose_estimator.engine.sensors.imu import GAP, RESTARTS, ImuInput
from nav_pose_estimator.engine.solutions import Event, Level, Mode, NavBlock, NavSolution, Output, Status

_SHORT_GAP = 60.0  # s without IMU data over which its biases stay known


class SinsEngine:
    """Strapdown navigation with a closed-loop error-state Kalman filter (CN113777645A step 3, Groves ch. 14).

    The engine never asks a clock: time comes with the samples, and GNSS acts at stamp minus ``gnss.delay``. What it
    keeps over a restart is here, the rest in its ``FilterRun``.
    """

    def __init__(self, parameters: Parameters | None = None) -> None:
        self.parameters = parameters or Parameters()
        self._journal = Journal()
        self._input = ImuInput(self.parameters.imu)
        self._gnss_enabled = True
        self._run = FilterRun(self.parameters, self._journal, None, True)

    # --- public ------------------------------------------------------------------------------------------------------

    def feed(self, sample: Sample) -> list[Output]:
        """Take one sample; returns the solutions and events that follow from it."""
        outputs: list[Output]
        if isinstance(sample, ImuSample):
            outputs = self._on_imu(sample)
        elif isinstance(sample, ImuBlock):
            outputs = self._on_imu_block(sample)
        else:
            self._run.take(sample)
            outputs = []
        events = self._journal.drain()
        return [*events, *outputs] if events else outputs

    @property
    def mode(self) -> Mode:
        """How things stand."""
        return self._run.modes.mode

    @property
    def origin(self) -> Origin | None:
        """Latitude, longitude [rad] and height [m] of the local frame, None until the first trusted position."""
        return self._run.origin

    @property
    def declination(self) -> float:
        """Magnetic declination that it goes by [rad], east positive."""
        return self._run.parameters.aids.declination

    def nominal_state(self) -> np.ndarray:
        """The nominal state (``filter.layout``) at the last IMU sample, with everything that has arrived; a copy."""
        self._run.timeline.settle()
        return self._run.timeline.nav.copy()

    @property
    def horizontal_sd(self) -> float:
        """Root of the summed position variances East and North [m]; infinite while the filter does not run."""
        timeline = self._run.timeline
        if not timeline.running:
            return math.inf
        timeline.settle()
        return float(horizontal_sd(timeline.P))

    @property
    def journal(self) -> Journal:
        """Counters of everything that was used, refused or reset."""
        return self._journal

    def set_use_gnss(self, flag: bool) -> None:
        """Switch GNSS off and on again (outage drill)."""
        self._gnss_enabled = self._run.gnss.enabled = flag

    def set_parameters(self, parameters: Parameters) -> None:
        """Change what is marked mutable while the filter runs; the rest must be as it was."""
        self.parameters = parameters
        self._run.set_parameters(parameters)

    def reset(self, stamp_ns: int, reason: str) -> list[Output]:
        """Forget the solution and align again. The local frame's origin stays."""
        self._input.reset()
        self._restart(stamp_ns, reason)
        return list(self._journal.drain())

    def _restart(self, stamp_ns: int, reason: str, known: KnownBiases | None = None) -> None:
        """A filter that has seen nothing; counters, origin, declination and the operator's choice stay."""
        self._journal.say(stamp_ns, "reset", Level.WARN, f"the navigator starts again: {reason}")
        before, parameters = self._run, self._run.parameters
        if parameters.aids.declination == self.parameters.aids.declination:
            parameters = self.parameters  # a field model that said nothing (the clock was not set yet?) is asked again
        noise = None if known is None else before.noise  # the same flight goes on
        self._run = FilterRun(parameters, self._journal, before.origin, self._gnss_enabled, known, noise)

    def status(self) -> Status:
        """What a pilot wants to know."""
        run, timeline, gnss = self._run, self._run.timeline, self._run.gnss
        t, sd, later = 0.0, self.horizontal_sd, math.inf
        if timeline.running:
            t = timeline.time
            later = predicted_horizontal_sd(timeline.nav, timeline.P, timeline.constants, 30.0)
        waiting = "" if timeline.running else run.aligner.waiting_for(gnss.refusal)
        return Status(
            stamp_ns=run.clock.stamp(t),
            mode=self.mode,
            waiting_for=waiting,
            seconds_coasting=run.modes.seconds_unaided(t, gnss.last_used),
            horizontal_sd=sd,
            horizontal_sd_in_30_s=later,
            gnss_refusal=gnss.refusal,
            satellites=gnss.satellites,
            counters=dict(self._journal.counters),
            values={"alignment.restarts": float(run.aligner.restarts), **gnss.figures(), **run.noise.figures()},
        )

    def warm_up(self) -> None:
        """Compile every kernel now, so that no flight waits for a compiler."""
        start_up.warm_up(filter_setup.constants(self.parameters), filter_setup.states(self.parameters))
        warm_up_flight.rehearse(lambda: SinsEngine(self.parameters))

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
        self._run = snapshot._run.copy(self._journal)

    # --- IMU ---------------------------------------------------------------------------------------------------------

    def _on_imu(self, sample: ImuSample) -> list[Output]:
        run = self._run
        t = (sample.stamp_ns - run.clock.zero_ns) * NS
        if t < run.quiet_until and self._input.passes(sample):
            gyro, accel = self._input.to_body(sample.gyro), self._input.to_body(sample.accel)
            values = run.timeline.advance_one(t, gyro, accel)
            return [NavSolution(sample.stamp_ns, run.modes.mode, values, run.timeline.shift, run.gnss.resets)]
        outputs: list[Output] = []
        for item in self._input.accept(sample):
            if isinstance(item, Event):
                self._note_imu(item)
            else:
                outputs += [self._solution(block) for block in self._advance(*self._run.clock.imu_rows(item))]
        return outputs

    def _solution(self, block: NavBlock) -> NavSolution:
        """The solution of a block of one sample, at which the filter stands."""
        values = self._run.timeline.complete(block.rows[0])
        return NavSolution(int(block.stamps_ns[0]), block.mode, values, block.correction_enu, block.reset_count)

    def _on_imu_block(self, block: ImuBlock) -> list[Output]:
        outputs: list[Output] = []
        for item in self._input.accept_block(block):
            if isinstance(item, Event):
                self._note_imu(item)
            else:
                outputs += self._advance(*self._run.clock.imu_rows(item))
        return outputs

    def _note_imu(self, event: Event) -> None:
        self._journal.add(event)
        if event.name in RESTARTS and self._run.clock.running:
            # over a short gap the IMU stays as it is; a clock set back may be another flight
            short = event.name == GAP and event.data["gap_s"] < _SHORT_GAP
            self._restart(event.stamp_ns, event.text, self._run.known_biases if short else None)

    def _advance(self, stamps_ns: np.ndarray, rows: np.ndarray) -> list[NavBlock]:
        """Carry the filter over ``rows``; one block for each stretch of constant mode."""
        if rows[-1, at.IMU_T] < self._run.quiet_until:
            return self._blocks(stamps_ns, self._run.timeline.advance(rows))
        blocks: list[NavBlock] = []
        done = 0
        while done < len(rows):
            if not self._run.timeline.running:
                self._run.align(rows[done : done + 1])
                done += 1
                continue
            ahead = self._advance_in_one_mode(stamps_ns[done:], rows[done:])
            done += sum(len(block.stamps_ns) for block in ahead)
            blocks += ahead
            if self._run.gnss.despair:
                clock = self._run.clock  # the rows that follow count from it
                self._restart(int(blocks[-1].stamps_ns[-1]), self._run.gnss.despair)
                self._run.clock = clock
        return blocks

    def _blocks(self, stamps_ns: np.ndarray, out: np.ndarray) -> list[NavBlock]:
        """The rows of the last ``advance``, one block for each stretch of constant correction."""
        timeline, mode, resets = self._run.timeline, self.mode, self._run.gnss.resets
        blocks: list[NavBlock] = []
        done = 0
        for end, correction in [*timeline.moves, (len(out), timeline.shift)]:
            if end > done:
                blocks.append(NavBlock(stamps_ns[done:end], out[done:end], mode, resets, correction))
                done = end
        return blocks

    def _advance_in_one_mode(self, stamps_ns: np.ndarray, rows: np.ndarray) -> list[NavBlock]:
        """As many rows as the mode stays the same for: up to a deadline or to an observation that may change it."""
        run = self._run
        # what late observations move is a correction of the map, not motion of the vehicle
        run.timeline.settle()
        times = rows[:, at.IMU_T]
        now = float(times[0])
        if self.mode is Mode.AIDED and not now - run.gnss.last_used < self.parameters.navigator.lost_after:
            run.declare_loss(now)
        if now >= run.second_due:
            run.look_back(now)
        limit = min(run.mode_deadline(now), run.timeline.next_observation(besides=UNEVENTFUL), run.second_due)
        count = len(times) if times[-1] < limit else max(int(np.searchsorted(times, limit)), 1)
        if run.mode_at(now) is not self.mode:
            count = 1  # the change has the time of its row, whatever the size of the blocks
        out = run.timeline.advance(rows[:count])
        now = float(times[count - 1])
        run.update_mode(now)
        run.quiet_until = min(run.mode_deadline(now), run.timeline.next_observation(), run.second_due)
        return self._blocks(stamps_ns[:count], out)
