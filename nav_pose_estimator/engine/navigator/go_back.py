"""Undoing of wrong GNSS velocities, and of a stuck receiver: the last seconds are computed again without them.

It takes seconds to establish that measurements are wrong, and meanwhile they have changed heading, tilt and biases. To
enlarge the covariance would be consistent, but the solution would be useless. So an older copy of the run (``past``)
processes the same data again, with the present knowledge of the velocities.
"""

from __future__ import annotations

import math

import numpy as np

from nav_pose_estimator.core.earth.ellipsoid import step_enu
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.numerics.deep_copy import deep_copy
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.navigator import intake, stretch
from nav_pose_estimator.engine.navigator.filter_run import FilterRun
from nav_pose_estimator.engine.solutions import Level

UNDONE = "gnss.velocity.undone"
"""Event: the navigator continues from another state, and quantities learned with the old one are void."""

_LONGEST_GAP = 1.0  # s: longest gap between IMU rows that are processed again


def go_back(run: FilterRun, stamp_ns: int) -> FilterRun:
    """The run to continue with after velocities have turned out to be wrong; ``run`` itself if there is no other."""
    twin = _again(run)
    if twin is None:
        return run
    was_running = run.timeline.running
    twin = twin.copy(run.journal)
    twin.gnss.reception.velocities, twin.past = run.gnss.reception.velocities, run.past
    twin.gnss.reception.velocity_scatter = run.gnss.reception.velocity_scatter
    if was_running:
        run.timeline.settle()
        twin.timeline.settle()
        step = step_enu(run.timeline.filter.nav[at.LAT : at.VEL], twin.timeline.filter.nav[at.LAT : at.VEL])
        twin.timeline.shift = run.timeline.shift + step
        twin.gnss.position.resets = run.gnss.position.resets + 1
    text = "the effect of wrong measurements is undone: the last seconds were computed again"
    run.journal.say(stamp_ns, UNDONE, Level.WARN, text)
    mode, now = run.modes.mode.value, twin.modes.mode.value
    if mode != now:
        run.journal.say(stamp_ns, f"mode.{now.lower()}", Level.INFO, f"{mode} -> {now}")
    return twin


def _again(run: FilterRun) -> FilterRun | None:
    """``run`` as it would be with the present knowledge of its velocities from the start; None if it would not run."""
    start, journal = run.past.start, Journal()
    if start is None:
        return None
    rows, others = run.past.since(run)
    if np.diff(rows[:, at.IMU_T]).max(initial=0.0) > _LONGEST_GAP:
        return None
    twin = start.copy(journal)
    twin.origin, twin.origin_is_fixed = run.origin, run.origin_is_fixed
    now_known = run.gnss.reception
    twin.gnss.reception.velocities = now_known.velocities.in_hindsight(journal)
    twin.gnss.reception.repeats.in_hindsight(now_known.repeats)
    twin.gnss.reception.velocity_scatter = deep_copy(now_known.velocity_scatter, {id(run.journal): journal})
    twin.imu_physics.motion.body = deep_copy(run.imu_physics.motion.body, {})
    for now, sample in others:
        rows = _carry(twin, rows, now)
        if twin.failure:
            return None
        intake.take(twin, sample)
    _carry(twin, rows, math.inf)
    return None if twin.failure or twin.timeline.running < run.timeline.running else twin


def _carry(run: FilterRun, rows: np.ndarray, until: float) -> np.ndarray:
    """Propagate ``run`` over the IMU ``rows`` (N, 7) up to ``until`` [s]; returns the remaining rows."""
    count = int(np.searchsorted(rows[:, at.IMU_T], until, side="right"))
    if count:
        stamps_ns = np.array([run.clock.stamp(t) for t in rows[:count, at.IMU_T].tolist()])
        stretch.carry(run, stamps_ns, rows[:count])
    return rows[count:]
