"""The queue of a node: messages of all topics in their order of arrival.

The middleware keeps a queue for each topic and drops from it without a word; the executor asks one topic after the
other. A node that is behind would then process fixes that are older than its IMU data, and declare GNSS lost because of
its own delay.
"""

import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

from nav_pose_estimator.ros.diagnostics import InputWatch

Adapter = Callable[[Any], tuple[Any, ...]]


@dataclass(frozen=True, slots=True)
class Arrival:
    """A message, what makes samples of it, and when the middleware received it (wall clock).

    Where a middleware does not tell that, the time of publication stands for it.
    """

    received_ns: int
    watch: InputWatch
    adapter: Adapter
    message: Any

    @property
    def lag(self) -> float:
        """Seconds that it has waited."""
        return 1e-9 * (time.time_ns() - self.received_ns)


class Inbox:
    """The messages that wait for one node."""

    def __init__(self) -> None:
        self._inputs: list[tuple[InputWatch, Adapter, Any]] = []
        self._waiting: deque[Arrival] = deque()

    def __bool__(self) -> bool:
        return bool(self._waiting)

    def add(self, watch: InputWatch, adapter: Adapter, subscription: Any) -> None:
        """Look after one more input."""
        self._inputs.append((watch, adapter, subscription))

    def put(self, watch: InputWatch, adapter: Adapter, message: Any) -> None:
        """A message that the executor has brought, behind those that wait."""
        self._waiting.append(Arrival(time.time_ns(), watch, adapter, message))

    def collect(self) -> None:
        """Take everything that waits in the middleware."""
        found = []
        for watch, adapter, subscription in self._inputs:
            for message, info in _taken(subscription):
                watch.taken(info["publication_sequence_number"])
                received = info["received_timestamp"] or info["source_timestamp"] or time.time_ns()
                found.append(Arrival(received, watch, adapter, message))
        self._waiting.extend(sorted(found, key=attrgetter("received_ns")))

    def next(self) -> Arrival:
        """The oldest one, which no longer waits."""
        return self._waiting.popleft()

    def give_up(self) -> None:
        """Drop everything; each message counts as lost on its input."""
        for arrival in self._waiting:
            arrival.watch.dropped()
        self._waiting.clear()


def _taken(subscription: Any) -> Iterator[tuple[Any, dict[str, Any]]]:
    """The messages that wait, each with what the middleware knows of it."""
    with subscription.handle:
        while (taken := subscription.handle.take_message(subscription.msg_type, subscription.raw)) is not None:
            yield taken
