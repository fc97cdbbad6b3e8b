"""Second by second: could the IMU rows have been an IMU's, and what follows for the filter that they carry?"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.engine.imu import physics
from nav_pose_estimator.engine.imu.doubt import Doubt
from nav_pose_estimator.engine.navigator.modes import DENIED

if TYPE_CHECKING:
    from nav_pose_estimator.engine.navigator.filter_run import FilterRun


def look(run: FilterRun, t: float) -> None:
    """Ahead of the IMU row at ``t``, the first one of a second: judge the second before.

    An IMU that proves to be none spoils attitude and biases for good: the filter starts again and waits. Without GNSS
    that would be the end of the solution; it goes on as EXPIRED, with growing variances, until GNSS is back.
    """
    end = math.floor(t / physics.SECOND) * physics.SECOND
    run.look_due = end + physics.SECOND
    rows, running = run.timeline.rows_since(end - physics.REACH), run.timeline.running
    doubt = run.imu_physics.look(end, rows, running, run.journal, run.clock.stamp(t))
    refusal = run.imu_physics.refusal
    if not running:
        if refusal:
            run.aligner = run.aligner.afresh(run.parameters)
    elif run.modes.mode not in DENIED or t - run.aiding.fix_offered < run.aiding.lost_after:
        run.imu_despair = refusal
    else:
        _doubt_unaided(run, doubt, refusal)


def despair(run: FilterRun) -> str:
    """Why the filter should start again; empty where it need not."""
    return run.gnss.position.despair or run.imu_despair


def _doubt_unaided(run: FilterRun, doubt: Doubt | None, refusal: str) -> None:
    """Without GNSS, what is known of the IMU makes the solution less certain, or worthless."""
    whole = run.timeline.filter
    stamp_ns = run.clock.stamp(whole.time)
    if doubt is not None:
        run.observe(run.imu_doubt.observe(doubt, whole.time, stamp_ns))
    reason = refusal or _too_fast(whole.nav, run.parameters.gnss.reacquisition.max_speed)
    run.modes.distrust(reason, run.journal, stamp_ns)


def _too_fast(nav: np.ndarray, fastest: float) -> str:
    """One sentence where the navigator's own speed is above ``fastest`` [m/s], else empty."""
    speed = math.hypot(nav[at.VEL], nav[at.VEL + 1])
    if speed <= fastest:
        return ""
    return f"The navigator's own speed is {speed:.0f} m/s, which the vehicle cannot fly: it has lost its way."
