"""Propagation of the filter over IMU rows, in stretches of constant mode: one block of solutions for each.

While GNSS aids the filter and everything is as expected, many rows and the observations between them are processed by
one call of compiled code (``core.routine``).
"""

from __future__ import annotations

import bisect
import itertools
import math
import operator
from dataclasses import replace

import numpy as np

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.filter.blocks import DVL
from nav_pose_estimator.core.gnss.doubt import HOPELESS
from nav_pose_estimator.core.numerics.imu_checks import first_from
from nav_pose_estimator.core.routine import table
from nav_pose_estimator.engine.engine_clock import NS
from nav_pose_estimator.engine.navigator import heading_trial
from nav_pose_estimator.engine.navigator.filter_run import FilterRun
from nav_pose_estimator.engine.navigator.look_back import look_back
from nav_pose_estimator.engine.observation import Observation
from nav_pose_estimator.engine.samples import (
    BeamVelocitySample,
    GnssFix,
    GnssVelocity,
    ImuBlock,
    MagSample,
    PressureSample,
    Sample,
    SatelliteCount,
)
from nav_pose_estimator.engine.solutions import Mode, NavBlock, Output

Periods = list[tuple[int, float]]
"""Numbers of rows, and the time between fixes [s] from each of them on; the first one is not behind row 0."""
_WAIT = frozenset((GnssVelocity, MagSample, PressureSample, SatelliteCount))
_AHEAD = 1.0  # s: an observation further ahead is refused
_FIRST = operator.itemgetter(0)
_ORDER, _ARRIVAL = operator.attrgetter("t", "kind.precedence", "arrival"), operator.attrgetter("arrival")


def carry(run: FilterRun, stamps_ns: np.ndarray, rows: np.ndarray) -> list[Output]:
    """Propagate the filter, or its alignment, over IMU ``rows`` (N, 7) with stamps ``stamps_ns`` (N,) [ns].

    Returns solutions, and events ahead of those on which they bear. After a failure of the filter, the remaining rows
    are left to its successor.
    """
    if rows[-1, at.IMU_T] < run.quiet_until:
        return [*run.journal.drain(), *_blocks(run, stamps_ns, run.timeline.advance(rows))]
    outputs: list[Output] = []
    while len(rows):
        if not run.timeline.running:
            if rows[0, at.IMU_T] >= run.second_due:
                look_back(run, float(rows[0, at.IMU_T]))
            run.align(rows[:1])
            done = 1
        else:
            ahead = _in_one_mode(run, stamps_ns, rows)
            done = sum(len(block.stamps_ns) for block in ahead)
            outputs += [*run.journal.drain(), *ahead]
        stamps_ns, rows = stamps_ns[done:], rows[done:]
        if run.failure:
            break
    return outputs


def _in_one_mode(run: FilterRun, stamps_ns: np.ndarray, rows: np.ndarray) -> list[NavBlock]:
    """Process rows up to the next deadline, or up to the next observation, that may change the mode."""
    # a shift by late observations is a correction of the map frame, not motion of the vehicle
    run.timeline.settle()
    times = rows[:, at.IMU_T]
    now = float(times[0])
    # after a start without fixes there are no innovations to test the covariance
    if _is_lost(run, now) and not run.unseen:
        run.timeline.observe(run.gnss.loss_at(now, run.clock.stamp(now)))
    if now >= run.second_due:
        look_back(run, now)
    telling = run.timeline.queue.due_besides_quiet(drifts=run.modes.mode is Mode.DEAD_RECKONING)
    limit = min(run.modes.deadline(now, run.aiding), telling, run.second_due)
    count = len(times) if times[-1] < limit else max(first_from(rows, limit), 1)
    if run.modes.at(now, run.aiding) is not run.modes.mode or run.failure:
        count = 1  # the mode changes at its row, independent of the block size
    out = run.timeline.advance(rows[:count])
    if run.trial is not None:
        heading_trial.carry(run, run.trial, rows[:count], out)
    now = float(times[count - 1])
    run.update_mode(now)
    quiet = min(run.modes.deadline(now, run.aiding), run.timeline.queue.due, run.second_due)
    run.quiet_until = quiet if run.trial is None else -math.inf
    return _blocks(run, stamps_ns[:count], out)


def _is_lost(run: FilterRun, t: float) -> bool:
    """Whether the mode is AIDED and GNSS counts as lost at ``t`` [s]."""
    return run.modes.mode is Mode.AIDED and t >= run.aiding.fix_used + run.aiding.lost_after


def _blocks(run: FilterRun, stamps_ns: np.ndarray, out: np.ndarray) -> list[NavBlock]:
    """The output rows of the last ``advance``, one block for each stretch of constant map correction."""
    timeline, mode, resets = run.timeline, run.modes.mode, run.gnss.position.resets
    blocks: list[NavBlock] = []
    done = 0
    for end, correction in [*timeline.moves, (len(out), timeline.shift)]:
        if end > done:
            blocks.append(NavBlock(stamps_ns[done:end], out[done:end], mode, resets, correction))
            done = end
    return blocks


class Backlog:
    """Collects IMU rows and the observations between them, for a second at most, to process them together.

    Samples that arrive in the meantime are evaluated as if the rows had been processed. This is exact, because rows
    wait only while that evaluation does not depend on the filter: GNSS aids it, no sensor is in doubt, no fix can
    change when GNSS counts as lost, and none can make the filter fail. The rows are processed before anything else:
    another kind of sample, an event, a refusal.
    """

    def __init__(self, run: FilterRun) -> None:
        self.run = run
        self._outputs: list[Output] = []
        self._open = False
        self._waiting: list[ImuBlock] = []
        self._left = np.empty(0, np.int64), np.empty((0, at.IMU_COLUMNS))
        self._count = 0
        self._periods: Periods = []
        self._coming: list[Observation] = []
        self._some_late = False  # whether one of them is valid before the row behind which it arrived
        self._ahead: set[float] = set()  # s: times of observations that are valid after the newest row
        self._limit = -math.inf
        self.is_full = False
        """Whether the rows must be processed now: a second is complete, GNSS may be lost, or the filter may fail."""
        self._is_followed = False  # whether a row after them has arrived

    def is_open(self) -> bool:
        """Whether samples may wait, or continue to wait."""
        return self._open or self._opens()

    def _opens(self) -> bool:
        run = self.run
        routine = run.timeline.routine
        if routine is None or not _is_routine(run) or run.gnss.reception.refusal or not run.timeline.imu.last:
            return False
        if run.parameters.aids.declination_from_model or run.parameters.aids.water_density > 0.0:
            return False
        now = run.timeline.filter.time
        # samples that arrive after a failure of the filter are for its successor
        soonest = min(run.gnss.position.guard.soonest_reset, HOPELESS)
        self._limit = min(run.second_due, run.aiding.fix_used + run.aiding.lost_after, now + soonest)
        self._open = now < self._limit and routine.is_calm(now)
        if self._open:
            self._ahead = {o.t for o in run.timeline.queue.waiting()}
            run.take_observation = self._observe
            run.journal.before_next(self._fly)
        return self._open

    def look_back_before(self, block: ImuBlock) -> bool:
        """Evaluate the last second if ``block`` begins a new one; False if it must take the full path for that.

        The rows of an open backlog have to be processed first.
        """
        if self._open:
            return True
        run, t = self.run, self.run.clock.seconds(int(block.stamps_ns[0]))
        if t < run.second_due:
            return True
        if not _is_routine(run) or _is_lost(run, t):
            return False
        run.timeline.settle()
        look_back(run, t)
        return True

    def add(self, block: ImuBlock) -> ImuBlock | None:
        """Add a ``block`` that has passed the checks of the IMU's input, until the backlog ``is_full``.

        That is behind the sample at which GNSS may be lost or the filter may fail, or ahead of the first sample of a
        new second. Returns the rest of the block, None without one.
        """
        run, rest = self.run, None
        until = run.clock.seconds(int(block.stamps_ns[-1]))
        self.is_full = until >= self._limit
        period = run.gnss.reception.fix_period
        if not self._periods or self._periods[-1][1] != period:
            self._periods.append((self._count, period))
        if self.is_full:
            count = int(((block.stamps_ns - run.clock.zero_ns) * NS).searchsorted(self._limit))
            count += self._limit < run.second_due
            self._is_followed = count < len(block)
            rest = block.part(count, None) if self._is_followed else None
            if not count:
                return rest
            block = block.part(0, count)
            until = run.clock.seconds(int(block.stamps_ns[-1]))
        self._waiting.append(block)
        self._count += len(block.stamps_ns)
        run.waiting_until = until
        return rest

    def may_wait_for(self, sample: Sample) -> bool:
        """Whether a ``sample`` may be evaluated before the waiting rows have been processed."""
        kind = type(sample)
        if kind is GnssFix:
            waits = self.run.gnss.reception.is_quick
        elif kind is BeamVelocitySample:  # the first one changes the filter's states
            waits = DVL.is_in(self.run.timeline.filter.constants)
        else:
            waits = kind in _WAIT
        return waits and (self._open or self._opens())

    def flown(self) -> tuple[list[Output], np.ndarray, np.ndarray]:
        """Process the backlog; returns all new solutions and events, and stamps and rows of the last stretch."""
        self._fly()
        outputs, self._outputs = self._outputs, []
        return outputs, *self._left

    def _observe(self, o: Observation) -> bool:
        """Add an observation to the backlog. False where it cannot wait; the backlog has then been processed."""
        run, t = self.run, o.t
        now = run.now
        is_late = t < now
        if (is_late and not o.kind.holds) or t > now + _AHEAD or t in self._ahead:
            self._fly()
            return False
        if is_late:
            self._some_late = True
        elif t > now:
            self._ahead.add(t)
        run.timeline.queue.number(o)
        o.rows_ahead = self._count
        self._coming.append(o)
        return True

    def _fly(self) -> None:
        """Process the backlog."""
        run = self.run
        run.take_observation = run.waiting_until = None
        run.journal.before_next(None)
        self._open = False
        coming, self._coming = self._coming, []
        done = 0
        if self._waiting:
            coming, done = self._fly_rows(*run.clock.rows_of(self._waiting), coming)
        self._waiting, self._periods, self._is_followed, self._some_late = [], [], False, False
        run.quiet_until = -math.inf  # what has arrived since may have reset it already
        _hear(run, coming, done)

    def _fly_rows(
        self, stamps: np.ndarray, rows: np.ndarray, coming: list[Observation]
    ) -> tuple[list[Observation], int]:
        """Process IMU ``rows`` (N, 7); returns the observations that arrived behind them, and how many were flown."""
        run, self._left = self.run, (stamps, rows)
        reception, done, count, self._count = run.gnss.reception, 0, self._count, 0
        period_now = reception.fix_period
        while done < count and not run.failure:
            reception.fix_period = _period(self._periods, done)
            coming = _hear(run, coming, done)
            out, coming = self._leg(rows, coming, done)
            if len(out):
                end = done + len(out)
                self._outputs += [*run.journal.drain(), *_blocks(run, stamps[done:end], out)]
            else:
                coming = _hear(run, coming, done)
                end = coming[0].rows_ahead if coming else count
                end = min(end, done + 1) if _is_routine(run) else end
                self._outputs += carry(run, stamps[done:end], rows[done:end])
            done = end
        reception.fix_period = period_now
        return coming, done

    def _leg(self, rows: np.ndarray, coming: list[Observation], done: int) -> tuple[np.ndarray, list[Observation]]:
        """Process rows from ``done`` on as far as the routine goes; returns output rows and remaining observations."""
        run = self.run
        if run.timeline.late:
            run.timeline.settle()
        end = done + first_from(rows[done:], run.second_due)
        if end == done or not _is_routine(run):
            return rows[:0], coming

        late: list[Observation] = []
        if self._some_late:  # a late observation first replays the past
            punctual = _first_late(rows, coming)
            coming, late = coming[:punctual], coming[punctual:]
            end = min(end, late[0].rows_ahead) if late else end
        is_followed = (end < len(rows) or self._is_followed) and not (late and late[0].rows_ahead == end)
        out, left = fly(run, (rows[:end], done, is_followed), coming, self._periods)
        run.quiet_until = -math.inf
        return out, left + late


def packed(outputs: list[Output]) -> list[Output]:
    """``outputs`` with neighbouring blocks joined where they have mode, reset count and correction in common."""
    out: list[Output] = []
    for alike, group in itertools.groupby(outputs, _what_rows_share):
        some = list(group)
        blocks = [one for one in some if isinstance(one, NavBlock)] if alike is not None else []
        if len(blocks) > 1:
            stamps = np.concatenate([one.stamps_ns for one in blocks])
            some = [replace(blocks[0], stamps_ns=stamps, rows=np.concatenate([one.rows for one in blocks]))]
        out += some
    return out


def _what_rows_share(output: Output) -> tuple[Mode, int, list[float]] | None:
    if not isinstance(output, NavBlock):
        return None
    return output.mode, output.reset_count, output.correction_enu.tolist()


def is_uneventful(run: FilterRun) -> bool:
    """Whether the next samples are likely to change nothing but the state of the filter."""
    return _is_routine(run) and not run.parameters.aids.declination_from_model


def _is_routine(run: FilterRun) -> bool:
    """Whether the filter is single, aided by GNSS, and neither on trial nor failed."""
    whole = run.timeline.running and run.timeline.filter.branches is None
    return whole and run.modes.mode is Mode.AIDED and run.trial is None and not run.failure


def _first_late(rows: np.ndarray, coming: list[Observation]) -> int:
    """Index in ``coming`` of the first observation that is older than the row behind which it arrived."""
    for place, one in enumerate(coming):
        if one.t < rows[one.rows_ahead - 1, at.IMU_T]:
            return place
    return len(coming)


def _hear(run: FilterRun, coming: list[Observation], done: int) -> list[Observation]:
    """Pass the observations that have arrived when ``done`` rows are processed to the time line; returns the others."""
    heard = 0
    for one in coming:
        if one.rows_ahead > done:
            break
        run.observe(one)
        heard += 1
    return coming[heard:]


def fly(
    run: FilterRun, stretch: tuple[np.ndarray, int, bool], coming: list[Observation], periods: Periods
) -> tuple[np.ndarray, list[Observation]]:
    """``Timeline.advance`` by the compiled routine, with observations that arrive between the rows; none is late.

    ``stretch``: IMU rows (N, 7), how many of them have been processed, and whether they are followed by others that
    have arrived; ``periods`` when they did. Ends early where something is unusual. Returns output rows
    (N, OUT_COLUMNS) as far as it went, and what of ``coming`` has not been heard of by then, in order of arrival.
    """
    (rows, done, is_followed), timeline = stretch, run.timeline
    imu, queue, routine = timeline.imu, timeline.queue, timeline.routine
    assert routine is not None
    imu.append(rows[done:])
    begin = imu.last + done - len(rows)
    timeline.dirty = None
    waiting = queue.take_waiting()
    for one in waiting:
        one.rows_ahead = done
    events = sorted([*waiting, *coming], key=_ORDER)
    out = np.empty((len(rows) - done, at.OUT_COLUMNS))
    behind = [one.rows_ahead - done for one in events]
    whole, span = (timeline.filter.vector, timeline.shift), (imu.rows, begin, imu.last, is_followed)
    leg = routine.fly(whole, span, (events, behind), out)
    timeline.moves, timeline.shift = leg.moves, leg.shift
    imu.last = begin + leg.rows
    acted, rest = events[: len(leg.results)], events[len(leg.results) :]
    queue.add_acted(acted)
    for one, result in zip(acted, leg.results, strict=True):
        routine.report(one, result, _period(periods, done + result[table.RESULT_AHEAD]))
    done, last, left = done + leg.rows, imu.rows[imu.last - 1, at.IMU_T], []
    for one in rest:
        if one.rows_ahead <= done and (leg.within or one.t > last):
            queue.insert(one)
        else:
            left.append(one)
    if leg.unfinished is not None:
        before = timeline.shift
        run.gnss.reception.fix_period = _period(periods, done)
        timeline.finish(np.array(leg.unfinished[table.RESULT_BEFORE : table.RESULT_AFTER]))
        timeline.moves.append((leg.rows, before))
    timeline.tidy()
    return out[: leg.rows], sorted(left, key=_ARRIVAL)


def _period(periods: Periods, row: float) -> float:
    """Time between fixes [s] when ``row`` arrived."""
    if len(periods) == 1:
        return periods[0][1]
    return periods[bisect.bisect_right(periods, row, key=_FIRST) - 1][1]
