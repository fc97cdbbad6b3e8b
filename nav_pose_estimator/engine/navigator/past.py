"""Recent past of a run: copies of it every 15 s, and everything that has arrived since the oldest of them.

``go_back`` computes the last half minute again from it.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.numerics.deep_copy import shallow_copy
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.samples import GnssFix, GnssVelocity, Sample

if TYPE_CHECKING:
    from nav_pose_estimator.engine.navigator.filter_run import FilterRun

_APART = 15.0  # s between two copies
_LONGEST = 60.0  # s: errors that are not established within this time are not undone


class _Start(NamedTuple):
    """A copy of the run at ``t`` [s], with the lengths of the two records at that time."""

    t: float
    run: FilterRun
    others: int
    seconds: int


class Past:
    """Copies and records of a run from the first fix or GNSS velocity on. Its content is never written to."""

    def __init__(self) -> None:
        self._starts: list[_Start] = []
        self._others: list[tuple[float, Sample]] = []  # samples other than IMU, each with the time of the last IMU row
        self._seconds: list[np.ndarray] = []  # blocks of IMU rows (N, 7)
        self._until = -math.inf  # s: time of the last of them
        self._has_gnss = False  # whether a fix or GNSS velocity has come since the last copy

    def __deepcopy__(self, _memo: dict) -> Past:
        """A copy with its own lists of the same items, which are never written to."""
        twin = shallow_copy(self)
        twin._starts, twin._others, twin._seconds = list(self._starts), list(self._others), list(self._seconds)
        return twin

    def __reduce__(self) -> tuple[type[Past], tuple[()]]:
        """Pickled as empty: a process that runs rehearsals does not need the past."""
        return Past, ()

    def record(self, run: FilterRun, sample: Sample) -> None:
        """Record a ``sample`` other than IMU before it is processed."""
        if type(sample) in (GnssFix, GnssVelocity):
            if not self._starts:
                self._keep(run)
            self._has_gnss = True
        if self._starts:
            self._others.append((run.now, sample))

    def second(self, run: FilterRun) -> None:
        """Record the IMU rows of the last second, and from time to time a copy of ``run``."""
        if not self._starts:
            return
        self._keep_rows(run)
        age = run.now - self._starts[-1].t
        if not self._has_gnss:  # nothing has come that could be wrong
            if age > _LONGEST:
                self.forget()
            return
        if run.now - self._starts[0].t > _LONGEST:
            self.forget()
            self._keep(run)
        elif age > _APART and run.gnss.reception.velocities.sound_steps:
            self._keep(run)
            self._drop_first()

    @property
    def start(self) -> FilterRun | None:
        """The oldest copy of the run, read only; None without one."""
        return self._starts[0].run if self._starts else None

    def since(self, run: FilterRun) -> tuple[np.ndarray, list[tuple[float, Sample]]]:
        """Input of ``run`` since ``start``: IMU rows (N, 7), and other samples with the time [s] of the row before."""
        self._keep_rows(run)
        first = self._starts[0]
        return np.concatenate(self._seconds[first.seconds :]), self._others[first.others :]

    def forget(self) -> None:
        """Drop everything."""
        self._starts, self._others, self._seconds = [], [], []

    def _keep_rows(self, run: FilterRun) -> None:
        rows = run.timeline.rows_since(self._until)
        if len(rows):
            self._seconds.append(rows.copy())
            self._until = float(rows[-1, at.IMU_T])

    def _keep(self, run: FilterRun) -> None:
        self._keep_rows(run)
        # ``go_back`` gives the copy the present knowledge of velocities in place of these
        twin = run.copy(Journal(), shared=(run.gnss.reception.velocities, run.imu_physics.motion.body))
        twin.past = Past()
        self._has_gnss = False
        self._starts.append(_Start(run.now, twin, len(self._others), len(self._seconds)))

    def _drop_first(self) -> None:
        if len(self._starts) < 3:
            return
        _, second, *later = self._starts
        del self._others[: second.others], self._seconds[: second.seconds]
        self._starts = [
            one._replace(others=one.others - second.others, seconds=one.seconds - second.seconds)
            for one in (second, *later)
        ]
