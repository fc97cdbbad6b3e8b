"""Do velocities say where the positions went some time ago? Tells a receiver, or a driver, whose velocities are late.

A velocity that is late by tau adds up to the way between fixes when the sum begins and ends later by tau. Where nothing
speeds up, brakes or turns, that is the same. Sequential probability ratio test as in ``velocity_check``.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from dataclasses import dataclass, field
from operator import itemgetter

from nav_pose_estimator.core.gnss.velocity_steps import Step

DELAYS = (0.5, 0.75, 1.0, 1.5, 2.0)  # s
_MEMORY = 16.0  # s of sums
_PRIOR, _MOST = -10.0, 45.0  # twice the logarithm of the odds
_PROVED, _CLEARED = 5.0, 0.0
_WORST = 10.0  # squared deviations: a worse step says no more
_EXPLAINED = 5.0  # ... within which a delay has to explain a step for which it is to be blamed
_TIMING = 0.15  # s by which a delay is not known: half of the distance to the next one
_TURNS = 6.0  # m/s by which the velocity changes within a step; more is noise
_SCALE = 0.05  # of the way
_FIRST = itemgetter(0)


@dataclass(eq=False)
class Lateness:
    """Offer it every velocity and every stretch; ``delay`` [s] is what is proved, 0 where nothing is."""

    delay: float = field(default=0.0, init=False)
    _sums: deque[tuple[float, complex, complex]] = field(default_factory=deque, init=False)  # t, velocity, m so far
    _waiting: deque[Step] = field(default_factory=deque, init=False)
    _odds: list[float] = field(default_factory=lambda: [_PRIOR] * len(DELAYS), init=False)

    def interrupt(self) -> None:
        """What comes next does not follow what came before; what is not proved by now is forgotten."""
        self._sums.clear()
        self._waiting.clear()
        if not self.delay:
            self._odds = [_PRIOR] * len(DELAYS)

    def velocity(self, t: float, velocity: complex) -> None:
        """A velocity valid at ``t`` [s], as its stamp says."""
        total = 0j
        if self._sums:
            before, last, total = self._sums[-1]
            if not before < t:
                return
            total += 0.5 * (t - before) * (last + velocity)
        self._sums.append((t, velocity, total))
        while self._sums[0][0] < t - _MEMORY:
            self._sums.popleft()
        while self._waiting and self._waiting[0].end + DELAYS[-1] <= t:
            self._weigh(self._waiting.popleft())

    def stretch(self, stretch: Step) -> None:
        """A way to be explained, once the velocities are there that may belong to it."""
        self._waiting.append(stretch)

    def _weigh(self, s: Step) -> None:
        own = self._square(s, 0.0)
        if own is None:
            return
        for i, delay in enumerate(DELAYS):
            late = self._square(s, delay)
            if late is not None:
                self._odds[i] += own - late if late < _EXPLAINED else min(own - late, 0.0)
        beyond = max(max(self._odds) - _MOST, 0.0)
        self._odds = [max(odds - beyond, _PRIOR) for odds in self._odds]
        best = max(range(len(DELAYS)), key=lambda i: self._odds[i])
        if self._odds[best] > _PROVED:
            self.delay = DELAYS[best]
        elif self._odds[best] < _CLEARED:
            self.delay = 0.0

    def _square(self, s: Step, delay: float) -> float | None:
        """Squared deviations of the way from the sum that begins later by ``delay``; None where that is not known."""
        begin, end = self._sum_at(s.begin + delay), self._sum_at(s.end + delay)
        if begin is None or end is None:
            return None
        variance = s.floor**2 + (_SCALE * abs(s.way)) ** 2 + (_TIMING * min(s.turn, _TURNS)) ** 2
        return min(abs(s.way - (end - begin)) ** 2 / variance, _WORST)

    def _sum_at(self, t: float) -> complex | None:
        after = bisect_left(self._sums, t, key=_FIRST)
        if after == len(self._sums):
            return None
        if after == 0:
            return self._sums[0][2] if self._sums[0][0] == t else None
        (t0, _, s0), (t1, _, s1) = self._sums[after - 1], self._sums[after]
        return s0 + (s1 - s0) * (t - t0) / (t1 - t0)
