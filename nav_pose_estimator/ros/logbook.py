"""Log of events: all are counted, and repeated ones are logged the 1st, 10th, 100th ... time.

The throttling of rclpy costs 300 microseconds per call even when nothing is logged; here it costs an addition.
"""

import math
from collections import Counter
from typing import Any

from nav_pose_estimator.engine.solutions import Event, Level

_ALWAYS = (  # beginnings of the names of events that are logged every time
    *("mode.", "reset", "aligned", "gnss.reset", "gnss.reacquired", "set_pose", "time."),
    *("outage.trained", "outage.model.", "autopilot."),
)


class Logbook:
    """The log of one node."""

    def __init__(self, logger: Any) -> None:
        self._logger = logger
        self.counters: Counter[str] = Counter()

    def note(self, event: Event) -> None:
        """Count ``event``, and log it if its count is due."""
        self.counters[event.name] += 1
        if not event.text:
            return
        count = self.counters[event.name]
        if event.name.startswith(_ALWAYS) or count == 1:
            self._say(event.level, event.text)
        elif math.log10(count).is_integer():
            self._say(event.level, f"{event.text} ({count} times so far)")

    def _say(self, level: Level, text: str) -> None:
        # rclpy permits only one severity per calling line
        if level is Level.ERROR:
            self._logger.error(text)
        elif level is Level.WARN:
            self._logger.warning(text)
        elif level is Level.INFO:
            self._logger.info(text)
        else:
            self._logger.debug(text)
