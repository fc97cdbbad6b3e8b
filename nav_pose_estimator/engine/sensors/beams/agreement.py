"""Consistency of beams and navigator: which of the two is wrong where they contradict."""

from __future__ import annotations

import math
from dataclasses import dataclass

_MEMORY = 0.95  # forgetting factor per message of the rate of contradiction
_CONTRADICTS_ABOVE, _AGREES_BELOW = 0.5, 0.1  # rates at which a contradiction begins and ends
_PROVEN = 20  # messages of agreement in motion after which the sensor is used without GNSS
_ACCUSERS = 2  # smallest number of rejected beams that question the navigator
_PERSISTENT = 60  # consecutive messages, and ...
_PERSISTENT_TIME = 30.0  # ... s, for which they have to be rejected


@dataclass
class Agreement:
    """Test of the whole sensor while GNSS is good: it is wrong if most beams are rejected most of the time."""

    contradicts: bool = False
    rate: float = 0.0  # of messages with more than half of the beams rejected
    _agreeing: int = 0  # messages that agreed in a motion in which a wrong mounting would show

    def add(self, refused: int, present: int, is_telling: bool) -> bool:
        """Add a message with ``present`` beams, ``refused`` of them rejected; True where ``contradicts`` has changed.

        ``is_telling``: the motion is fast enough to show a wrong mounting.
        """
        disagrees = 2 * refused > present
        self.rate = _MEMORY * self.rate + (1.0 - _MEMORY) * disagrees
        self._agreeing += is_telling and not disagrees
        before = self.contradicts
        if self.rate > _CONTRADICTS_ABOVE:
            self.contradicts = True
        elif self.rate < _AGREES_BELOW:
            self.contradicts = False
        return self.contradicts is not before

    @property
    def is_proven(self) -> bool:
        """Whether the sensor has agreed for long enough to be used without GNSS."""
        return self._agreeing >= _PROVEN and not self.contradicts


@dataclass
class Accusation:
    """Test of the navigator without GNSS: it is wrong if two or more beams are rejected together for long.

    A single rejected beam is itself faulty.
    """

    _since: float = math.inf  # s
    _messages: int = 0

    def add(self, t: float, refused: int) -> bool:
        """Add a message at ``t`` [s] with ``refused`` rejected beams; True where the navigator has to follow them."""
        if refused < _ACCUSERS:
            self._since, self._messages = math.inf, 0
            return False
        self._since = min(self._since, t)
        self._messages += 1
        return self._messages > _PERSISTENT and t - self._since > _PERSISTENT_TIME
