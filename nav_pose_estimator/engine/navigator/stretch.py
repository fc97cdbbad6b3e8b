"""IMU rows through the filter, cut where the mode may change: one block of solutions for each stretch."""

from __future__ import annotations

import math

import numpy as np

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.engine.navigator import heading_trial
from nav_pose_estimator.engine.navigator.filter_run import FilterRun
from nav_pose_estimator.engine.navigator.look_back import look_back
from nav_pose_estimator.engine.solutions import Mode, NavBlock


def carry(run: FilterRun, stamps_ns: np.ndarray, rows: np.ndarray) -> list[NavBlock]:
    """Carry the filter, or its alignment, over IMU ``rows`` (N, 7) stamped ``stamps_ns`` (N,).

    Where the filter despairs the rows that follow are left to the next one.
    """
    if rows[-1, at.IMU_T] < run.quiet_until:
        return _blocks(run, stamps_ns, run.timeline.advance(rows))
    blocks: list[NavBlock] = []
    while len(rows):
        if not run.timeline.running:
            if rows[0, at.IMU_T] >= run.second_due:
                look_back(run, float(rows[0, at.IMU_T]))
            run.align(rows[:1])
            done = 1
        else:
            ahead = _in_one_mode(run, stamps_ns, rows)
            done = sum(len(block.stamps_ns) for block in ahead)
            blocks += ahead
        stamps_ns, rows = stamps_ns[done:], rows[done:]
        if run.despair:
            break
    return blocks


def _in_one_mode(run: FilterRun, stamps_ns: np.ndarray, rows: np.ndarray) -> list[NavBlock]:
    """As many rows as the mode stays the same for: up to a deadline or to an observation that may change it."""
    # what late observations move is a correction of the map, not motion of the vehicle
    run.timeline.settle()
    times = rows[:, at.IMU_T]
    now = float(times[0])
    if run.modes.mode is Mode.AIDED and not now - run.aiding.fix_used < run.aiding.lost_after:
        run.timeline.observe(run.gnss.loss_at(now, run.clock.stamp(now)))
    if now >= run.second_due:
        look_back(run, now)
    limit = min(run.modes.deadline(now, run.aiding), run.timeline.next_observation(quiet=False), run.second_due)
    count = len(times) if times[-1] < limit else max(int(np.searchsorted(times, limit)), 1)
    if run.modes.at(now, run.aiding) is not run.modes.mode or run.despair:
        count = 1  # the change has the time of its row, whatever the size of the blocks
    out = run.timeline.advance(rows[:count])
    if run.trial is not None:
        heading_trial.carry(run, run.trial, rows[:count], out)
    now = float(times[count - 1])
    run.update_mode(now)
    quiet = min(run.modes.deadline(now, run.aiding), run.timeline.next_observation(), run.second_due)
    run.quiet_until = quiet if run.trial is None else -math.inf
    return _blocks(run, stamps_ns[:count], out)


def _blocks(run: FilterRun, stamps_ns: np.ndarray, out: np.ndarray) -> list[NavBlock]:
    """The rows of the last ``advance``, one block for each stretch of constant correction."""
    timeline, mode, resets = run.timeline, run.modes.mode, run.gnss.position.resets
    blocks: list[NavBlock] = []
    done = 0
    for end, correction in [*timeline.moves, (len(out), timeline.shift)]:
        if end > done:
            blocks.append(NavBlock(stamps_ns[done:end], out[done:end], mode, resets, correction))
            done = end
    return blocks
