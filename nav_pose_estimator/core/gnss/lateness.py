"""Latency of GNSS velocities relative to positions, by a sequential test of candidate delays.

With velocities that are late by tau, the integral equals the displacement between fixes if it begins and ends later by
tau. Without acceleration there is no difference. Sequential probability ratio test as in ``velocity_check``.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from dataclasses import dataclass, field
from operator import itemgetter

from nav_pose_estimator.core.gnss.velocity_steps import Step

DELAYS = (0.5, 0.75, 1.0, 1.5, 2.0)  # s: candidate delays
_MEMORY = 16.0  # s of integrated velocities that are kept
_PRIOR, _MOST = -10.0, 45.0  # prior and upper bound of 2 ln(odds)
_PROVED, _CLEARED = 5.0, 0.0  # 2 ln(odds) at which a delay is established, and dropped
_WORST = 10.0  # cap of the squared normalised residual of one step
_EXPLAINED = 5.0  # largest squared normalised residual with which a step may raise the odds of a delay
_TIMING = 0.15  # s: uncertainty of a delay, half of the distance to the next candidate
_TURNS = 6.0  # m/s: limit of the change of velocity within a step; more is noise
_SCALE = 0.05  # standard deviation of the displacement relative to it
_FIRST = itemgetter(0)


@dataclass(eq=False)
class Lateness:
    """The test. It receives every velocity and every step; ``delay`` [s] is the established delay, 0 without one."""

    delay: float = field(default=0.0, init=False)
    _sums: deque[tuple[float, complex, complex]] = field(default_factory=deque, init=False)  # t, velocity, m so far
    _waiting: deque[Step] = field(default_factory=deque, init=False)
    _odds: list[float] = field(default_factory=lambda: [_PRIOR] * len(DELAYS), init=False)

    def interrupt(self) -> None:
        """Drop all samples, because the next ones do not follow them; an established delay is kept."""
        self._sums.clear()
        self._waiting.clear()
        if not self.delay:
            self._odds = [_PRIOR] * len(DELAYS)

    def velocity(self, t: float, velocity: complex) -> None:
        """Add a velocity valid at ``t`` [s] according to its stamp."""
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
        """Add a step; it is evaluated when the velocities of the longest delay have arrived."""
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
        """Squared normalised residual of a step for ``delay`` [s]; None where its velocities are missing."""
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
