"""Queue of all waiting messages of a node, in order of arrival.

The middleware has a queue per topic, from which it drops messages silently, and the executor serves one topic after the
other. Without a common queue, a node that is behind would receive fixes that are older than its IMU data, and report
GNSS as lost because of its own delay.
"""

import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

from nav_pose_estimator.ros.load.input_watch import InputWatch

Adapter = Callable[[Any], tuple[Any, ...]]


@dataclass(frozen=True, slots=True)
class Arrival:
    """A message, its adapter to samples, and when the middleware received it (wall clock).

    With a middleware that does not provide this time, it is the time of publication.
    """

    received_ns: int
    watch: InputWatch
    adapter: Adapter
    message: Any

    @property
    def lag(self) -> float:
        """Time for which the message has waited [s]."""
        return 1e-9 * (time.time_ns() - self.received_ns)


class Inbox:
    """The queue of one node."""

    def __init__(self) -> None:
        self._inputs: list[tuple[InputWatch, Adapter, Any]] = []
        self._waiting: deque[Arrival] = deque()

    def __bool__(self) -> bool:
        return bool(self._waiting)

    def add(self, watch: InputWatch, adapter: Adapter, subscription: Any) -> None:
        """Add an input to collect from."""
        self._inputs.append((watch, adapter, subscription))

    def put(self, watch: InputWatch, adapter: Adapter, message: Any) -> None:
        """Append a message that the executor has delivered."""
        self._waiting.append(Arrival(time.time_ns(), watch, adapter, message))

    def collect(self) -> None:
        """Take all messages that wait in the middleware."""
        found = []
        for watch, adapter, subscription in self._inputs:
            for message, info in _taken(subscription):
                watch.taken(info["publication_sequence_number"])
                received = info["received_timestamp"] or info["source_timestamp"] or time.time_ns()
                found.append(Arrival(received, watch, adapter, message))
        self._waiting.extend(sorted(found, key=attrgetter("received_ns")))

    def next(self) -> Arrival:
        """Remove and return the oldest message."""
        return self._waiting.popleft()

    def give_up(self) -> None:
        """Drop everything; each message counts as lost on its input."""
        for arrival in self._waiting:
            arrival.watch.dropped()
        self._waiting.clear()


def _taken(subscription: Any) -> Iterator[tuple[Any, dict[str, Any]]]:
    """The messages that wait in the middleware, each with its information."""
    with subscription.handle:
        while (taken := subscription.handle.take_message(subscription.msg_type, subscription.raw)) is not None:
            yield taken
