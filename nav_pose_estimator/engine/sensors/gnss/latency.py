"""Uncertainty of the position by an estimated GNSS latency that ``gnss.delay`` does not compensate."""

from __future__ import annotations

from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.solutions import Level

_NOTABLE = 0.2  # s: the effect of a smaller latency is within the usual error of receivers
_SAME = 0.1  # s: smaller changes of the estimate give no event
_MORE = 2.0  # the true latency over the largest one that is tried, which may be larger still
_CREDIBLE = 2.0  # standard deviations that cover the distance travelled in that time


class Latency:
    """Keeps the latency that the comparison of IMU and GNSS has shown."""

    def __init__(self, journal: Journal) -> None:
        self._journal = journal
        self._delay, self._reported, self._configured_delay = 0.0, 0.0, 0.0  # s
        self._is_least = False

    @property
    def is_on(self) -> bool:
        """Whether the latency has a notable effect on the position."""
        return abs(self._delay) > _NOTABLE

    def found(self, delay: float, configured: float, stamp_ns: int, is_least: bool = False) -> None:
        """Take an estimate: ``delay`` [s] beyond the ``configured`` value of ``gnss.delay``, 0 without one.

        ``is_least``: no larger one was tried.
        """
        self._delay, self._configured_delay, self._is_least = delay, configured, is_least
        if delay and abs(delay - self._reported) > _SAME:
            self._reported = delay
            level = Level.WARN if self.is_on else Level.INFO
            self._journal.say(stamp_ns, "gnss.delayed", level, self._in_words(), delay=configured + delay)

    def least_sd(self, speed: float) -> float:
        """Floor of the position's standard deviation [m] at this horizontal ``speed`` [m/s]."""
        size = abs(self._delay) * (_MORE if self._is_least else 1.0)
        return size * speed / _CREDIBLE if self.is_on else 0.0

    def reason(self) -> str:
        """Why the position is less certain than usual, one clause for the user; empty where it is not."""
        return self._in_words() if self.is_on else ""

    def _in_words(self) -> str:
        size, total = f"{abs(self._delay):.1f} s", self._configured_delay + self._delay
        if self._is_least:
            size += " or more"
        if self._delay > 0.0:
            again = " and fly again, which shows the rest" if self._is_least else ""
            return (
                f"GNSS lags the motion measured by the IMU by {size}: set gnss.delay to {total:.1f}{again} "
                "(replay: --gnss-delay auto)"
            )
        ahead = f"GNSS leads the motion measured by the IMU by {size}"
        if total > -0.05:
            return f"{ahead}: set gnss.delay to {max(total, 0.0):.1f}"
        return f"{ahead}: the IMU's stamps are late, probably those of arrival"
