"""Queue of observations in the order in which they are applied: applied ones within the memory, and pending ones."""

from __future__ import annotations

import bisect
import math
import operator
from collections.abc import Sequence

from nav_pose_estimator.engine.observation import Observation

_KEY, _TIME = operator.attrgetter("key"), operator.attrgetter("t")


class ObservationQueue:
    """Observations sorted by time, precedence and arrival."""

    def __init__(self) -> None:
        self._sorted: list[Observation] = []
        self._done = 0  # observations before this index have been applied
        self._arrivals = 0

    def __len__(self) -> int:
        return len(self._sorted)

    def insert(self, observation: Observation) -> bool:
        """Insert an observation in order; True where later ones have already been applied."""
        self.number(observation)
        if not self._sorted or self._sorted[-1].key < observation.key:
            self._sorted.append(observation)
            return False
        index = bisect.bisect(self._sorted, observation.key, key=_KEY)
        self._sorted.insert(index, observation)
        return index < self._done

    @property
    def due(self) -> float:
        """Time of the next pending observation [s], infinite without one."""
        return self._sorted[self._done].t if self._done < len(self._sorted) else math.inf

    def number(self, observation: Observation) -> None:
        """Number an observation by its arrival, unless it has a number already."""
        if not observation.arrival:
            self._arrivals += 1
            observation.arrival = self._arrivals

    def next(self) -> Observation:
        """Return the next pending observation and count it as applied."""
        self._done += 1
        return self._sorted[self._done - 1]

    @property
    def front(self) -> Observation | None:
        """The next pending observation, None without one."""
        return self._sorted[self._done] if self._done < len(self._sorted) else None

    def waiting(self, t: float = math.inf) -> list[Observation]:
        """Pending observations up to ``t`` [s]."""
        waiting = self._sorted[self._done :]
        return waiting if t == math.inf else [o for o in waiting if o.t <= t]

    def take_waiting(self) -> list[Observation]:
        """Remove and return all pending observations."""
        waiting = self._sorted[self._done :]
        del self._sorted[self._done :]
        return waiting

    def add_acted(self, observations: Sequence[Observation]) -> None:
        """Append ``observations`` that have been applied after all others; there must be no pending ones."""
        self._sorted += observations
        self._done += len(observations)

    def skip(self, count: int) -> None:
        """Count the next ``count`` observations as applied."""
        self._done += count

    def due_besides_quiet(self, drifts: bool) -> float:
        """``due`` of the observations that may change the mode; ``drifts``: nothing bounds the filter's drift."""
        for index in range(self._done, len(self._sorted)):
            kind = self._sorted[index].kind
            if not (kind.quiet or (kind.holds and not drifts)):
                return self._sorted[index].t
        return math.inf

    def rewind(self, t: float) -> None:
        """Make observations after ``t`` [s] pending again."""
        self._done = bisect.bisect_right(self._sorted, t, key=_TIME)

    def keep_after(self, t: float) -> None:
        """Drop everything up to ``t`` [s] and make the rest pending."""
        self._sorted = [o for o in self._sorted if o.t > t]
        self._done = 0

    def forget(self, t: float) -> None:
        """Drop applied observations up to ``t`` [s]."""
        drop = bisect.bisect_right(self._sorted, t, key=_TIME)
        del self._sorted[:drop]
        self._done -= drop
