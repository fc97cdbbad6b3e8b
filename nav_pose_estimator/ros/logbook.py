"""Events to log lines and counters: every event is counted, the words come the 1st, 10th, 100th ... time.

rclpy's own throttling costs 300 microseconds a call even when it stays silent; this one costs an addition.
"""

import math
from collections import Counter
from typing import Any

from nav_pose_estimator.engine.solutions import Event, Level

_ALWAYS = (
    *("mode.", "reset", "aligned", "gnss.reset", "gnss.reacquired", "set_pose", "time."),
    *("outage.trained", "outage.model.", "autopilot."),
)


class Logbook:
    """Where a node writes down what happened."""

    def __init__(self, logger: Any) -> None:
        self._logger = logger
        self.counters: Counter[str] = Counter()

    def note(self, event: Event) -> None:
        """Count ``event`` and log it unless it was logged often."""
        self.counters[event.name] += 1
        if not event.text:
            return
        count = self.counters[event.name]
        if event.name.startswith(_ALWAYS) or count == 1:
            self._say(event.level, event.text)
        elif math.log10(count).is_integer():
            self._say(event.level, f"{event.text} ({count} times so far)")

    def _say(self, level: Level, text: str) -> None:
        # rclpy wants one severity for each place in the code that logs
        if level is Level.ERROR:
            self._logger.error(text)
        elif level is Level.WARN:
            self._logger.warning(text)
        elif level is Level.INFO:
            self._logger.info(text)
        else:
            self._logger.debug(text)
