"""Latency of GNSS velocities relative to positions, by a sequential test of candidate delays.

With velocities that are late by tau, the integral equals the displacement between fixes if it begins and ends later by
tau. Without acceleration there is no difference. Sequential probability ratio test as in ``velocity_check``.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from dataclasses import dataclass, field

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


@dataclass(eq=False)
class Lateness:
    """The test. It receives every velocity and every step; ``delay`` [s] is the established delay, 0 without one."""

    delay: float = field(default=0.0, init=False)
    _times: list[float] = field(default_factory=list, init=False)
    _sums: list[complex] = field(default_factory=list, init=False)  # m: integral of the velocities up to each time
    _last: complex = field(default=0j, init=False)  # m/s: last velocity
    _waiting: deque[Step] = field(default_factory=deque, init=False)
    _odds: list[float] = field(default_factory=lambda: [_PRIOR] * len(DELAYS), init=False)

    def interrupt(self) -> None:
        """Drop all samples, because the next ones do not follow them; an established delay is kept."""
        self._times.clear()
        self._sums.clear()
        self._waiting.clear()
        if not self.delay:
            self._odds = [_PRIOR] * len(DELAYS)

    def velocity(self, t: float, velocity: complex) -> None:
        """Add a velocity valid at ``t`` [s] according to its stamp."""
        total = 0j
        if self._times:
            before = self._times[-1]
            if not before < t:
                return
            total = self._sums[-1] + 0.5 * (t - before) * (self._last + velocity)
        self._times.append(t)
        self._sums.append(total)
        self._last = velocity
        while self._times[0] < t - _MEMORY:
            del self._times[0], self._sums[0]
        while self._waiting and self._waiting[0].end + DELAYS[-1] <= t:
            self._weigh(self._waiting.popleft())

    def stretch(self, stretch: Step) -> None:
        """Add a step; it is evaluated when the velocities of the longest delay have arrived."""
        self._waiting.append(stretch)

    def _weigh(self, s: Step) -> None:
        variance = s.floor**2 + (_SCALE * abs(s.way)) ** 2 + (_TIMING * min(s.turn, _TURNS)) ** 2
        own = self._square(s, 0.0, variance)
        if own is None:
            return
        for i, delay in enumerate(DELAYS):
            late = self._square(s, delay, variance)
            if late is not None:
                self._odds[i] += own - late if late < _EXPLAINED else min(own - late, 0.0)
        beyond = max(max(self._odds) - _MOST, 0.0)
        self._odds = [max(odds - beyond, _PRIOR) for odds in self._odds]
        largest = max(self._odds)
        if largest > _PROVED:
            self.delay = DELAYS[self._odds.index(largest)]
        elif largest < _CLEARED:
            self.delay = 0.0

    def _square(self, s: Step, delay: float, variance: float) -> float | None:
        """Squared normalised residual of a step for ``delay`` [s]; None where its velocities are missing."""
        begin, end = self._sum_at(s.begin + delay), self._sum_at(s.end + delay)
        if begin is None or end is None:
            return None
        return min(abs(s.way - (end - begin)) ** 2 / variance, _WORST)

    def _sum_at(self, t: float) -> complex | None:
        times, sums = self._times, self._sums
        after = bisect_left(times, t)
        if after == len(times):
            return None
        if after == 0:
            return sums[0] if times[0] == t else None
        t0, t1, s0, s1 = times[after - 1], times[after], sums[after - 1], sums[after]
        return s0 + (s1 - s0) * (t - t0) / (t1 - t0)
