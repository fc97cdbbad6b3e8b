"""Engine of the strapdown navigator: navigation solutions and events from samples, for node and replay alike."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from nav_pose_estimator.core.alignment.types import KnownBiases
from nav_pose_estimator.core.numerics.deep_copy import shallow_copy
from nav_pose_estimator.engine import warm_up_flight
from nav_pose_estimator.engine.continuation.warm_start import LONGEST
from nav_pose_estimator.engine.engine_clock import NS
from nav_pose_estimator.engine.imu.doubt import Doubt
from nav_pose_estimator.engine.imu.input import ImuInput
from nav_pose_estimator.engine.imu.rules import GAP, RESTARTS
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.navigator import filter_setup, intake, start_up, stretch
from nav_pose_estimator.engine.navigator.filter_run import FilterRun, Origin, resumed, state_of, take_over
from nav_pose_estimator.engine.navigator.go_back import go_back
from nav_pose_estimator.engine.navigator.status import status_of
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import ImuBlock, ImuSample, Sample
from nav_pose_estimator.engine.solutions import Event, Level, Mode, NavBlock, NavSolution, Output, Status

_MISLED = Doubt(tilt=0.2, speed=3.0, gyro_bias=0.005, accel_bias=0.3)
"""Possible error after GNSS velocities in wrong axes or units, for a filter that cannot be computed again."""
Resume = Callable[[FilterRun, int], FilterRun]
"""Makes a run that continues from a saved state, given a fresh run and the stamp of its first IMU sample."""


class SinsEngine:
    """Strapdown navigation with a closed-loop error-state Kalman filter (CN113777645A step 3, Groves ch. 14).

    The engine never uses a clock: time comes with the samples, and GNSS is valid at stamp minus ``gnss.delay``. Its
    attributes persist over a restart of the filter, the rest of the state is in its ``run``; ``journal`` counts
    everything that was used, rejected or reset.
    """

    def __init__(self, parameters: Parameters | None = None) -> None:
        self.parameters = parameters or Parameters()
        self.journal = Journal()
        self._input = ImuInput(self.parameters.imu)
        self._gnss_enabled = True
        self.resume: Resume | None = None
        self.run = FilterRun(self.parameters, self.journal, self.parameters.origin.place(), True)

    # --- public ------------------------------------------------------------------------------------------------------

    def feed(self, sample: Sample) -> list[Output]:
        """Process one sample; returns solutions, and events ahead of those on which they bear."""
        outputs: list[Output] = []
        if isinstance(sample, ImuSample):
            outputs = self._on_sample(sample)
        elif isinstance(sample, ImuBlock):
            outputs = self._carry(self._input.accept_block(sample))
        else:
            intake.take(self.run, sample)
            self.run = _without_wrong_velocities(self.run)
        events = self.journal.drain()
        return [*outputs, *events] if events else outputs

    def feed_all(self, samples: Sequence[Sample]) -> list[Output]:
        """Process samples in order of arrival; the results are those of ``feed``, in fewer and longer blocks."""
        outputs: list[Output] = []
        backlog = stretch.Backlog(self.run)
        all_pass = self._input.accept_all([sample for sample in samples if isinstance(sample, ImuBlock)])
        try:
            for sample in samples:
                if isinstance(sample, ImuBlock):
                    outputs += _on_block(self, backlog, sample, all_pass)
                elif backlog.may_wait_for(sample):
                    intake.take(backlog.run, sample)
                    if not backlog.run.gnss.reception.velocities.misled:
                        continue
                    outputs += _flown(self, backlog)
                    self.run = _without_wrong_velocities(self.run)
                else:
                    outputs += _flown(self, backlog)
                    outputs += self.feed(sample)
                if backlog.run is not self.run:
                    backlog = stretch.Backlog(self.run)
        finally:
            outputs += _flown(self, backlog)
        return stretch.packed(outputs)

    @property
    def mode(self) -> Mode:
        """Present mode."""
        return self.run.modes.mode

    @property
    def origin(self) -> Origin | None:
        """Latitude, longitude [rad] and height [m] of the local frame, None until the first trusted position."""
        return self.run.origin

    def set_use_gnss(self, flag: bool) -> None:
        """Switch GNSS off and on again (outage drill)."""
        self._gnss_enabled = self.run.gnss.reception.enabled = flag

    def set_parameters(self, parameters: Parameters) -> None:
        """Change the mutable parameters of the running filter; the others must be unchanged."""
        self.parameters = parameters
        self.run.set_parameters(parameters)

    def reset(self, stamp_ns: int, reason: str) -> list[Output]:
        """Discard the solution and align again; the origin of the local frame stays."""
        self._input.reset()
        self.run = _afresh(self, stamp_ns, reason)
        return list(self.journal.drain())

    def status(self) -> Status:
        """Status for the operator."""
        return status_of(self.run)

    def warm_up(self) -> None:
        """Compile all kernels now, so that no flight waits for a compiler."""
        start_up.warm_up(filter_setup.constants(self.parameters, self.run.noise))
        warm_up_flight.warm_up(lambda: SinsEngine(self.parameters))

    def snapshot(self) -> SinsEngine:
        """An independent copy of the engine."""
        twin = shallow_copy(self)
        twin._input = ImuInput(self.parameters.imu)
        twin.restore(self)
        return twin

    def restore(self, snapshot: SinsEngine) -> None:
        """Continue from ``snapshot``, which is not changed."""
        self.journal = snapshot.journal.copy()
        self._input.restore(snapshot._input.snapshot())
        self._gnss_enabled, self.resume = snapshot._gnss_enabled, snapshot.resume
        self.run = snapshot.run.copy(self.journal)

    # --- IMU ---------------------------------------------------------------------------------------------------------

    def _on_sample(self, sample: ImuSample) -> list[Output]:
        run = self.run
        t = (sample.stamp_ns - run.clock.zero_ns) * NS
        if t < run.quiet_until and self._input.passes(sample):
            mounting = self._input.mounting
            in_body = sample if mounting.is_none else mounting.sample(sample)
            values = run.timeline.advance_one(t, in_body.gyro, in_body.accel)
            return [NavSolution(sample.stamp_ns, run.modes.mode, values, run.timeline.shift, run.gnss.position.resets)]
        return self._carry(self._input.accept(sample))

    def _carry(self, items: list[ImuSample | Event] | list[ImuBlock | Event]) -> list[Output]:
        """Process the output of the IMU input in order: samples, and events, which may end the run."""
        outputs: list[Output] = []
        for item in items:
            if isinstance(item, Event):
                self.journal.add(item)
                if item.name in RESTARTS and self.run.clock.running:
                    self.run = _after(self, item)
                continue
            if self.resume is not None:
                resume, self.resume = self.resume, None
                self.run = resume(self.run, item.stamp_ns if isinstance(item, ImuSample) else int(item.stamps_ns[0]))
            run = self.run
            stamps_ns, rows = run.clock.imu_rows(item)
            ahead = self._go_on(stretch.carry(run, stamps_ns, rows), stamps_ns, rows)
            if isinstance(item, ImuSample):  # a block is of one row, at which its filter stands, also if it has failed
                ahead = [solution_at_end(run, one) if isinstance(one, NavBlock) else one for one in ahead]
            outputs += ahead
        return outputs

    def _go_on(self, ahead: list[Output], stamps_ns: np.ndarray, rows: np.ndarray) -> list[Output]:
        """Outputs of IMU ``rows``, of which ``ahead`` are those up to a failure of the filter, if it has failed.

        A failed filter is replaced by a fresh one, which processes the remaining rows.
        """
        outputs = ahead
        while self.run.failure:
            ends = [int(one.stamps_ns[-1]) for one in ahead if isinstance(one, NavBlock)]
            last = ends[-1] if ends else int(stamps_ns[0])  # an alignment stops after one row
            done = int(stamps_ns.searchsorted(last, side="right"))
            stamps_ns, rows = stamps_ns[done:], rows[done:]
            clock = self.run.clock  # engine time continues
            # no saved state: the failure has made it wrong
            self.run = _afresh(self, last, self.run.failure)
            self.run.clock = clock
            ahead = stretch.carry(self.run, stamps_ns, rows) if len(rows) else []
            outputs = [*outputs, *ahead]
        return outputs


def goes_on_over(engine: SinsEngine, block: ImuBlock) -> bool:
    """Whether the navigator will not start again within ``block``: nothing is wrong with it, and no fix waits."""
    waiting = engine.run.timeline.queue.waiting()
    return engine._input.is_usual(block) and not any(one.kind.whole for one in waiting)


def solution_at_end(run: FilterRun, block: NavBlock) -> NavSolution:
    """The whole solution at the last row of ``block``, at which the filter of ``run`` stands."""
    values = run.timeline.filter.complete(block.rows[-1])
    return NavSolution(int(block.stamps_ns[-1]), block.mode, values, block.correction_enu, block.reset_count)


def _on_block(engine: SinsEngine, backlog: stretch.Backlog, block: ImuBlock, passes: bool) -> list[Output]:
    """Add ``block`` to ``backlog``, or process it now. ``passes``: the checks on arrival have accepted it."""
    items: list[ImuBlock | Event]
    items = [engine._input.mounting.block(block)] if passes else engine._input.accept_block(block)
    whole = items[0] if len(items) == 1 else None
    if isinstance(whole, ImuBlock) and engine.resume is None and backlog.is_open():
        return _let_wait(engine, backlog, whole)
    return [*_flown(engine, backlog), *engine._carry(items)]


def _let_wait(engine: SinsEngine, backlog: stretch.Backlog, block: ImuBlock) -> list[Output]:
    """Add ``block`` to the open backlog; where a look back is due within it, the part before is processed first."""
    outputs: list[Output] = []
    later = backlog.add(block)
    while True:
        if backlog.is_full:
            outputs += _flown(engine, backlog)
        if later is None:
            return outputs
        if backlog.run is not engine.run or not backlog.look_back_before(later) or not backlog.is_open():
            rest: list[ImuBlock | Event] = [later]
            return [*outputs, *engine._carry(rest)]
        later = backlog.add(later)


def _flown(engine: SinsEngine, backlog: stretch.Backlog) -> list[Output]:
    """Process the whole backlog; returns solutions and events."""
    return [*engine._go_on(*backlog.flown()), *engine.journal.drain()]


def _after(engine: SinsEngine, event: Event) -> FilterRun:
    """The run after a gap in the IMU data or a change of the clock.

    After a gap the state before it is still valid, and the new run continues from it. A clock set back may mean another
    flight, which starts from nothing.
    """
    if event.name != GAP:
        return _afresh(engine, event.stamp_ns, event.text)
    before, saved = engine.run, state_of(engine.run)
    if saved is None or not saved.is_possible:
        is_short = saved is None and event.data["gap_s"] < LONGEST
        return _afresh(engine, event.stamp_ns, event.text, before.start_up.known_biases if is_short else None)
    began_ns = event.stamp_ns - round(event.data["gap_s"] / NS)  # by the present clock, which may have been set back
    saved = replace(saved, stamp_ns=min(saved.stamp_ns, began_ns))
    gap = (event.stamp_ns - saved.stamp_ns) * NS
    if gap > LONGEST:
        text = f"no IMU data for {gap:.0f} s, so the vehicle's position is unknown without GNSS"
        return _afresh(engine, event.stamp_ns, text)
    before.parameters = _parameters(engine)
    return resumed(saved, before, event.stamp_ns, event.text)


def _afresh(engine: SinsEngine, stamp_ns: int, reason: str, known: KnownBiases | None = None) -> FilterRun:
    """A fresh run; counters, origin, declination and the operator's choice of GNSS stay."""
    engine.journal.say(stamp_ns, "reset", Level.WARN, f"the navigator starts again: {reason}")
    before = engine.run
    noise = None if known is None else before.noise  # with known biases it is the same flight
    abandoned = before.gnss.position.abandons_origin and not before.origin_is_fixed
    origin = None if abandoned else before.origin
    run = FilterRun(_parameters(engine), engine.journal, origin, before.gnss.reception.enabled, known, noise)
    take_over(run, before)
    return run


def _parameters(engine: SinsEngine) -> Parameters:
    """Parameters of the next run, with the declination that the model has given."""
    if engine.run.parameters.aids.declination == engine.parameters.aids.declination:
        return engine.parameters  # a model that gave none (the clock was not set yet?) is tried again
    return engine.run.parameters


def _without_wrong_velocities(run: FilterRun) -> FilterRun:
    """``run``, or, where GNSS velocities have just turned out to be wrong, a run without their effect."""
    velocities = run.gnss.reception.velocities
    if not velocities.misled:
        return run
    velocities.misled = False
    stamp_ns = run.clock.stamp(run.now)
    without = go_back(run, stamp_ns)
    if without is run and run.timeline.running:
        run.observe(run.imu_doubt.observe(_MISLED, run.timeline.filter.time, stamp_ns))
    return without
