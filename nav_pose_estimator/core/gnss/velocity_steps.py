"""Steps of a second or so: the way between fixes beside the sum of the velocities, and what they may differ by.

A vehicle that is slow takes longer steps. Without a clock: time comes with the samples, in seconds since the engine's
epoch. Places are complex numbers, East + i North [m].
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.numerics.jit import kernel

_EARTH = 6.371e6  # m
_APART = 0.3  # s: a velocity farther from a fix in time is not its own
_PAUSE = 6.0  # s: over a longer one nothing can be summed up
_PAUSES, _SHORTEST_PAUSE = 2.5, 1.0  # usual periods and s: a longer one is an outage as well
_SLOWER = 1.2  # by which the usual period grows from one fix to the next, at most
_SHORTEST, _LONGEST = 0.9, 6.0  # s of a step; the longest is that of a vehicle that is too slow to show anything
_FLOOR = 0.6  # m by which way and sum differ in a second, at least; recorded flights: 0.1 to 0.5 (rms)
_SLOW_BIAS = 0.25  # m/s by which the velocity of a slow antenna is wrong for seconds
_TIMING = 0.3  # s between the clocks of position and velocity, filters of receivers included
_STATED_MOST = 5.0  # m: of more than that a receiver only seldom means its drift
_DRIFT = 0.8  # of a stated deviation a receiver may drift in a step
_COVERS = 2.0  # deviations of fixes that scatter
_SHORT = 0.5  # s: over a longer one an acceleration looks like scatter
_DENSE = 1.2  # s: over a longer one the sum leaves out bends
_FADING = 0.1  # share of the newest in the mean of the scatter
_INFORMATIVE = 4.0  # floors: of a shorter step every hypothesis says the same


@dataclass(frozen=True, slots=True)
class Step:
    """From one fix to another."""

    begin: float  # s
    end: float
    way: complex  # m, between the fixes
    said: complex  # m, the sum of the velocities
    turn: float
    """m/s by which the velocity changed."""
    floor: float
    """m by which way and sum may differ whatever the motion."""
    timing: float
    """m by which they may differ because the velocity changed."""
    all_same: bool
    """Whether the velocity was the same to the last digit."""
    silent: tuple[bool, bool]
    """Whether East and North were zero to the last digit."""
    dense: bool = True
    """Whether velocities followed one another closely enough for their sum to be exact."""

    @property
    def weight(self) -> float:
        """0 of a step that says nothing, 1 of one that is long enough to tell anything apart."""
        return min(max(abs(self.way), abs(self.said)) / (_INFORMATIVE * self.floor), 1.0) ** 2

    @property
    def misfit(self) -> float:
        """Speed [m/s] by which way and sum differ."""
        return abs(self.way - self.said) / (self.end - self.begin)


# --- the numbers of a ``StepMaker`` ---------------------------------------------------------------------------------
_LAT, _LON, _BEGIN = 0, 1, 2  # rad, rad, s: first fix of the step that goes on; NaN while none does
_T = 3  # s: the last fix so far
_FIRST, _LAST = 4, 6  # 2, 2: m/s, velocities of the two, East and North
_PLACE, _SAID = 8, 10  # 2, 2: m from the first fix, where the last one is and where velocities lead
_LONGEST_PERIOD = 12  # s between its fixes
_ALL_SAME, _SILENT = 13, 14  # 1, 2: 1 while velocities have been the same, East and North zero; else 0
_MOVED = 16  # 2: m between the last two fixes, NaN where they are far apart
_PERIOD = 18  # s between fixes, the shortest lately
_VARIANCE = 19  # m^2 of a fix on each axis, by second differences
_STATED = 20  # m: a receiver that still converges drifts by what it states
_SIZE = 21


@dataclass(eq=False)
class StepMaker:
    """Offer it every velocity and every usable fix; a fix may end a step."""

    _velocities: deque[tuple[float, complex, float]] = field(default_factory=lambda: deque(maxlen=40), init=False)
    _state: NDArray[np.float64] = field(init=False)

    def __post_init__(self) -> None:
        self._state = np.zeros(_SIZE)
        self._state[_PERIOD] = math.inf
        self._break_off()

    @property
    def variance(self) -> float:
        """m^2 of a fix on each axis, by second differences."""
        return float(self._state[_VARIANCE])

    def interrupt(self) -> None:
        """What comes next does not follow what came before."""
        self._velocities.clear()
        self._break_off()

    def _break_off(self) -> None:
        self._state[_BEGIN] = self._state[_MOVED] = math.nan

    def velocity(self, t: float, velocity: complex, up: float) -> None:
        """A velocity [m/s] valid at ``t``."""
        self._velocities.append((t, velocity, up))

    def own(self, t: float) -> tuple[complex, float] | None:
        """The velocity, horizontal and vertical, that belongs to a fix at ``t``; None where none is near."""
        if self._velocities and self._velocities[-1][0] == t:  # nearly always
            return self._velocities[-1][1:]
        apart = [abs(one[0] - t) for one in self._velocities]
        least = min(apart, default=math.inf)
        return None if least > _APART else self._velocities[apart.index(least)][1:]

    def fix(self, t: float, lat: float, lon: float, sd: float, velocity: complex | None) -> Step | None:
        """A position [rad, rad] with its ``own`` velocity; ``sd`` [m] that is stated. The step that ends there."""
        self._state[_STATED] = min(sd, _STATED_MOST)
        if velocity is None:
            self._break_off()
            return None
        if not _take(self._state, t, lat, lon, velocity):
            return None
        done = _step(self._state)
        _begin(self._state, t, lat, lon, velocity)
        return done

    def floor(self, seconds: float) -> float:
        """By which way and sum differ over so many seconds whatever the motion [m]."""
        return float(_floor(self._state, seconds))


@kernel
def _take(state, t, lat, lon, velocity):
    """A fix with its velocity carries the step on, or begins one; True where it ends it."""
    if math.isnan(state[_BEGIN]) or _is_outage(state, t - state[_T]):
        _begin(state, t, lat, lon, velocity)
        return False
    turn = 2.0 * math.pi
    longitudes = lon - state[_LON]
    longitudes -= turn * round(longitudes / turn)
    period = t - state[_T]
    _move_to(state, _EARTH * math.cos(state[_LAT]) * longitudes, _EARTH * (lat - state[_LAT]), period)
    _hear(state, 0, velocity.real, period)
    _hear(state, 1, velocity.imag, period)
    state[_T], state[_LONGEST_PERIOD] = t, max(state[_LONGEST_PERIOD], period)
    seconds = t - state[_BEGIN]
    moved = max(math.hypot(state[_PLACE], state[_PLACE + 1]), math.hypot(state[_SAID], state[_SAID + 1]))
    return seconds >= _SHORTEST and (moved >= _INFORMATIVE * _floor(state, seconds) or seconds >= _LONGEST)


@kernel
def _is_outage(state, period):
    """Whether fixes have paused: where they go on, the guard of the return asks, and no velocity answers."""
    usual = state[_PERIOD]
    state[_PERIOD] = min(period, _SLOWER * usual)
    return period > min(max(_PAUSES * usual, _SHORTEST_PAUSE), _PAUSE)


@kernel
def _begin(state, t, lat, lon, velocity):
    """A step begins at a fix."""
    state[_LAT], state[_LON], state[_BEGIN], state[_T] = lat, lon, t, t
    state[_FIRST] = state[_LAST] = velocity.real
    state[_FIRST + 1] = state[_LAST + 1] = velocity.imag
    for i in range(_PLACE, _ALL_SAME):
        state[i] = 0.0
    for i in range(_ALL_SAME, _MOVED):
        state[i] = 1.0


@kernel
def _move_to(state, east, north, period):
    """The next fix. White errors of fixes show in their second differences, whose variance is six times theirs."""
    moved_east, moved_north = east - state[_PLACE], north - state[_PLACE + 1]
    state[_PLACE], state[_PLACE + 1] = east, north
    if period > _SHORT:
        state[_MOVED] = math.nan
        return
    if not math.isnan(state[_MOVED]):
        square = (moved_east - state[_MOVED]) ** 2 + (moved_north - state[_MOVED + 1]) ** 2
        state[_VARIANCE] += _FADING * (square / 12.0 - state[_VARIANCE])
    state[_MOVED], state[_MOVED + 1] = moved_east, moved_north


@kernel
def _hear(state, axis, velocity, period):
    """The next velocity on one axis."""
    state[_SAID + axis] += 0.5 * period * (state[_LAST + axis] + velocity)
    state[_LAST + axis] = velocity
    if velocity != state[_FIRST + axis]:
        state[_ALL_SAME] = 0.0
    if velocity != 0.0:
        state[_SILENT + axis] = 0.0


@kernel
def _floor(state, seconds):
    """``StepMaker.floor``."""
    noise = max(_FLOOR, _COVERS * math.sqrt(2.0 * state[_VARIANCE]), _DRIFT * state[_STATED])
    return noise + _SLOW_BIAS * max(seconds - 1.0, 0.0)


def _step(state: NDArray[np.float64]) -> Step:
    """The step that has just ended."""
    s = state.tolist()
    seconds = s[_T] - s[_BEGIN]
    turn = math.hypot(s[_LAST] - s[_FIRST], s[_LAST + 1] - s[_FIRST + 1])
    return Step(
        begin=s[_BEGIN],
        end=s[_T],
        way=complex(s[_PLACE], s[_PLACE + 1]),
        said=complex(s[_SAID], s[_SAID + 1]),
        turn=turn,
        floor=float(_floor(state, seconds)),
        timing=(_TIMING + 0.5 * max(s[_LONGEST_PERIOD] - _SHORT, 0.0)) * turn,
        all_same=bool(s[_ALL_SAME]),
        silent=(bool(s[_SILENT]), bool(s[_SILENT + 1])),
        dense=s[_LONGEST_PERIOD] <= _DENSE,
    )
