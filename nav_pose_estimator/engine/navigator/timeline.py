"""The filter on its time line: IMU rows carry it on, observations act at their own time of validity, however late.

The time line keeps the last second or so of IMU rows, observations and checkpoints of the filter. An observation from
the past restores the last checkpoint before it and replays what came after. Because every observation splits the IMU
interval at its own time, a late or out-of-order observation leads to the same numbers as a punctual one.
"""

from __future__ import annotations

import bisect
import math
import operator
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from nav_pose_estimator.core.earth.ellipsoid import step_enu
from nav_pose_estimator.core.filter import memory
from nav_pose_estimator.core.filter.layout import IMU_COLUMNS, IMU_T, LAT, OUT_COLUMNS, SOLUTION_SIZE, TIME, VEL
from nav_pose_estimator.engine.navigator.branches import Branches
from nav_pose_estimator.engine.samples import MotionEvidence, Vector3

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


_KEY, _TIME = operator.attrgetter("key"), operator.attrgetter("t")
Apply = Callable[[Observation, np.ndarray, np.ndarray, np.ndarray], None]
"""(observation, nav, P, constants): let an observation act on a filter that stands at its time."""


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
        self._apply = apply
        self._whole = whole
        self._window = window
        self._period = checkpoint_period
        # as many as the window can hold, one before it, and the one being added
        self._slots = math.ceil(window / checkpoint_period) + 2
        self._hold(memory.make(constants, self._slots, checkpoint_period))
        self._rows = np.empty((0, IMU_COLUMNS))  # a buffer with room at the end; the live part is [_first:_last]
        self._first = self._last = 0
        self._observations: list[Observation] = []  # sorted by key
        self._done = 0  # observations before this index have acted on nav
        self._dirty: float | None = None  # earliest time of an observation that has not acted
        self._late = False  # whether time has passed since then, so that the past must be replayed
        self._started = -math.inf
        self._arrivals = 0
        self._tidy_at = -math.inf  # when what has become too old is dropped next
        self.running = False
        self.replaying = False  # True while ``settle`` is at work
        self.branches: Branches | None = None  # the filter's hypotheses in an outage; ``nav``, ``P`` are their mixture
        self._united_by = 0  # arrival of the observation that ended branches last
        self.shift = np.zeros(3)  # m, ENU: sum of what observations did to the position; replaced, never written to
        # where that changed within the last ``advance``: how many of its rows came before, and ``shift`` until then
        self.moves: list[tuple[int, np.ndarray]] = []

    def _hold(self, filter_memory: np.ndarray) -> None:
        """Work on ``filter_memory``; ``nav``, ``P`` and ``constants`` are parts of it."""
        n = int(filter_memory[memory.STATES])
        self._memory = filter_memory
        self.nav = filter_memory[memory.NAV : memory.CONSTANTS]
        self.constants = filter_memory[memory.CONSTANTS : memory.ORIGIN]
        self.P = filter_memory[memory.HEAD : memory.HEAD + n * n].reshape(n, n)

    # --- start and state ---------------------------------------------------------------------------------------------

    def start(self, nav: np.ndarray, P: np.ndarray, origin: tuple[float, float, float] | None = None) -> None:
        """Begin at ``nav[TIME]`` with rows already known (``remember``) replayed up to the present.

        ``origin`` latitude, longitude [rad], height [m] of the local frame; None keeps the one there is.
        """
        place = self._memory[memory.ORIGIN : memory.STATES] if origin is None else origin
        fresh = memory.make(self.constants, self._slots, self._period)
        fresh[memory.ORIGIN : memory.STATES] = place
        fresh[memory.NAV : memory.CONSTANTS] = nav
        fresh[memory.HEAD : memory.HEAD + P.size] = P.ravel()
        self._hold(fresh)
        self.branches = None
        memory.add_checkpoint(fresh)
        self.running, self._started = True, self.time
        self._observations = [o for o in self._observations if o.t > self.time]
        self._done = 0
        self._dirty, self._late = None, False
        self._tidy_at = -math.inf
        self._catch_up(self.time, math.inf)

    def remember(self, rows: np.ndarray) -> None:
        """Keep IMU ``rows`` (N, 7) without a running filter, so that an alignment in the past can catch up."""
        self._append(rows)

    @property
    def time(self) -> float:
        """Time of the last IMU row [s]."""
        return float(self.nav[TIME])

    @property
    def checkpoints(self) -> int:
        """Number of checkpoints that are kept."""
        return int(self._memory[memory.NEWEST] - self._memory[memory.OLDEST]) + 1

    def copy(self, apply: Apply) -> Timeline:
        """An independent copy that applies observations through ``apply``."""
        twin = Timeline(self.constants.copy(), apply, self._window, self._whole, self._period)
        twin._hold(self._memory.copy())
        twin.branches = self.branches and self.branches.copy()
        twin.shift, twin._united_by = self.shift, self._united_by
        twin._rows = self._rows[self._first : self._last].copy()
        twin._last = len(twin._rows)
        twin._observations = [
            Observation(o.t, o.kind, o.arguments, o.priority, o.arrival, dict(o.memory)) for o in self._observations
        ]
        twin._done, twin._dirty, twin._arrivals = self._done, self._dirty, self._arrivals
        twin._late, twin._started = self._late, self._started
        twin._tidy_at, twin.running = self._tidy_at, self.running
        return twin

    def next_observation(self, besides: frozenset[str] = frozenset()) -> float:
        """Time of the earliest observation of a kind not in ``besides`` that waits for the future, inf without one."""
        return next((o.t for o in self._observations[self._done :] if o.kind not in besides), math.inf)

    def recent_rows(self, seconds: float) -> np.ndarray:
        """The IMU rows (N, 7) of the last ``seconds``, as far as the memory reaches; not to be written to."""
        rows = self._live()
        return rows[np.searchsorted(rows[:, IMU_T], self.time - seconds, side="right") :]

    # --- input -------------------------------------------------------------------------------------------------------

    def observe(self, t: float, kind: str, arguments: tuple, priority: int = 5) -> bool:
        """Insert an observation valid at ``t``. False when it is older than the memory: then nothing happens."""
        if self.running:
            now = self.time
            # the oldest checkpoint lies before the window, unless the filter has just been started
            certain = t > now - self._window and t > self._started
            if not certain and t <= self._forget():
                return False
        self._arrivals += 1
        observation = Observation(t, kind, arguments, priority, self._arrivals)
        index = bisect.bisect(self._observations, observation.key, key=_KEY)
        self._observations.insert(index, observation)
        if self.running and t <= now:
            self._late = self._late or t < now or index < self._done
            self._dirty = t if self._dirty is None else min(self._dirty, t)
        return True

    def advance(self, rows: np.ndarray) -> np.ndarray:
        """Carry the filter over IMU ``rows`` (N, 7), later than ``time``; returns output rows (N, OUT_COLUMNS)."""
        self.settle()
        self._append(rows)
        out = np.empty((len(rows), OUT_COLUMNS))
        self._run(self._last - len(rows), self._last, out)
        if self.time >= self._tidy_at:
            self._forget()
        return out

    def advance_one(self, t: float, gyro: Vector3, accel: Vector3) -> np.ndarray:
        """``advance`` by one sample that no observation waits for, on a settled time line; returns (SOLUTION_SIZE,)."""
        if self.branches is not None:
            return self.complete(self.advance(np.array([[t, *gyro, *accel]]))[0])
        if self._last == len(self._rows):
            self._make_room(1)
        solution = np.empty(SOLUTION_SIZE)
        memory.run_sample(self._memory, self._rows, self._last, solution, t, *gyro, *accel)
        self._last += 1
        if t >= self._tidy_at:
            self._forget()
        return solution

    def complete(self, row: np.ndarray) -> np.ndarray:
        """The solution (SOLUTION_SIZE,) at the present, of which ``row`` is the output row."""
        solution = np.empty(SOLUTION_SIZE)
        solution[:OUT_COLUMNS] = row
        memory.complete_solution(self._memory, solution)
        return solution

    def settle(self) -> None:
        """Replay from the earliest observation that has not acted yet. ``nav`` and ``P`` are then up to date."""
        if self._dirty is None:
            return
        now, dirty, late = self.time, self._dirty, self._late
        before = self.nav[LAT:VEL].copy()
        self._dirty, self._late = None, False
        self.replaying = True
        if late:
            self._replay_from(dirty, now)
        else:
            self._act_now(now)
        self.replaying = False
        self.shift = self.shift + step_enu(before, self.nav[LAT:VEL])

    # --- inside ------------------------------------------------------------------------------------------------------

    def _replay_from(self, dirty: float, now: float) -> None:
        if self.branches is None:
            memory.restore_before(self._memory, dirty)
            start = self.time
        else:
            start = self.branches.restore_before(dirty)
        self._done = bisect.bisect_right(self._observations, start, key=_TIME)
        self._catch_up(start, now)

    def _catch_up(self, start: float, now: float) -> None:
        """Process the rows of the buffer that are later than ``start``, where the filter stands, up to ``now``."""
        times = self._live()[:, IMU_T]
        begin, end = (self._first + int(np.searchsorted(times, t, side="right")) for t in (start, now))
        self._run(begin, end, np.empty((end - begin, OUT_COLUMNS)))

    def _act_now(self, now: float) -> None:
        """Observations of the very time at which the filter stands act on it as it is, and on a checkpoint just made.

        The same in numbers as if they had been known before.
        """
        self._carry(self._last - 1, self._last, now, np.empty((0, OUT_COLUMNS)))
        self._observe_up_to(now)
        self._renew_checkpoints()

    def _renew_checkpoints(self) -> None:
        """Where the filter has just been kept, keep it as it is by now."""
        for one in [self._memory] if self.branches is None else self.branches.memories:
            memory.renew_checkpoint(one)

    def _run(self, begin: int, end: int, out: np.ndarray) -> None:
        """Process rows ``begin`` to ``end`` of the buffer with the observations that fall into them."""
        first, self.moves = end - len(out), []
        while True:
            due = self._observations[self._done].t if self._done < len(self._observations) else math.inf
            begin = self._carry(begin, end, due, out)
            if begin == end:
                return
            before = self.shift
            self._observe_up_to(due)
            if self.shift is not before:
                self.moves.append((begin - first, before))

    def _carry(self, begin: int, end: int, due: float, out: np.ndarray) -> int:
        """``memory.run_block`` over rows of the buffer, along every branch where there are any."""
        if self.branches is None:
            return memory.run_block(self._memory, self._rows, begin, end, due, out)
        stop = self.branches.run(self._rows, begin, end, due, out)
        self.branches.mix_into(self._memory)
        return stop

    def _act(self, observation: Observation) -> None:
        """Let one observation act on the filter, which stands at its time with its covariance up to date."""
        before = self.nav[LAT:VEL].copy()
        if observation.kind == MOTION:
            if observation.arrival > self._united_by:  # else it is of means that GNSS has proved wrong since
                self._weigh(*observation.arguments)
        elif self.branches is None:
            self._apply(observation, self.nav, self.P, self.constants)
        elif observation.kind in self._whole:
            was = self.nav.copy()
            self._apply(observation, self.nav, self.P, self.constants)
            if not np.array_equal(was, self.nav):
                self._unite(observation.arrival)
        else:
            for nav, P in self.branches.pairs():
                self._apply(observation, nav, P, self.branches.constants)
            self.branches.mix_into(self._memory)
        if not self.replaying and not np.array_equal(before, self.nav[LAT:VEL]):
            self.shift = self.shift + step_enu(before, self.nav[LAT:VEL])

    def _weigh(self, evidence: MotionEvidence) -> None:
        """Let the hypotheses of an outage act, on branches that are made when there are none yet."""
        if self.branches is None:
            self.branches = Branches(self._memory, self._slots, evidence)
            self._started = self.time  # what came before the split can no longer be replayed
        self.branches.decide(evidence)
        self.branches.mix_into(self._memory)

    def _unite(self, arrival: int) -> None:
        """An absolute position decides what no hypothesis could: go on with ``nav`` and ``P``, and only with them."""
        self.branches, self._united_by = None, arrival
        self._memory[memory.OLDEST] = 0.0
        self._memory[memory.NEWEST] = -1.0
        memory.add_checkpoint(self._memory)
        self._started = self.time

    def _observe_up_to(self, due: float) -> None:
        before = self.branches
        while self._done < len(self._observations) and self._observations[self._done].t <= due:
            self._act(self._observations[self._done])
            self._done += 1
        if self.branches is not before:
            # a split or a union is the first place to go back to: with everything that acted at its time
            self._renew_checkpoints()

    def _live(self) -> np.ndarray:
        return self._rows[self._first : self._last]

    def _append(self, rows: np.ndarray) -> None:
        need = len(rows)
        if self._last + need > len(self._rows):
            self._make_room(need)
        self._rows[self._last : self._last + need] = rows
        self._last += need
        if not self.running:
            self._drop_rows_before(rows[-1, IMU_T] - self._window)

    def _make_room(self, need: int) -> None:
        live = self._live()
        room = np.empty((2 * (len(live) + need) + 256, IMU_COLUMNS))
        room[: len(live)] = live
        self._rows, self._first, self._last = room, 0, len(live)

    def _forget(self) -> float:
        """Drop what lies before the window; returns the time that the memory reaches back to.

        To be done before an observation is judged too old, else now and then.
        """
        now = self.time
        kept = [self._memory] if self.branches is None else self.branches.memories
        oldest = min(memory.drop_before(one, now - self._window) for one in kept)
        drop = bisect.bisect_right(self._observations, oldest, key=_TIME)
        del self._observations[:drop]
        self._done -= drop
        self._drop_rows_before(oldest)
        self._tidy_at = now + self._period
        return oldest

    def _drop_rows_before(self, t: float) -> None:
        # the row at or before t stays: point-sampled data interpolate from it
        self._first += max(int(np.searchsorted(self._live()[:, IMU_T], t)) - 1, 0)
