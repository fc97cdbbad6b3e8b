"""Detection of two receivers on one topic, or of two alternating solutions: every second fix is displaced.

Each of the two may be valid, and a filter has no reason to prefer one of them. Pure Python, without a clock.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

_COUNT = 12  # fixes per test
_LEAST = 1.5  # m: smallest displacement that counts
_SURE = 6.0  # its significance in standard errors
_AGREED = 2  # consecutive tests that establish it


@dataclass(eq=False, slots=True)
class TwoPlaces:
    """The test. It receives the innovation of every fix; ``apart`` [m] is the displacement of the two, else 0."""

    apart: float = field(default=0.0, init=False)
    _off: list[complex] = field(default_factory=list, init=False)  # East + i North [m]
    _found: int = field(default=0, init=False)

    def note(self, east: float, north: float) -> None:
        """Add a fix that lies ``east``, ``north`` [m] from the navigator, used or not."""
        self._off.append(complex(east, north))
        if len(self._off) < _COUNT:
            return
        apart, self._off = _apart(self._off), []
        self._found = self._found + 1 if apart else 0
        self.apart = apart if self._found >= _AGREED else 0.0

    @property
    def least_sd(self) -> float:
        """Standard deviation [m] on each axis that covers both places."""
        return 0.5 * self.apart

    @property
    def reason(self) -> str:
        """Why the position is less certain than usual, one clause for the user; empty where it is not."""
        if not self.apart:
            return ""
        return f"every other GNSS fix lies {self.apart:.1f} m off: two receivers probably publish on one topic"


def _apart(off: list[complex]) -> float:
    """Distance between the means of even and odd items, 0 where it is insignificant or small."""
    sets = off[::2], off[1::2]
    means = [sum(part) / len(part) for part in sets]
    square = sum(abs(one - mean) ** 2 for part, mean in zip(sets, means, strict=True) for one in part) / len(off)
    apart = abs(means[0] - means[1])
    return apart if apart > max(_LEAST, _SURE * math.sqrt(4.0 * square / len(off))) else 0.0
