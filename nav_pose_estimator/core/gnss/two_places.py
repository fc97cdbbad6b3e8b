"""Does every other fix lie elsewhere? Two receivers on one topic, or a driver that mixes two solutions.

Each of them may be sound. A filter that sits between them, or on one of them while it refuses the other, has no reason
to prefer it. Pure Python, without a clock.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

_COUNT = 12  # fixes that are looked at together
_LEAST = 1.5  # m
_SURE = 6.0  # deviations of the difference
_AGREED = 2  # looks in a row


@dataclass(eq=False)
class TwoPlaces:
    """Offer it by how much every fix is off; ``apart`` [m] is how far the two places are from each other, 0 for one."""

    apart: float = field(default=0.0, init=False)
    _off: list[complex] = field(default_factory=list, init=False)  # East + i North [m]
    _found: int = field(default=0, init=False)

    def note(self, east: float, north: float) -> None:
        """A fix lies so far [m] from where the navigator expects it, whatever becomes of it."""
        self._off.append(complex(east, north))
        if len(self._off) < _COUNT:
            return
        apart, self._off = _apart(self._off), []
        self._found = self._found + 1 if apart else 0
        self.apart = apart if self._found >= _AGREED else 0.0

    @property
    def least_sd(self) -> float:
        """Deviation [m] on each axis that covers both places."""
        return 0.5 * self.apart

    @property
    def reason(self) -> str:
        """Why the position is not to be believed as usual, a clause; empty if it is."""
        if not self.apart:
            return ""
        return f"every other GNSS fix lies {self.apart:.1f} m off: two receivers probably publish on one topic"


def _apart(off: list[complex]) -> float:
    """How far the mean of every other of them lies from that of the rest, 0.0 where that is chance or little."""
    sets = off[::2], off[1::2]
    means = [sum(part) / len(part) for part in sets]
    square = sum(abs(one - mean) ** 2 for part, mean in zip(sets, means, strict=True) for one in part) / len(off)
    apart = abs(means[0] - means[1])
    return apart if apart > max(_LEAST, _SURE * math.sqrt(4.0 * square / len(off))) else 0.0
