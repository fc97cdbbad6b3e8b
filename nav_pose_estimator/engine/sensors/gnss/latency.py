"""GNSS that is stamped late: what that says of the position while nobody has set ``gnss.delay``."""

from __future__ import annotations

from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.solutions import Level

_NOTABLE = 0.2  # s: of less the way is within what receivers err by anyway
_SAME = 0.1  # s by which an estimate may change without a word
_CREDIBLE = 2.0  # deviations that cover the way


class Latency:
    """Keeps what IMU and GNSS have shown of it."""

    def __init__(self, journal: Journal) -> None:
        self._journal = journal
        self._delay, self._told, self._set = 0.0, 0.0, 0.0  # s

    @property
    def is_on(self) -> bool:
        """Whether the position is noticeably late."""
        return abs(self._delay) > _NOTABLE

    def found(self, delay: float, already: float, stamp_ns: int) -> None:
        """GNSS is later by ``delay`` [s] than the ``already`` set ``gnss.delay``; 0 where nothing is proved."""
        self._delay, self._set = delay, already
        if delay and abs(delay - self._told) > _SAME:
            self._told = delay
            level = Level.WARN if self.is_on else Level.INFO
            self._journal.say(stamp_ns, "gnss.delayed", level, self._in_words(), delay=already + delay)

    def least_sd(self, speed: float) -> float:
        """Deviation [m] of the position of a vehicle of this horizontal ``speed`` [m/s]."""
        return abs(self._delay) * speed / _CREDIBLE if self.is_on else 0.0

    def reason(self) -> str:
        """Why the position is not to be believed as usual, a clause; empty if it is."""
        return self._in_words() if self.is_on else ""

    def _in_words(self) -> str:
        size, total = abs(self._delay), self._set + self._delay
        if self._delay > 0.0:
            return (
                f"GNSS follows the motion that the IMU feels {size:.1f} s late: set gnss.delay to {total:.1f} "
                "(replay: --gnss-delay auto)"
            )
        ahead = f"GNSS is ahead of the motion that the IMU feels by {size:.1f} s"
        if total > -0.05:
            return f"{ahead}: set gnss.delay to {max(total, 0.0):.1f}"
        return f"{ahead}: the IMU's stamps are late, probably those of arrival"
