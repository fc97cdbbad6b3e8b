"""The filter on its time line: IMU rows carry it on, observations act at their own time of validity, however late.

The time line keeps the last second or so of IMU rows, observations and checkpoints of the filter. An observation from
the past restores the last checkpoint before it and replays what came after. Because every observation splits the IMU
interval at its own time, a late or out-of-order observation leads to the same numbers as a punctual one.
"""

from __future__ import annotations

import math

import numpy as np

from nav_pose_estimator.core.earth.ellipsoid import step_enu
from nav_pose_estimator.core.filter.layout import IMU_T, LAT, OUT_COLUMNS, VEL
from nav_pose_estimator.engine.imu.buffer import ImuBuffer
from nav_pose_estimator.engine.navigator.split_filter import Apply, SplitFilter
from nav_pose_estimator.engine.observation import Observation
from nav_pose_estimator.engine.observation_queue import ObservationQueue
from nav_pose_estimator.engine.samples import Vector3
from nav_pose_estimator.engine.sensors.routine.routine import Routine, moved

_CHECKPOINT_PERIOD = 0.05  # s: what came after one is done again when an observation is late
_TIDY_PERIOD = 0.2  # s


class Timeline:
    """``filter`` stands at the last IMU row and has a memory of ``window`` seconds."""

    def __init__(self, constants: np.ndarray, apply: Apply, window: float, routine: Routine | None = None) -> None:
        """Observations act by ``routine``, if given, those that it does not expect by ``apply``."""
        self._apply, self.routine = apply, routine
        self._window = window
        # as many as the window can hold, one before it, and the one being added
        self.filter = SplitFilter(constants, math.ceil(window / _CHECKPOINT_PERIOD) + 2, _CHECKPOINT_PERIOD)
        self.imu = ImuBuffer()
        self.queue = ObservationQueue()
        # earliest time of an observation that has not acted; who lets all of them act (``stretch.fly``) sets it back
        self.dirty: float | None = None
        self.late = False  # whether time has passed since then, so that the past must be replayed
        self._started = -math.inf  # what came before can no longer be replayed
        self._tidy_at = -math.inf  # when what has become too old is dropped next
        self.running = False
        self._replaying = False  # True while ``settle`` is at work
        self.shift = np.zeros(3)  # m, ENU: sum of what observations did to the position; replaced, never written to
        # where that changed within the last ``advance``: how many of its rows came before, and ``shift`` until then
        self.moves: list[tuple[int, np.ndarray]] = []

    def start(self, nav: np.ndarray, P: np.ndarray, origin: tuple[float, float, float] | None = None) -> None:
        """Begin at ``nav[TIME]`` with rows already known (``remember``) replayed up to the present.

        ``origin`` latitude, longitude [rad], height [m] of the local frame; None keeps the one there is.
        """
        self.restart(self.filter.constants, nav, P, origin)

    def restart(
        self,
        constants: np.ndarray,
        nav: np.ndarray,
        P: np.ndarray,
        origin: tuple[float, float, float] | None = None,
    ) -> None:
        """The same with other ``constants``, which may have other states."""
        self.filter.start(constants, nav, P, origin)
        self.running, self._started = True, self.filter.time
        self.queue.keep_after(self.filter.time)
        self.dirty, self.late = None, False
        self._tidy_at = -math.inf
        self._run(*self.imu.between(self.filter.time, math.inf))

    def remember(self, rows: np.ndarray) -> None:
        """Keep IMU ``rows`` (N, 7) without a running filter, so that an alignment in the past can catch up."""
        self.imu.append(rows)
        self.imu.drop_before(rows[-1, IMU_T] - self._window)

    def rows_since(self, t: float) -> np.ndarray:
        """The IMU rows (N, 7) later than ``t`` [s], as far as the memory reaches; not to be written to."""
        return self.imu.recent(t)

    # --- input -------------------------------------------------------------------------------------------------------

    def observe(self, observation: Observation) -> bool:
        """Take an observation in. False when it is older than the memory: then nothing happens."""
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
        """Carry the filter over IMU ``rows`` (N, 7), later than its time; returns output rows (N, OUT_COLUMNS)."""
        self.settle()
        self.imu.append(rows)
        out = np.empty((len(rows), OUT_COLUMNS))
        self._run(self.imu.last - len(rows), self.imu.last, out)
        self.tidy()
        return out

    def advance_one(self, t: float, gyro: Vector3, accel: Vector3) -> np.ndarray:
        """``advance`` by one sample that no observation waits for, on a settled time line; returns (SOLUTION_SIZE,)."""
        if self.filter.branches is not None:
            return self.filter.complete(self.advance(np.array([[t, *gyro, *accel]]))[0])
        imu = self.imu
        if imu.last == len(imu.rows):
            imu.make_room(1)
        solution = self.filter.carry_one(imu.rows, imu.last, t, gyro, accel)
        imu.last += 1
        if t >= self._tidy_at:
            self._forget()
        return solution

    def settle(self) -> None:
        """Replay from the earliest observation that has not acted yet. ``filter`` is then up to date."""
        if self.dirty is None:
            return
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
            # on the filter as it is, and on a checkpoint just made: in numbers as if they had been known before
            self.filter.carry(self.imu.rows, self.imu.last - 1, self.imu.last, now, np.empty((0, OUT_COLUMNS)))
            self._observe_up_to(now)
            self.filter.renew_checkpoints()
        self._replaying = False
        self.shift = self.shift + step_enu(before, self.filter.nav[LAT:VEL])

    def finish(self, place: np.ndarray) -> None:
        """What ``settle`` does where by routine some observations of the present time have acted, but not all.

        The first of them moved the filter from ``place``: latitude, longitude, height.
        """
        self._replaying = True
        self._observe_up_to(self.filter.time)
        self.filter.renew_checkpoints()
        self._replaying = False
        self.shift = self.shift + step_enu(place, self.filter.nav[LAT:VEL])

    # --- inside ------------------------------------------------------------------------------------------------------

    def _run(self, begin: int, end: int, out: np.ndarray | None = None) -> None:
        """Process rows ``begin`` to ``end`` of the buffer with the observations that fall into them."""
        out = np.empty((end - begin, OUT_COLUMNS)) if out is None else out
        first, self.moves = end - len(out), []
        while True:
            due = self.queue.due
            begin = self.filter.carry(self.imu.rows, begin, end, due, out)
            if begin == end:
                return
            before = self.shift
            self._observe_up_to(due)
            if self.shift is not before:
                self.moves.append((begin - first, before))

    def _routine_of_next(self) -> Routine | None:
        """The routine, where the next observation is of a kind that it knows."""
        routine, front = self.routine, self.queue.front
        if routine is None or front is None or self.filter.branches is not None or not routine.takes(front):
            return None
        return routine

    def _observe_up_to(self, due: float) -> None:
        """Let what is due act on the filter, which stands at ``due`` with its covariance up to date."""
        restructured = False
        while self.queue.due <= due:
            routine = self._routine_of_next()
            if routine is not None:
                results = routine.act(self.filter.vector, self.queue.waiting(due), self.filter.time)
                self.queue.skip(len(results))
                if not self._replaying:
                    for result in results:
                        self.shift = moved(self.shift, result, result)
                if results:
                    continue
            before = self.filter.nav[LAT:VEL].copy()
            if self.filter.act(self.queue.next(), self._apply):
                restructured, self._started = True, self.filter.time
            if not self._replaying and (before != self.filter.nav[LAT:VEL]).any():
                self.shift = self.shift + step_enu(before, self.filter.nav[LAT:VEL])
        if restructured:
            # a split or a union is the first place to go back to: with everything that acted at its time
            self.filter.renew_checkpoints()

    def tidy(self) -> None:
        """Forget what is too old, now and then."""
        if self.filter.time >= self._tidy_at:
            self._forget()

    def _forget(self) -> float:
        """Drop what lies before the window; returns the time that the memory reaches back to.

        To be done before an observation is judged too old, else now and then.
        """
        now = self.filter.time
        oldest = self.filter.forget_before(now - self._window)
        self.queue.forget(oldest)
        self.imu.drop_before(oldest)
        self._tidy_at = now + _TIDY_PERIOD
        return oldest
