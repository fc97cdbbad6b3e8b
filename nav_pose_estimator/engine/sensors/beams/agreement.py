"""Beams and navigator against each other: who is to be believed where they contradict."""

from __future__ import annotations

import math
from dataclasses import dataclass

_MEMORY = 0.95
_CONTRADICTS_ABOVE, _AGREES_BELOW = 0.5, 0.1
_PROVEN = 20  # messages
_ACCUSERS = 2
_PERSISTENT = 60  # messages ...
_PERSISTENT_TIME = 30.0  # s


@dataclass
class Agreement:
    """While GNSS is good a sensor of which most beams are refused most of the time is wrong as a whole."""

    contradicts: bool = False
    rate: float = 0.0  # of messages of which more than half of the beams are refused
    _told: int = 0  # messages that agreed where a wrong sensor would not have

    def add(self, refused: int, present: int, is_telling: bool) -> bool:
        """A message with ``present`` beams, in a motion that would show a wrong mounting or not.

        True where ``contradicts`` has changed.
        """
        disagrees = 2 * refused > present
        self.rate = _MEMORY * self.rate + (1.0 - _MEMORY) * disagrees
        self._told += is_telling and not disagrees
        before = self.contradicts
        if self.rate > _CONTRADICTS_ABOVE:
            self.contradicts = True
        elif self.rate < _AGREES_BELOW:
            self.contradicts = False
        return self.contradicts is not before

    @property
    def is_proven(self) -> bool:
        """Whether the sensor has agreed for long enough to be believed without GNSS."""
        return self._told >= _PROVEN and not self.contradicts


@dataclass
class Accusation:
    """Without GNSS two beams or more that are refused for long accuse the navigator; one alone accuses itself."""

    _since: float = math.inf  # s
    _messages: int = 0

    def add(self, t: float, refused: int) -> bool:
        """A message at ``t`` [s] of which so many beams are refused; True where the navigator is to follow them."""
        if refused < _ACCUSERS:
            self._since, self._messages = math.inf, 0
            return False
        self._since = min(self._since, t)
        self._messages += 1
        return self._messages > _PERSISTENT and t - self._since > _PERSISTENT_TIME
