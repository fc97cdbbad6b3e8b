"""Latency of GNSS velocities relative to positions, by a sequential test of candidate delays.

With velocities that are late by tau, the integral equals the displacement between fixes if it begins and ends later by
tau. Without acceleration there is no difference. Sequential probability ratio test as in ``velocity_check``.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.gnss.velocity_steps import Step
from nav_pose_estimator.core.numerics.jit import kernel

DELAYS = (0.5, 0.75, 1.0, 1.5, 2.0)  # s: candidate delays
_MEMORY = 16.0  # s of integrated velocities that are kept
_PRIOR, _MOST = -10.0, 45.0  # prior and upper bound of 2 ln(odds)
_PROVED, _CLEARED = 5.0, 0.0  # 2 ln(odds) at which a delay is established, and dropped
_WORST = 10.0  # cap of the squared normalised residual of one step
_EXPLAINED = 5.0  # largest squared normalised residual with which a step may raise the odds of a delay
_TIMING = 0.15  # s: uncertainty of a delay, half of the distance to the next candidate
_LARGEST_CHANGE = 6.0  # m/s: limit of the change of velocity within a step; more is noise
_SCALE = 0.05  # standard deviation of the displacement relative to it
_ROWS = 256  # rows of integrated velocities at first, enough for 10 Hz
_MISSING = -1.0  # in place of a squared residual

# --- the state of the integrated velocities: index of each quantity, with its size if that is not 1 -------------------
_BEGIN, _END = 0, 1  # first row in use, and the one behind the last
_LAST = 2  # (2) m/s: last velocity, East and North
_SIZE = 4


@dataclass(eq=False, slots=True)
class Lateness:
    """The test. It receives every velocity and every step; ``delay`` [s] is the established delay, 0 without one."""

    delay: float = field(default=0.0, init=False)
    state: NDArray[np.float64] = field(default_factory=lambda: np.zeros(_SIZE), init=False)
    """State of ``integrate``."""
    sums: NDArray[np.float64] = field(default_factory=lambda: np.empty((_ROWS, 3)), init=False)
    """Its rows: time [s] and integral of the velocities up to then [m], East and North."""
    _waiting: deque[Step] = field(default_factory=deque, init=False)
    _odds: NDArray[np.float64] = field(default_factory=lambda: np.full(len(DELAYS), _PRIOR), init=False)

    def interrupt(self) -> None:
        """Drop all samples, because the next ones do not follow them; an established delay is kept."""
        self.state[:] = 0.0
        self._waiting.clear()
        if not self.delay:
            self._odds[:] = _PRIOR

    def make_room(self) -> None:
        """Make room for a velocity where all rows are in use: a receiver of a high rate needs more of them."""
        if self.state[_END] == len(self.sums):
            begin, kept = int(self.state[_BEGIN]), self.sums[int(self.state[_BEGIN]) :]
            self.sums = np.concatenate([kept, np.empty((max(begin, len(kept)), 3))])
            self.state[_BEGIN], self.state[_END] = 0.0, len(kept)

    def evaluate(self, t: float) -> bool:
        """Evaluate the steps for which the velocities up to ``t`` [s] are sufficient; True where the delay changes."""
        before = self.delay
        while self._waiting and self._waiting[0].end + DELAYS[-1] <= t:
            s = self._waiting.popleft()
            variance = (
                s.floor**2
                + (_SCALE * abs(s.displacement)) ** 2
                + (_TIMING * min(s.velocity_change, _LARGEST_CHANGE)) ** 2
            )
            self.delay = float(_judge_delays(self.state, self.sums, self._odds, self.delay, tuple(s[:3]), variance))
        return self.delay != before

    def add_step(self, step: Step) -> None:
        """Add a step; it is evaluated when the velocities of the longest delay have arrived."""
        self._waiting.append(step)


@kernel
def integrate(state, sums, t, east, north):
    """Add a velocity [m/s] valid at ``t`` [s] according to its stamp, for which ``sums`` has room."""
    begin, end = int(state[_BEGIN]), int(state[_END])
    sums[end, 0], sums[end, 1], sums[end, 2] = t, 0.0, 0.0
    if end > begin:
        seconds = t - sums[end - 1, 0]
        if not seconds > 0.0:
            return
        sums[end, 1] = sums[end - 1, 1] + 0.5 * seconds * (state[_LAST] + east)
        sums[end, 2] = sums[end - 1, 2] + 0.5 * seconds * (state[_LAST + 1] + north)
    state[_LAST], state[_LAST + 1], state[_END] = east, north, end + 1
    while sums[int(state[_BEGIN]), 0] < t - _MEMORY:
        state[_BEGIN] += 1.0


@kernel
def _judge_delays(state, sums, odds, delay, step, variance):
    """Add the evidence of a ``step`` (begin, end, displacement) to the ``odds``; returns the established delay."""
    own = _square(state, sums, step, 0.0, variance)
    if own == _MISSING:
        return delay
    best = 0
    for i in range(len(DELAYS)):
        late = _square(state, sums, step, DELAYS[i], variance)
        if late != _MISSING:
            odds[i] += own - late if late < _EXPLAINED else min(own - late, 0.0)
        best = i if odds[i] > odds[best] else best
    beyond = max(odds[best] - _MOST, 0.0)
    for i in range(len(DELAYS)):
        odds[i] = max(odds[i] - beyond, _PRIOR)
    if odds[best] > _PROVED:
        return DELAYS[best]
    return 0.0 if odds[best] < _CLEARED else delay


@kernel
def _square(state, sums, step, delay, variance):
    """Squared normalised residual of a step for ``delay`` [s]; ``_MISSING`` where its velocities are missing."""
    begin, end, displacement = step
    first, last = _sum_at(state, sums, begin + delay), _sum_at(state, sums, end + delay)
    if math.isnan(first.real) or math.isnan(last.real):
        return _MISSING
    return min(abs(displacement - (last - first)) ** 2 / variance, _WORST)


@kernel
def _sum_at(state, sums, t):
    """Integral of the velocities up to ``t`` [s], NaN where it is not known."""
    begin, end = int(state[_BEGIN]), int(state[_END])
    after = end
    while after > begin and sums[after - 1, 0] >= t:
        after -= 1
    if after == end or (after == begin and sums[begin, 0] != t):
        return complex(math.nan, math.nan)
    if after == begin:
        return complex(sums[begin, 1], sums[begin, 2])
    t0, t1 = sums[after - 1, 0], sums[after, 0]
    before, now = complex(sums[after - 1, 1], sums[after - 1, 2]), complex(sums[after, 1], sums[after, 2])
    return before + (now - before) * (t - t0) / (t1 - t0)
