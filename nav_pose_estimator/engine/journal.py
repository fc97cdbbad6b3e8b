"""Journal of an engine: its events in order, and counters by event name."""

from collections import Counter
from collections.abc import Callable

from nav_pose_estimator.engine.solutions import Event, Level


class Journal:
    """Events since the last ``drain`` and counters since the start."""

    def __init__(self) -> None:
        self.counters: Counter[str] = Counter()
        self._events: list[Event] = []
        self._before: Callable[[], object] | None = None

    def before_next(self, action: Callable[[], object] | None) -> None:
        """Run ``action`` once before the next event, since it may produce earlier events."""
        self._before = action

    def catch_up(self) -> None:
        """Run the pending action of ``before_next``, if any."""
        if self._before is not None:
            action, self._before = self._before, None
            action()

    def count(self, name: str) -> None:
        """Count an event without a sentence, for what happens too often."""
        self.counters[name] += 1

    def say(self, stamp_ns: int, name: str, level: Level, text: str, **data: float) -> None:
        """Count and report an event with a sentence."""
        self.add(Event(stamp_ns, name, level, text, data))

    def add(self, event: Event) -> None:
        """Count and report an event made elsewhere."""
        self.catch_up()
        self.counters[event.name] += 1
        self._events.append(event)

    def drain(self) -> list[Event]:
        """The events since the last call."""
        if not self._events:
            return []
        events, self._events = self._events, []
        return events

    def copy(self) -> "Journal":
        """An independent copy."""
        twin = Journal()
        twin.counters = Counter(self.counters)
        twin._events = list(self._events)
        return twin
