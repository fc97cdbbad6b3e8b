"""Forced outages on one flight: one aided pass, and from each start a copy of the estimator without GNSS.

The copy is made at the start of the outage, so that everything it has learned is from before. It runs for the longest
outage; the errors of shorter ones are taken from the same run, in which no GNSS returns.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from nav_pose_estimator.core.filter.layout import OUT_COLUMNS, OUT_POS, OUT_QUAT, OUT_VEL
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator, Snapshot
from nav_pose_estimator.engine.outage.methods.registry import extrapolations
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import ImuBlock
from nav_pose_estimator.engine.solutions import Mode, NavBlock
from nav_pose_estimator.offline.benchmarks.outage.aided_pass import Batch, Start, aided_pass, part_of
from nav_pose_estimator.offline.flights import latency, methods
from nav_pose_estimator.offline.flights.config_file import load_parameters
from nav_pose_estimator.offline.flights.flight_window import flight_window, outage_starts
from nav_pose_estimator.offline.flights.outage_errors import NOT_AIDED, OutageErrors, judge
from nav_pose_estimator.offline.flights.outages import GnssRemoval, Outage, OutageProof
from nav_pose_estimator.offline.flights.recording import Recording
from nav_pose_estimator.offline.flights.tracks import Reference, Track, TrackRecorder, displacement_enu, shift
from nav_pose_estimator.offline.logs.open_recording import open_recording, prepared
from nav_pose_estimator.offline.logs.options import LogOptions
from nav_pose_estimator.offline.replay.replay import reference_lever

GRID = 1.0  # s between the points of an error-growth curve
MARGIN = 0.2  # s for which a run continues after the outage, still without GNSS, to include its last fix


@dataclass(frozen=True)
class Task:
    """A pass over a recording. ``method``: name of the estimator's; ``predictors``: methods derived from its states."""

    bag: Path
    method: str
    predictors: tuple[str, ...]
    lengths: tuple[float, ...]
    every: float
    first: float | None = None
    last: float = np.inf
    gnss_delay: str | None = None
    config: Path | None = None
    airframe: Path | None = None
    prior: Path | None = None  # in place of learner.prior
    log: LogOptions = field(default_factory=LogOptions)  # which part, if it is a flight log


@dataclass
class FlightResult:
    """``errors``: a list by (method, length), one entry per outage; ``growth``: errors (outages, seconds) by method."""

    bag: str
    delay: float
    window: tuple[float, float]
    errors: dict[tuple[str, float], list[OutageErrors]] = field(default_factory=dict)
    growth: dict[str, np.ndarray] = field(default_factory=dict)
    path: np.ndarray = field(default_factory=lambda: np.empty((0, 2)))  # reference, East and North, m
    starts: np.ndarray = field(default_factory=lambda: np.empty((0, 2)))  # where the outages begin
    notices: list[str] = field(default_factory=list)
    proof: int = 0  # number of GNSS samples that were checked before estimators in outages
    lag_one: list[tuple[float, float]] = field(default_factory=list)  # of the innovations, as ``white`` has it

    @property
    def white(self) -> tuple[float, float]:
        """Lag-one autocorrelation of the GNSS innovations, position and velocity: median over the starts.

        Below 0.2 they count as white. NaN without innovations.
        """
        known = np.array([pair for pair in self.lag_one if np.isfinite(pair).all()]).reshape(-1, 2)
        position, velocity = np.median(known, axis=0) if len(known) else (np.nan, np.nan)
        return float(position), float(velocity)


@dataclass(frozen=True)
class Entrant:
    """A method that takes part: its parameters, the names of its errors, and the result that stores them.

    The first of ``names`` is that of the estimator; the others are predictors.
    """

    parameters: Parameters
    names: tuple[str, ...]
    result: FlightResult


def run_task(task: Task, advanced: Callable[[float], None] | None = None) -> FlightResult:
    """Run one pass. ``advanced`` receives the fraction completed since the last call."""
    return run_flight((task,), advanced)[0]


def run_flight(tasks: Sequence[Task], advanced: Callable[[float], None] | None = None) -> list[FlightResult]:
    """Run passes that differ only in their methods, with a common recording, latency and aided flight.

    ``advanced`` as in ``run_task``, with the fraction of one pass.
    """
    task = tasks[0]
    parameters = load_parameters(task.config)
    recording = open_recording(task.bag, task.log, parameters=parameters)
    window = flight_window(recording)
    planned = outage_starts(window, list(task.lengths), task.every, task.first, task.last)
    starts = sorted({outage.start for outages in planned.values() for outage in outages})
    until = min(starts, default=np.inf)
    recording = prepared(recording, parameters, until)
    parameters, how = latency.choose(recording, parameters, task.gnss_delay, task.config, until, search=True)
    notices = [how, *recording.notices]
    entrants = [
        Entrant(
            methods.apply(parameters, one.method, one.airframe, one.prior),
            (one.method, *one.predictors),
            FlightResult(one.bag.name, parameters.gnss.delay, window, notices=list(notices)),
        )
        for one in tasks
    ]
    run_entrants(recording, planned, entrants, advanced)
    for entrant in entrants:
        _draw(entrant.result, recording.reference(parameters.gnss.delay), starts)
    return [entrant.result for entrant in entrants]


def run_outages(
    recording: Recording,
    parameters: Parameters,
    planned: dict[float, list[Outage]],
    names: tuple[str, ...],
    result: FlightResult,
) -> None:
    """Run the ``planned`` outages, by length, of one recording for one method, and store them in ``result``."""
    run_entrants(recording, planned, [Entrant(parameters, names, result)])


def run_entrants(
    recording: Recording,
    planned: dict[float, list[Outage]],
    entrants: Sequence[Entrant],
    advanced: Callable[[float], None] | None = None,
) -> None:
    """Run the ``planned`` outages of one recording, and store them in the results of ``entrants``."""
    starts = sorted({outage.start for outages in planned.values() for outage in outages})
    runs = [Outage(s, max(n for n, outages in planned.items() if any(o.start == s for o in outages))) for s in starts]
    trials = [_Trial(recording, planned, entrant) for entrant in entrants]
    while trials:
        for start in aided_pass(recording, [trial.entrant.parameters for trial in trials], runs):
            for trial, snapshot in zip(trials, start.snapshots, strict=False):  # without those that have parted
                if start.outage.start > trial.done_to:
                    trial.run(start, snapshot)
                    if advanced is not None:
                        advanced(1.0 / len(runs))
        del trials[0]
        trials = [trial for trial in trials if runs and trial.done_to < runs[-1].start]


class _Trial:
    """One entrant in the outages of one recording; ``done_to`` is the start [s] of the last one."""

    def __init__(self, recording: Recording, planned: dict[float, list[Outage]], entrant: Entrant) -> None:
        self.entrant, self._recording, self.done_to = entrant, recording, -np.inf
        parameters = entrant.parameters
        self._engine = PoseEstimator(parameters, attitude=False)
        reference = recording.reference(parameters.gnss.delay)
        fix_times = recording.fix_times(parameters.gnss.delay)
        self._file = _judge(planned, fix_times, reference, reference_lever(reference, parameters), entrant.result)

    def run(self, start: Start, snapshot: Snapshot) -> None:
        """Run one outage from its ``start``."""
        self.done_to = start.outage.start
        self.entrant.result.lag_one.append(start.lag_one)
        own, *predictors = self.entrant.names
        track = _outage_run(self._engine, self._recording, self.entrant, start, snapshot)
        self._file(own, start, track)
        for name in predictors:
            self._file(name, start, _predict(name, start))


def _outage_run(
    engine: PoseEstimator, recording: Recording, entrant: Entrant, start: Start, snapshot: Snapshot
) -> Track:
    """Track of the estimator from ``start`` on without GNSS, until ``MARGIN`` after the end of the outage."""
    engine.restore(snapshot)
    delay = entrant.parameters.gnss.delay
    without = [Outage(start.outage.start, start.outage.length + MARGIN)]
    removal = GnssRemoval(without, recording.epoch_ns, delay)
    proof = OutageProof([start.outage], recording.epoch_ns, delay)
    tracks = TrackRecorder(recording.epoch_ns)
    if start.state is not None:
        # the state at the loss of GNSS, so that there are estimates on both sides of the first fixes
        stamp = recording.epoch_ns + round(start.outage.start * 1e9) - 1
        tracks.add(NavBlock(np.array([stamp]), start.state[None, :], Mode.AIDED, 0, np.zeros(3)))
    end_ns = recording.epoch_ns + round((without[0].end) * 1e9)
    ahead = Batch()

    def fly() -> None:
        for output in engine.feed_all(ahead.take()):
            if isinstance(output, NavBlock):
                tracks.add(output)

    samples = recording.held
    for i in range(start.index, len(samples)):
        sample = part_of(samples[i], start.row if i == start.index else 0, None)
        if not removal.keep(sample):
            continue
        proof.check(sample)
        if ahead.add(sample):
            fly()
        if isinstance(sample, ImuBlock) and sample.stamps_ns[-1] >= end_ns:
            break
    fly()
    entrant.result.proof += proof.seen
    return tracks.track()


def _predict(name: str, start: Start) -> Track:
    """Track of the extrapolation ``name`` from the state at the loss of GNSS, without a sigma."""
    if start.state is None:
        return Track(np.empty(0), np.empty((0, OUT_COLUMNS)))
    t = np.array([0.0, start.outage.length + MARGIN])
    rows = np.full((2, OUT_COLUMNS), np.nan)
    rows[:, OUT_QUAT : OUT_QUAT + 4] = start.state[OUT_QUAT : OUT_QUAT + 4]
    velocity = extrapolations()[name].velocity(start.state[OUT_VEL : OUT_VEL + 3])
    rows[:, OUT_POS : OUT_POS + 3] = shift(start.state[OUT_POS : OUT_POS + 3], t[:, None] * velocity)
    return Track(start.outage.start + t, rows)


def _judge(
    planned: dict[float, list[Outage]],
    fix_times: np.ndarray,
    reference: Reference,
    lever: np.ndarray,
    out: FlightResult,
) -> Callable[[str, Start, Track], None]:
    """Create a function that stores the errors of one run at every length."""
    lengths_at: dict[float, list[Outage]] = {}
    for outages in planned.values():
        for outage in outages:
            lengths_at.setdefault(outage.start, []).append(outage)
    grid = np.arange(0.0, max(planned, default=0.0) + GRID / 2, GRID)

    def file(method: str, start: Start, track: Track) -> None:
        for outage in lengths_at[start.outage.start]:
            if start.doubt:
                errors = OutageErrors(outage.start, outage.length, status=NOT_AIDED, why=start.doubt)
            else:
                errors = judge(outage, fix_times, reference, track, lever)
            out.errors.setdefault((method, outage.length), []).append(errors)
            if outage.length == start.outage.length:
                curve = _curve(errors, grid)
                before = out.growth.get(method, np.empty((0, len(grid))))
                out.growth[method] = np.vstack([before, curve])

    return file


def _curve(errors: OutageErrors, grid: np.ndarray) -> np.ndarray:
    if len(errors.after) < 2:
        return np.full(len(grid), np.nan)
    return np.interp(grid, errors.after, errors.growth, left=np.nan, right=np.nan)


def _draw(result: FlightResult, reference: Reference, starts: list[float]) -> None:
    """Store the path of the flight for the report's map."""
    inside = (reference.t >= result.window[0]) & (reference.t <= result.window[1])
    if not inside.any():
        return
    step = max(int(inside.sum()) // 2000, 1)
    origin = reference.position[inside][0]
    result.path = displacement_enu(reference.position[inside][::step], origin)[:, :2]
    result.starts = displacement_enu(reference.at(np.array(starts)), origin)[:, :2]
