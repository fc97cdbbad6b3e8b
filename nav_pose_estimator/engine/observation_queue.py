"""Observations in the order in which they act: those that have acted, as far as memory reaches, and those to come."""

from __future__ import annotations

import bisect
import math
import operator
from collections.abc import Sequence

from nav_pose_estimator.engine.observation import Observation

_KEY, _TIME = operator.attrgetter("key"), operator.attrgetter("t")


class ObservationQueue:
    """Sorted by time, precedence, arrival. Observations before the index ``done`` have acted on the filter."""

    def __init__(self) -> None:
        self._sorted: list[Observation] = []
        self._done = 0
        self._arrivals = 0

    def __len__(self) -> int:
        return len(self._sorted)

    def insert(self, observation: Observation) -> bool:
        """Put an observation in its place; True when others behind it have acted already."""
        self.number(observation)
        if not self._sorted or self._sorted[-1].key < observation.key:
            self._sorted.append(observation)
            return False
        index = bisect.bisect(self._sorted, observation.key, key=_KEY)
        self._sorted.insert(index, observation)
        return index < self._done

    @property
    def due(self) -> float:
        """Time of the next observation that has not acted [s], infinite without one."""
        return self._sorted[self._done].t if self._done < len(self._sorted) else math.inf

    def number(self, observation: Observation) -> None:
        """An observation has arrived; what has its number keeps it."""
        if not observation.arrival:
            self._arrivals += 1
            observation.arrival = self._arrivals

    def next(self) -> Observation:
        """The next observation; from now on it has acted."""
        self._done += 1
        return self._sorted[self._done - 1]

    @property
    def front(self) -> Observation | None:
        """The next observation that has not acted; None without one."""
        return self._sorted[self._done] if self._done < len(self._sorted) else None

    def waiting(self, t: float = math.inf) -> list[Observation]:
        """What has not acted, up to ``t`` [s]."""
        waiting = self._sorted[self._done :]
        return waiting if t == math.inf else [o for o in waiting if o.t <= t]

    def take_waiting(self) -> list[Observation]:
        """``waiting``, which is not here any more."""
        waiting = self._sorted[self._done :]
        del self._sorted[self._done :]
        return waiting

    def add_acted(self, observations: Sequence[Observation]) -> None:
        """These have acted, behind all the others that have; nothing waits."""
        self._sorted += observations
        self._done += len(observations)

    def skip(self, count: int) -> None:
        """The next ``count`` have acted."""
        self._done += count

    def due_besides_quiet(self, drifts: bool) -> float:
        """``due`` of the observations that may change the mode, where the filter ``drifts`` unbounded or not."""
        for index in range(self._done, len(self._sorted)):
            kind = self._sorted[index].kind
            if not (kind.quiet or (kind.holds and not drifts)):
                return self._sorted[index].t
        return math.inf

    def rewind(self, t: float) -> None:
        """What lies after ``t`` has not acted (again)."""
        self._done = bisect.bisect_right(self._sorted, t, key=_TIME)

    def keep_after(self, t: float) -> None:
        """Forget everything up to ``t``; nothing of the rest has acted."""
        self._sorted = [o for o in self._sorted if o.t > t]
        self._done = 0

    def forget(self, t: float) -> None:
        """Forget what has acted up to ``t``."""
        drop = bisect.bisect_right(self._sorted, t, key=_TIME)
        del self._sorted[:drop]
        self._done -= drop
