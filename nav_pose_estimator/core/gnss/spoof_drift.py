"""Detection of positions that drift away from the receiver's own velocities, as under a slow spoofing attack.

A spoofer that moves the position by a metre per second passes every gate on single fixes, because the filter follows.
But the integral of the receiver's velocities does not follow. Single fixes scatter, so the test uses the change, over
some seconds, of the difference between position and integrated velocity. Without a clock.
"""

import math
from collections.abc import Sequence

import numpy as np

from nav_pose_estimator.core.numerics.jit import kernel

_PAUSE = 2.0  # s: longest pause over which velocities are integrated
_MEDIAN = 5  # differences whose median is used, so that two outliers do not matter
_LEFT_BEHIND = 2  # marks from which a drift must lead away: a single one may be wrong
_MARK_PERIOD = 5.0  # s between the differences that are kept as marks
_MARKS = 12  # marks that are kept: one minute
_SPEED = 0.5  # m/s: lasting error of the velocity of a sound receiver
_LASTS = 2.0  # s that a drift has to last, in contrast to single outliers
_LONGEST_PAUSE = 0.5  # s for which a drift may pause before its duration counts anew
_REMEMBERED = 60.0  # s after its end for which a drifted position is doubted
_CREDIBLE = 2.0  # standard deviations that cover the distance between position and integrated velocity

# --- the state of a ``WalkOff``: index of each quantity, with its size if that is not 1 ------------------------------
_T = 0  # s: time of the last fix
_VELOCITY, _INTEGRAL = 1, 3  # (2) m/s: last velocity, (2) m: its integral, East and North
_LEAVING_SINCE, _LAST_LEAVING = 5, 6  # s: begin of the present drift, and the last time of a significant speed
_LEFT = (
    7  # (3): the mark from which positions have drifted, a row as in ``_marks``; its time is NaN while there is none
)
_LEFT_UNTIL = 10  # s: when that is forgotten
_DISTANCE = 11  # m: present distance from it
_RECENT, _MARKED = 12, 13  # numbers of rows in ``_recent`` and ``_marks``
_SIZE = 14


class WalkOff:
    """The test. It receives every fused fix with the receiver's velocity at that time."""

    def __init__(self) -> None:
        self._state = np.empty(_SIZE)
        # rows of time [s] and difference between position and integrated velocity [m], East and North
        self._recent, self._marks = np.empty((_MEDIAN, 3)), np.empty((_MARKS, 3))
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        _begin(self._state, -math.inf, 0.0, 0.0)

    @property
    def is_on(self) -> bool:
        """Whether positions have drifted away from their velocities and not returned."""
        return not math.isnan(self._state[_LEFT])

    @property
    def distance(self) -> float:
        """Present distance [m] of positions from the integrated velocities."""
        return float(self._state[_DISTANCE])

    @property
    def least_sd(self) -> float:
        """Standard deviation [m] on each axis that covers both."""
        return self.distance / _CREDIBLE

    @property
    def reason(self) -> str:
        """Why the position is less certain than usual, one clause for the user; empty where it is not."""
        if not self.is_on:
            return ""
        distance = f"{self.distance:.0f} m"
        return f"GNSS positions are {distance} from where the receiver's own velocities lead: dragged, or reflected"

    def update(
        self, t: float, position_enu: Sequence[float], velocity_enu: Sequence[float] | None, scatter: float
    ) -> float:
        """Speed [m/s] at which positions drift away from their velocities, 0.0 where it is insignificant.

        Args:
            t: time of validity [s], increasing.
            position_enu: (3,) in a local frame [m]; Up is not used, neither here nor of the velocity.
            velocity_enu: (3,) [m/s], or None without one.
            scatter: largest difference of two sound fixes by noise [m].
        """
        if velocity_enu is None:
            return 0.0
        place, velocity = (position_enu[0], position_enu[1]), (velocity_enu[0], velocity_enu[1])
        return float(_update(self._state, self._recent, self._marks, t, place, velocity, scatter))


@kernel
def _begin(state, t, v_east, v_north):
    """Restart at a fix that does not follow the last one."""
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
        state[_INTEGRAL + axis] += half * (state[_VELOCITY + axis] + velocity[axis])
        state[_VELOCITY + axis] = velocity[axis]
    state[_T] = t
    east, north = place[0] - state[_INTEGRAL], place[1] - state[_INTEGRAL + 1]
    count = state[_RECENT] = _added(recent, int(state[_RECENT]), t, east, north)
    east, north = _middle(recent[:count, 1]), _middle(recent[:count, 2])
    marked = int(state[_MARKED])
    if count == _MEDIAN and (marked == 0 or t - marks[marked - 1, 0] >= _MARK_PERIOD):
        marked = state[_MARKED] = _added(marks, marked, t, east, north)
    speed, then = _leaving(marks[:marked], t, east, north, scatter)
    state[_LAST_LEAVING] = t if then >= 0 else state[_LAST_LEAVING]
    leaves = then >= 0 or t - state[_LAST_LEAVING] < _LONGEST_PAUSE
    state[_LEAVING_SINCE] = min(state[_LEAVING_SINCE], t) if leaves else math.inf
    if then >= 0 and t - state[_LEAVING_SINCE] >= _LASTS:
        _leave(state, marks[then], t + _REMEMBERED)
    _stay_away(state, east, north, scatter)
    return speed


@kernel
def _leave(state, mark, until):
    """Note that positions have drifted away from a ``mark``, unless they already had."""
    if math.isnan(state[_LEFT]):
        for i in range(3):
            state[_LEFT + i] = mark[i]
    state[_LEFT_UNTIL] = until


@kernel
def _stay_away(state, east, north, scatter):
    """Update the distance from the mark of the drift, which is over within ``scatter`` [m] or after some time."""
    if math.isnan(state[_LEFT]):
        return
    state[_DISTANCE] = math.hypot(east - state[_LEFT + 1], north - state[_LEFT + 2])
    if state[_DISTANCE] < scatter or state[_T] > state[_LEFT_UNTIL]:
        state[_LEFT], state[_DISTANCE] = math.nan, 0.0


@kernel
def _added(rows, count, t, east, north):
    """Append a row to the first ``count`` of ``rows`` (N, 3), dropping the oldest if full; returns the new count."""
    if count == len(rows):
        count -= 1
        for i in range(count):
            for k in range(3):
                rows[i, k] = rows[i + 1, k]
    rows[count, 0], rows[count, 1], rows[count, 2] = t, east, north
    return count + 1


@kernel
def _middle(values):
    """Median of ``values`` (N,), N odd."""
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
    """Largest significant speed [m/s] away from one of ``marks`` (N, 3), and the index of that mark.

    0.0 and -1 unless the speed is significant for two marks.
    """
    fastest, from_where, left = 0.0, -1, 0
    for i in range(len(marks)):
        seconds, apart = t - marks[i, 0], math.hypot(east - marks[i, 1], north - marks[i, 2])
        if seconds > 0.0 and apart > scatter + _SPEED * seconds:
            left += 1
            if apart > fastest * seconds:
                fastest, from_where = apart / seconds, i
    return (fastest, from_where) if left >= _LEFT_BEHIND else (0.0, -1)
