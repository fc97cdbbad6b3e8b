"""The filter on its time line: IMU rows carry it on, observations act at their own time of validity, however late.

The time line keeps the last second or so of IMU rows, observations and checkpoints of the filter. An observation from
the past restores the last checkpoint before it and replays what came after. Because every observation splits the IMU
interval at its own time, a late or out-of-order observation leads to the same numbers as a punctual one.
"""

from __future__ import annotations

import bisect
import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from nav_pose_estimator.core import layout as at
from nav_pose_estimator.core.earth import lla_to_enu_point, radii
from nav_pose_estimator.core.layout import ALT, IMU_COLUMNS, IMU_T, LAT, OUT_COLUMNS, POINT_SAMPLED, TIME, VEL
from nav_pose_estimator.core.strapdown import flush_covariance, run_imu
from nav_pose_estimator.engine.branches import Branches
from nav_pose_estimator.engine.solutions import NavBlock, NavSolution

MOTION = "motion"
"""Kind of the observation that splits the filter into branches and weighs them; its argument is a MotionEvidence."""


@dataclass(slots=True)
class Observation:
    """One observation at its time of validity ``t`` [s]. ``apply`` of the engine knows what to do with ``kind``.

    Observations of equal time act in the order of ``priority``, then of arrival. ``memory`` keeps what was decided when
    it first acted (used or not, and why), so that a replay does not count or decide twice.
    """

    t: float
    kind: str
    arguments: tuple
    priority: int = 5
    arrival: int = 0
    memory: dict = field(default_factory=dict)

    @property
    def key(self) -> tuple[float, int, int]:
        return (self.t, self.priority, self.arrival)


@dataclass(slots=True)
class _Checkpoint:
    t: float
    nav: np.ndarray
    P: np.ndarray
    branches: Branches | None = None


Apply = Callable[[Observation, np.ndarray, np.ndarray], None]


class Timeline:
    """Nominal state ``nav`` and covariance ``P`` at the last IMU row, with a memory of ``window`` seconds."""

    def __init__(
        self,
        constants: np.ndarray,
        apply: Apply,
        window: float,
        whole: frozenset[str] = frozenset(),
        checkpoint_period: float = 0.2,
    ) -> None:
        """``whole``: kinds of observation that act on the filter as a whole, not on each branch; they end branches."""
        self.constants = constants
        self._apply = apply
        self._whole = whole
        self._window = window
        self._period = checkpoint_period
        self.nav = np.empty(0)
        self.P = np.empty((0, 0))
        self.branches: Branches | None = None  # the filter's hypotheses in an outage; ``nav``, ``P`` are their mixture
        self._rows = np.empty((0, IMU_COLUMNS))  # a buffer with room at the end; the live part is [_first:_last]
        self._first = self._last = 0
        self._checkpoints: deque[_Checkpoint] = deque()
        self._observations: list[Observation] = []  # sorted by key
        self._done = 0  # observations before this index have acted on nav
        self._dirty: float | None = None  # earliest time that must be replayed
        self._arrivals = 0
        self.replaying = False  # True while ``settle`` repeats what was done before
        self.shift = np.zeros(3)  # m, ENU: sum of what observations did to the position

    # --- start and state ---------------------------------------------------------------------------------------------

    def start(self, nav: np.ndarray, P: np.ndarray) -> None:
        """Begin at ``nav[TIME]`` with rows already known (``remember``) replayed up to the present."""
        self.nav = nav.copy()
        self.P = P.copy()
        self.branches = None
        self._checkpoints.clear()
        self._checkpoints.append(_Checkpoint(float(nav[TIME]), self.nav.copy(), self.P.copy()))
        self._observations = [o for o in self._observations if o.t > nav[TIME]]
        self._done = 0
        self._dirty = None
        rows = self._live()
        todo = rows[rows[:, IMU_T] > nav[TIME]]
        if len(todo):
            self._run(todo, np.empty((len(todo), OUT_COLUMNS)))

    def remember(self, rows: np.ndarray) -> None:
        """Keep IMU ``rows`` (N, 7) without a running filter, so that an alignment in the past can catch up."""
        self._append(rows)

    @property
    def running(self) -> bool:
        return self.nav.size > 0

    @property
    def time(self) -> float:
        return float(self.nav[TIME])

    def copy(self, apply: Apply) -> Timeline:
        """An independent copy that applies observations through ``apply``."""
        twin = Timeline(self.constants.copy(), apply, self._window, self._whole, self._period)
        twin.shift = self.shift.copy()
        twin.nav, twin.P = self.nav.copy(), self.P.copy()
        twin.branches = self.branches and self.branches.copy()
        twin._rows = self._rows[self._first : self._last].copy()
        twin._last = len(twin._rows)
        twin._checkpoints = deque(self._checkpoints)  # checkpoints are never written to
        twin._observations = [
            Observation(o.t, o.kind, o.arguments, o.priority, o.arrival, dict(o.memory)) for o in self._observations
        ]
        twin._done, twin._dirty, twin._arrivals = self._done, self._dirty, self._arrivals
        return twin

    @property
    def is_settled(self) -> bool:
        """False while an observation from the past waits to act."""
        return self._dirty is None

    def next_observation(self) -> float:
        """Time of the earliest observation that waits for the future, inf without one."""
        return self._observations[self._done].t if self._done < len(self._observations) else np.inf

    # --- input -------------------------------------------------------------------------------------------------------

    def observe(self, t: float, kind: str, arguments: tuple, priority: int = 5) -> bool:
        """Insert an observation valid at ``t``. False when it is older than the memory: then nothing happens."""
        if self.running and t <= self._checkpoints[0].t:
            return False
        self._arrivals += 1
        observation = Observation(t, kind, arguments, priority, self._arrivals)
        index = bisect.bisect(self._observations, observation.key, key=lambda o: o.key)
        self._observations.insert(index, observation)
        if self.running and t <= self.time:
            self._dirty = t if self._dirty is None else min(self._dirty, t)
        return True

    def advance(self, rows: np.ndarray) -> np.ndarray:
        """Carry the filter over IMU ``rows`` (N, 7), later than ``time``; returns output rows (N, OUT_COLUMNS)."""
        self.settle()
        self._append(rows)
        out = np.empty((len(rows), OUT_COLUMNS))
        self._run(rows, out)
        self._forget()
        return out

    def settle(self) -> None:
        """Replay from the earliest observation that has not acted yet. ``nav`` and ``P`` are then up to date."""
        if self._dirty is None:
            return
        now, dirty = self.time, self._dirty
        before = self.nav[LAT:VEL].copy()
        self._dirty = None
        while len(self._checkpoints) > 1 and self._checkpoints[-1].t >= dirty:
            self._checkpoints.pop()
        start = self._checkpoints[-1]
        self.nav[:] = start.nav
        self.P[:] = start.P
        self.branches = start.branches and start.branches.copy()
        self._done = bisect.bisect_right(self._observations, start.t, key=lambda o: o.t)
        rows = self._live()
        begin, end = np.searchsorted(rows[:, IMU_T], (start.t, now), side="right")
        self.replaying = True
        self._run(rows[begin:end], np.empty((end - begin, OUT_COLUMNS)))
        self.replaying = False
        self.shift += step_enu(before, self.nav)

    # --- inside ------------------------------------------------------------------------------------------------------

    def _run(self, rows: np.ndarray, out: np.ndarray) -> None:
        """Process consecutive rows with the observations that fall into them."""
        times = rows[:, IMU_T]
        at, count = 0, len(rows)
        while at < count:
            due = self.next_observation()
            mark = self._checkpoints[-1].t + self._period
            # rows that end before the observation, at most one past the checkpoint mark
            stop = min(int(np.searchsorted(times, due)), int(np.searchsorted(times, mark)) + 1, count)
            if stop > at:
                self._carry(rows[at:stop], out[at:stop])
                at = stop
            elif due <= times[at]:
                self._split(rows[at], due)
                if due == times[at]:
                    self._carry(rows[at : at + 1], out[at : at + 1])
                    at += 1
            if at and self.nav[TIME] == times[at - 1] and times[at - 1] >= mark:
                self._checkpoints.append(
                    _Checkpoint(self.time, self.nav.copy(), self.P.copy(), self.branches and self.branches.copy())
                )

    def _carry(self, rows: np.ndarray, out: np.ndarray) -> None:
        """Propagate over consecutive ``rows``, along every branch where there are any."""
        if self.branches is None:
            run_imu(self.nav, self.P, self.constants, rows, out)
        else:
            self.branches.run(rows, out)
            self.mix()

    def mix(self) -> None:
        """Make ``nav`` and ``P`` the mixture of the branches, as they stand."""
        if self.branches is not None:
            self.nav[:], self.P[:] = self.branches.merged()

    def _act(self, observation: Observation) -> None:
        """Let one observation act on the filter, which stands at its time with its covariance up to date."""
        before = self.nav[LAT:VEL].copy()
        if observation.kind == MOTION:
            (evidence,) = observation.arguments
            if self.branches is None:
                self.branches = Branches(self.nav, self.P, self.constants, evidence)
            self.branches.decide(evidence)
            self.mix()
        elif self.branches is None or observation.kind in self._whole:
            was = self.nav.copy()
            self._apply(observation, self.nav, self.P)
            if not np.array_equal(was, self.nav):
                self.branches = None  # an absolute position decides what no hypothesis could
        else:
            for nav, P in zip(self.branches.navs, self.branches.Ps, strict=True):
                self._apply(observation, nav, P)
            self.mix()
        if not self.replaying:
            self.shift += step_enu(before, self.nav)

    def _split(self, row: np.ndarray, due: float) -> None:
        """Carry the filter into the interval of ``row`` up to ``due`` and let every observation of that time act."""
        if due > self.time:
            part = row.copy()
            part[IMU_T] = due
            if self.constants[POINT_SAMPLED]:
                self._interpolate(part, row, due)
            self._carry(part[np.newaxis], np.empty((1, OUT_COLUMNS)))
        if self.branches is None:
            flush_covariance(self.nav, self.P, self.constants)
        else:
            self.branches.flush()
            self.mix()
        while self._done < len(self._observations) and self._observations[self._done].t <= due:
            self._act(self._observations[self._done])
            self._done += 1

    def _interpolate(self, part: np.ndarray, row: np.ndarray, due: float) -> None:
        live = self._live()
        before = live[max(int(np.searchsorted(live[:, IMU_T], row[IMU_T])) - 1, 0)]
        span = row[IMU_T] - before[IMU_T]
        if span > 0.0:
            share = (due - before[IMU_T]) / span
            part[1:] = before[1:] + share * (row[1:] - before[1:])

    def _live(self) -> np.ndarray:
        return self._rows[self._first : self._last]

    def _append(self, rows: np.ndarray) -> None:
        need = len(rows)
        if self._last + need > len(self._rows):
            live = self._live()
            room = np.empty((2 * (len(live) + need) + 256, IMU_COLUMNS))
            room[: len(live)] = live
            self._rows, self._first, self._last = room, 0, len(live)
        self._rows[self._last : self._last + need] = rows
        self._last += need
        if not self.running:
            self._drop_rows_before(rows[-1, IMU_T] - self._window)

    def _forget(self) -> None:
        horizon = self.time - self._window
        while len(self._checkpoints) > 1 and self._checkpoints[1].t <= horizon:
            self._checkpoints.popleft()
        oldest = self._checkpoints[0].t
        drop = bisect.bisect_right(self._observations, oldest, key=lambda o: o.t)
        del self._observations[:drop]
        self._done -= drop
        self._drop_rows_before(oldest)

    def _drop_rows_before(self, t: float) -> None:
        # the row at or before t stays: point-sampled data interpolate from it
        self._first += max(int(np.searchsorted(self._live()[:, IMU_T], t)) - 1, 0)


def step_enu(before: np.ndarray, nav: np.ndarray) -> np.ndarray:
    """A correction of the position (3,) [m, ENU], which is small against the Earth."""
    r_m, r_n = radii(nav[LAT])
    d_lat, d_lon, d_alt = (nav[LAT:VEL] - before).tolist()
    return np.array([d_lon * (r_n + nav[ALT]) * math.cos(nav[LAT]), d_lat * (r_m + nav[ALT]), d_alt])


def single_solution(block: NavBlock, timeline: Timeline, origin: tuple[float, float, float]) -> NavSolution:
    """The solution of a block of one sample, at which ``timeline`` stands, with its covariance and biases."""
    row, nav = block.rows[0], timeline.nav
    lat, lon, alt = row[at.OUT_POS : at.OUT_VEL].tolist()
    return NavSolution(
        stamp_ns=int(block.stamps_ns[0]),
        mode=block.mode,
        lat=lat,
        lon=lon,
        alt=alt,
        vel_n=row[at.OUT_VEL : at.OUT_QUAT],
        q_nb=row[at.OUT_QUAT : at.OUT_RATE],
        rate_b=row[at.OUT_RATE : at.OUT_FORCE],
        force_b=row[at.OUT_FORCE : at.OUT_VAR],
        gyro_bias=nav[at.GYRO_BIAS : at.ACCEL_BIAS].copy(),
        accel_bias=nav[at.ACCEL_BIAS : at.WIND].copy(),
        cov=timeline.P[: at.BASE_STATES, : at.BASE_STATES].copy(),
        position_enu=lla_to_enu_point(lat, lon, alt, *origin),
        correction_enu=block.correction_enu,
        reset_count=block.reset_count,
    )
