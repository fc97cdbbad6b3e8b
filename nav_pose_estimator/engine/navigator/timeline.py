"""The time line of the filter: IMU rows propagate it, and each observation acts at its time of validity, however late.

The time line keeps IMU rows, observations and checkpoints of the filter over its memory (about a second by default). A
late observation restores the last checkpoint before its time and replays everything since. Because every observation
splits the IMU interval at its own time, late and out-of-order observations lead to the same numbers as punctual ones.
"""

from __future__ import annotations

import itertools
import math

import numpy as np

from nav_pose_estimator.core.earth.ellipsoid import step_enu
from nav_pose_estimator.core.filter import memory
from nav_pose_estimator.core.filter.layout import IMU_T, LAT, OUT_COLUMNS, SOLUTION_SIZE, VEL
from nav_pose_estimator.engine.imu.buffer import ImuBuffer
from nav_pose_estimator.engine.navigator.split_filter import Apply, SplitFilter
from nav_pose_estimator.engine.observation import Observation
from nav_pose_estimator.engine.observation_queue import ObservationQueue
from nav_pose_estimator.engine.samples import Vector3
from nav_pose_estimator.engine.sensors.routine.routine import Routine, moved

_CHECKPOINT_PERIOD = 0.05  # s between checkpoints: a replay begins at most so much before the late observation
_TIDY_PERIOD = 0.2  # s between two removals of old rows, observations and checkpoints
_KNOWN = 1.5  # s of IMU rows that are known at any time, whatever the memory, splits and the division into blocks


class Timeline:
    """A filter, standing at the last IMU row, with a memory of ``window`` [s] into the past."""

    def __init__(self, constants: np.ndarray, apply: Apply, window: float, routine: Routine | None = None) -> None:
        """Expected observations act by the compiled ``routine``, if given, all others by ``apply``."""
        self._apply, self.routine = apply, routine
        self._window = window
        # checkpoints: as many as the window can hold, one before it, and the one being added
        self.filter = SplitFilter(constants, math.ceil(window / _CHECKPOINT_PERIOD) + 2, _CHECKPOINT_PERIOD)
        self.imu = ImuBuffer()
        self.queue = ObservationQueue()
        # earliest time of an observation that has not acted, reset by ``settle`` and by ``stretch.fly``
        self.dirty: float | None = None
        self.late = False  # whether that time lies in the past, so that the past must be replayed
        self._started = -math.inf  # s: earlier times cannot be replayed
        self._tidy_at = -math.inf  # s: when old data are dropped next
        self.running = False
        self._replaying = False  # True while ``settle`` is at work
        self.shift = np.zeros(3)  # m, ENU: sum of all corrections of the position; replaced, never written to
        # changes of ``shift`` within the last ``advance``: number of rows before the change, and ``shift`` until then
        self.moves: list[tuple[int, np.ndarray]] = []

    def start(self, nav: np.ndarray, P: np.ndarray, origin: tuple[float, float, float] | None = None) -> None:
        """Begin at ``nav[TIME]``, and replay rows already known (``remember``) up to the present.

        ``origin``: latitude, longitude [rad], height [m] of the local frame; None keeps the present one.
        """
        self.restart(self.filter.constants, nav, P, origin)

    def restart(
        self,
        constants: np.ndarray,
        nav: np.ndarray,
        P: np.ndarray,
        origin: tuple[float, float, float] | None = None,
    ) -> None:
        """``start`` with other filter ``constants``, which may define other states."""
        self.filter.start(constants, nav, P, origin)
        self.running, self._started = True, self.filter.time
        self.queue.keep_after(self.filter.time)
        self.dirty, self.late = None, False
        self._tidy_at = -math.inf
        self._run(*self.imu.between(self.filter.time, math.inf))

    def remember(self, rows: np.ndarray) -> None:
        """Keep IMU ``rows`` (N, 7) while no filter runs: an alignment at a past time is later propagated over them."""
        self.imu.append(rows)
        self.imu.drop_before(rows[-1, IMU_T] - max(self._window, _KNOWN))

    def rows_since(self, t: float) -> np.ndarray:
        """The IMU rows (N, 7) after ``t`` [s], of the last 1.5 s at least; read-only."""
        return self.imu.recent(t)

    # --- input -------------------------------------------------------------------------------------------------------

    def observe(self, observation: Observation) -> bool:
        """Insert an observation. False, without effect, when it is older than the memory."""
        t = observation.t
        if self.running:
            now = self.filter.time
            # the oldest checkpoint lies before the window, unless the filter has just been started
            certain = t > now - self._window and t > self._started
            if not certain and t <= self._forget():
                return False
        overtakes = self.queue.insert(observation)
        if self.running and t <= now:
            self.late = self.late or t < now or overtakes
            self.dirty = t if self.dirty is None else min(self.dirty, t)
        return True

    def advance(self, rows: np.ndarray) -> np.ndarray:
        """Propagate the filter over IMU ``rows`` (N, 7) after its time; returns output rows (N, OUT_COLUMNS)."""
        self.settle()
        self.imu.append(rows)
        out = np.empty((len(rows), OUT_COLUMNS))
        self._run(self.imu.last - len(rows), self.imu.last, out)
        self.tidy()
        return out

    def advance_one(self, t: float, gyro: Vector3, accel: Vector3) -> np.ndarray:
        """``advance`` by one sample ahead of which no observation is due, on a settled time line; (SOLUTION_SIZE,)."""
        whole, imu = self.filter, self.imu
        if whole.branches is not None:
            return whole.complete(self.advance(np.array([[t, *gyro, *accel]]))[0])
        if imu.last == len(imu.rows):
            imu.make_room(1)
        solution = np.empty(SOLUTION_SIZE)
        memory.run_sample(whole.vector, imu.rows, imu.last, solution, t, *gyro, *accel)
        imu.last += 1
        if t >= self._tidy_at:
            self._forget()
        return solution

    def settle(self, end: int | None = None) -> None:
        """Let all observations act that have not yet, with a replay where they are late: ``filter`` is up to date.

        ``end``: number of rows of the buffer that have been processed; by default all.
        """
        if self.dirty is None:
            return
        end = self.imu.last if end is None else end
        now, dirty, late = self.filter.time, self.dirty, self.late
        before = self.filter.nav[LAT:VEL].copy()
        self.dirty, self.late = None, False
        self._replaying = True
        if late:
            start = self.filter.restore_before(dirty)
            self.queue.rewind(start)
            begin, end = self.imu.between(start, now)
            routine = self._routine_of_next()
            if routine is not None and begin > 0:
                rows = self.imu.rows, begin, end
                done, acted = routine.fly_again(self.filter.vector, rows, self.queue.waiting())
                begin += done
                self.queue.skip(acted)
            self._run(begin, end)
        else:
            # on the present filter, after a checkpoint made now: the same numbers as if they had been known before
            self.filter.carry(self.imu.rows, end - 1, end, now, np.empty((0, OUT_COLUMNS)))
            self._observe_up_to(now)
            self.filter.renew_checkpoints()
        self._replaying = False
        self.shift = self.shift + step_enu(before, self.filter.nav[LAT:VEL])

    def finish(self, place: np.ndarray) -> None:
        """``settle`` when some observations of the present time have acted by routine, and others have not.

        ``place`` (3,): latitude, longitude [rad], height [m] before the first of them.
        """
        self._replaying = True
        self._observe_up_to(self.filter.time)
        self.filter.renew_checkpoints()
        self._replaying = False
        self.shift = self.shift + step_enu(place, self.filter.nav[LAT:VEL])

    # --- inside ------------------------------------------------------------------------------------------------------

    def _run(self, begin: int, end: int, out: np.ndarray | None = None) -> None:
        """Process rows ``begin`` to ``end`` of the buffer with the observations that are due within them."""
        out = np.empty((end - begin, OUT_COLUMNS)) if out is None else out
        first, self.moves = end - len(out), []
        while True:
            due, before, front, behind = self.queue.due, self.shift, self.queue.front, 0
            # in a replay it acts ahead of its row, with the same result
            if front is not None and front.behind and not self._replaying:
                behind = _rows_ahead_of(front, self.imu.rows[begin:end, IMU_T])
            if behind:
                self.filter.carry(self.imu.rows, begin, begin + behind, math.inf, out[: begin + behind - first])
                self.dirty, begin = due, begin + behind
                if begin == end:
                    return
                self.settle(begin)
            else:
                begin = self.filter.carry(self.imu.rows, begin, end, due, out)
                if begin == end:
                    return
                self._observe_up_to(due)
            if self.shift is not before:
                self.moves.append((begin - first, before))

    def _routine_of_next(self) -> Routine | None:
        """The routine, where it may take the next observation, else None."""
        routine, front = self.routine, self.queue.front
        if routine is None or front is None or self.filter.branches is not None or not routine.takes(front):
            return None
        return routine

    def _observe_up_to(self, due: float) -> None:
        """Let observations up to ``due`` [s] act on the filter, which stands there with its covariance up to date.

        Outside a replay, one that acts behind its row ends them: ``_run`` comes to it next.
        """
        restructured, acting = False, self.queue.waiting(due)
        if not self._replaying:
            acting = acting[:1] + list(itertools.takewhile(lambda o: not o.behind, acting[1:]))
        while acting:
            routine = self._routine_of_next()
            if routine is not None:
                results = routine.act(self.filter.vector, acting, self.filter.time)
                self.queue.skip(len(results))
                acting = acting[len(results) :]
                if not self._replaying:
                    for result in results:
                        self.shift = moved(self.shift, result, result)
                if results:
                    continue
            before = self.filter.nav[LAT:VEL].tolist()
            acting = acting[1:]
            if self.filter.act(self.queue.next(), self._apply):
                restructured, self._started = True, self.filter.time
            if not self._replaying and before != self.filter.nav[LAT:VEL].tolist():
                self.shift = self.shift + step_enu(before, self.filter.nav[LAT:VEL])
        if restructured:
            # no replay can begin before a split or a union: the checkpoint here includes all that acted at its time
            self.filter.renew_checkpoints()

    def tidy(self) -> None:
        """Drop old data if it is time to."""
        if self.filter.time >= self._tidy_at:
            self._forget()

    def _forget(self) -> float:
        """Drop data from before the window; returns the time that the memory reaches back to.

        Must be called before an observation is refused as too old, otherwise from time to time.
        """
        now = self.filter.time
        oldest = self.filter.forget_before(now - self._window)
        self.queue.forget(oldest)
        self.imu.drop_before(min(oldest, now - _KNOWN))
        self._tidy_at = now + _TIDY_PERIOD
        return oldest


def _rows_ahead_of(observation: Observation, times: np.ndarray) -> int:
    """Number of rows, of ``times`` (N,) [s], behind which ``observation`` acts; 0 if it acts between two rows."""
    count = int(times.searchsorted(observation.t, side="right"))
    return count if count and times[count - 1] == observation.t else 0
