"""Do a receiver's positions go where its velocities say? They diverge when a spoofer drags the position slowly away.

A spoofer that moves the position by a metre per second passes every gate on single fixes: the filter follows. But the
sum of the receiver's own velocities does not. Single fixes scatter, so what counts is how the difference between
position and summed velocity has changed since some seconds ago. Without a clock.
"""

import math
from collections.abc import Sequence

import numpy as np

from nav_pose_estimator.core.numerics.jit import kernel

_PAUSE = 2.0  # s: over a longer one nothing can be summed up
_MEDIAN = 5  # differences of which the middle counts: two fixes that are far off are neither a mark nor a drift
_LEFT_BEHIND = 2  # marks that a drift leaves behind: one alone may lie wrong
_MARK_PERIOD = 5.0  # s between the differences that are kept
_MARKS = 12  # ... which reach back a minute
_SPEED = 0.5  # m/s: what velocities of honest receivers may be wrong by for long
_LASTS = 2.0  # s of a drift, which single fixes that are far off are not
_FLICKERS = 0.5  # s for which it may seem to stop meanwhile
_REMEMBERED = 60.0  # s for which a position that has left its velocities is doubted after it has stopped to do so
_CREDIBLE = 2.0  # deviations that cover where positions are and where velocities lead

# --- the numbers of a ``WalkOff`` -----------------------------------------------------------------------------------
_T = 0  # s: the last fix
_VELOCITY, _TRAVELLED = 1, 3  # 2, 2: m/s, m by velocities, East and North
_LEAVING_SINCE, _LAST_LEAVING = 5, 6  # s
_LEFT = 7  # 3: what positions have left, a row as below; its time is NaN while there is nothing
_LEFT_UNTIL = 10  # s
_WAY = 11  # m from there
_RECENT, _MARKED = 12, 13  # how many rows there are of the newest differences, and of those that are kept
_SIZE = 14


class WalkOff:
    """Offer it every fix that is fused, with the receiver's velocity at that time."""

    def __init__(self) -> None:
        self._state = np.empty(_SIZE)
        # rows of time [s] and of the difference between position and travelled way [m], East and North
        self._recent, self._marks = np.empty((_MEDIAN, 3)), np.empty((_MARKS, 3))
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        _begin(self._state, -math.inf, 0.0, 0.0)

    @property
    def is_on(self) -> bool:
        """Whether positions have left their velocities, and not come back."""
        return not math.isnan(self._state[_LEFT])

    @property
    def way(self) -> float:
        """How far [m] positions are by now from where velocities lead."""
        return float(self._state[_WAY])

    @property
    def least_sd(self) -> float:
        """Deviation [m] that covers both, on each axis."""
        return self.way / _CREDIBLE

    @property
    def reason(self) -> str:
        """Why the position is not to be believed as usual, a clause; empty if it is."""
        if not self.is_on:
            return ""
        return (
            f"GNSS positions are {self.way:.0f} m from where the receiver's own velocities lead: dragged, or reflected"
        )

    def update(
        self, t: float, position_enu: Sequence[float], velocity_enu: Sequence[float] | None, scatter: float
    ) -> float:
        """Speed [m/s] at which positions leave their velocities, 0.0 while that may be chance.

        Args:
            t: time of validity [s], increasing.
            position_enu: (3,) in a local frame [m]; Up is not looked at, as is that of the velocity [m/s].
            scatter: how far two honest fixes may differ by chance [m].
        """
        if velocity_enu is None:
            return 0.0
        place, velocity = (position_enu[0], position_enu[1]), (velocity_enu[0], velocity_enu[1])
        return float(_update(self._state, self._recent, self._marks, t, place, velocity, scatter))


@kernel
def _begin(state, t, v_east, v_north):
    """A fix that follows no other."""
    for i in range(_SIZE):
        state[i] = 0.0
    state[_T], state[_VELOCITY], state[_VELOCITY + 1] = t, v_east, v_north
    state[_LEAVING_SINCE], state[_LAST_LEAVING], state[_LEFT_UNTIL] = math.inf, -math.inf, -math.inf
    state[_LEFT] = math.nan


@kernel
def _update(state, recent, marks, t, place, velocity, scatter):
    """``WalkOff.update`` with the horizontal ``place`` and ``velocity``, two numbers each."""
    if not 0.0 < t - state[_T] < _PAUSE:
        _begin(state, t, velocity[0], velocity[1])
        state[_RECENT] = _added(recent, 0, t, place[0], place[1])
        return 0.0
    half = 0.5 * (t - state[_T])
    for axis in range(2):
        state[_TRAVELLED + axis] += half * (state[_VELOCITY + axis] + velocity[axis])
        state[_VELOCITY + axis] = velocity[axis]
    state[_T] = t
    east, north = place[0] - state[_TRAVELLED], place[1] - state[_TRAVELLED + 1]
    count = state[_RECENT] = _added(recent, int(state[_RECENT]), t, east, north)
    east, north = _middle(recent[:count, 1]), _middle(recent[:count, 2])
    marked = int(state[_MARKED])
    if count == _MEDIAN and (marked == 0 or t - marks[marked - 1, 0] >= _MARK_PERIOD):
        marked = state[_MARKED] = _added(marks, marked, t, east, north)
    speed, then = _leaving(marks[:marked], t, east, north, scatter)
    state[_LAST_LEAVING] = t if then >= 0 else state[_LAST_LEAVING]
    leaves = then >= 0 or t - state[_LAST_LEAVING] < _FLICKERS
    state[_LEAVING_SINCE] = min(state[_LEAVING_SINCE], t) if leaves else math.inf
    if then >= 0 and t - state[_LEAVING_SINCE] >= _LASTS:
        _leave(state, marks[then], t + _REMEMBERED)
    _stay_away(state, east, north, scatter)
    return speed


@kernel
def _leave(state, mark, until):
    """Positions have left their velocities at a ``mark``, unless they had before."""
    if math.isnan(state[_LEFT]):
        for i in range(3):
            state[_LEFT + i] = mark[i]
    state[_LEFT_UNTIL] = until


@kernel
def _stay_away(state, east, north, scatter):
    """How far they are from there; they are back within ``scatter`` [m], or after a while."""
    if math.isnan(state[_LEFT]):
        return
    state[_WAY] = math.hypot(east - state[_LEFT + 1], north - state[_LEFT + 2])
    if state[_WAY] < scatter or state[_T] > state[_LEFT_UNTIL]:
        state[_LEFT], state[_WAY] = math.nan, 0.0


@kernel
def _added(rows, count, t, east, north):
    """A row more behind the ``count`` newest ones of ``rows`` (N, 3), without the oldest where there is no room."""
    if count == len(rows):
        count -= 1
        for i in range(count):
            for k in range(3):
                rows[i, k] = rows[i + 1, k]
    rows[count, 0], rows[count, 1], rows[count, 2] = t, east, north
    return count + 1


@kernel
def _middle(values):
    """The one of ``values`` (N,) that has half of the others below it."""
    for i in range(len(values)):
        below = equal = 0
        for k in range(len(values)):
            below += values[k] < values[i]
            equal += values[k] == values[i]
        if below <= len(values) // 2 < below + equal:
            return values[i]
    return values[0]


@kernel
def _leaving(marks, t, east, north, scatter):
    """The largest speed away from one of ``marks`` (N, 3) that is more than chance, and which one.

    0.0 and -1 where it is less for all, or for all but one.
    """
    fastest, from_where, left = 0.0, -1, 0
    for i in range(len(marks)):
        seconds, apart = t - marks[i, 0], math.hypot(east - marks[i, 1], north - marks[i, 2])
        if seconds > 0.0 and apart > scatter + _SPEED * seconds:
            left += 1
            if apart > fastest * seconds:
                fastest, from_where = apart / seconds, i
    return (fastest, from_where) if left >= _LEFT_BEHIND else (0.0, -1)
