"""Steps of about one second: displacement between fixes, integral of the velocities, and the tolerance between them.

The steps of a slow vehicle are longer. Without a clock: time comes with the samples, in seconds since the engine's
epoch. Positions are complex numbers, East + i North [m].
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.numerics.jit import kernel

_EARTH = 6.371e6  # m
_APART = 0.3  # s: largest time difference of a fix and its own velocity
_PAUSE = 6.0  # s: longest pause over which velocities are integrated
_PAUSES, _SHORTEST_PAUSE = 2.5, 1.0  # usual periods, and s: a longer pause also ends a step
_SLOWER = 1.2  # largest growth of the usual period from one fix to the next
_SHORTEST, _LONGEST = 0.9, 6.0  # s: duration of a step; the longest is for a vehicle too slow to be informative
_FLOOR = 0.6  # m: smallest standard deviation of displacement minus integral over 1 s; recorded flights: 0.1 to 0.5
_SLOW_BIAS = 0.25  # m/s: velocity bias of a slow receiver that lasts for seconds
_TIMING = 0.3  # s: time offset between position and velocity, filters in the receiver included
_STATED_MOST = 5.0  # m: limit of the stated deviation, because larger ones rarely mean a drift
_DRIFT = 0.8  # drift of the position in a step relative to its stated deviation
_COVERS = 2.0  # standard deviations of the noise of fixes that the tolerance covers
_SHORT = 0.5  # s: over longer periods an acceleration looks like scatter
_DENSE = 1.2  # s: over longer periods the integral misses curves of the path
_FADING = 0.1  # weight of the newest value in the mean of the scatter
_INFORMATIVE = 4.0  # tolerances: shorter steps do not discriminate between hypotheses


class Step(NamedTuple):
    """Displacement and integrated velocity from one fix to another."""

    begin: float  # s
    end: float  # s
    displacement: complex  # m: displacement between the fixes
    integral: complex  # m: integral of the velocities
    velocity_change: float
    """m/s: change of the velocity."""
    floor: float
    """m: standard deviation of displacement minus integral, independent of the motion."""
    timing: float
    """m: additional standard deviation because of the change of velocity and the time offset."""
    all_same: bool
    """Whether the velocity was the same to the last digit."""
    silent: tuple[bool, bool]
    """Whether East and North were zero to the last digit."""
    dense: bool = True
    """Whether the velocities were frequent enough for an accurate integral."""

    @property
    def weight(self) -> float:
        """Information of the step, from 0 (none) to 1 (long enough to discriminate between all hypotheses)."""
        return min(max(abs(self.displacement), abs(self.integral)) / (_INFORMATIVE * self.floor), 1.0) ** 2

    @property
    def misfit(self) -> float:
        """Difference of displacement and integral as a speed [m/s]."""
        return abs(self.displacement - self.integral) / (self.end - self.begin)


# --- the state of a ``StepMaker``: index of each quantity, with its size if that is not 1 ----------------------------
_LAT, _LON, _BEGIN = 0, 1, 2  # rad, rad, s: first fix of the step in progress; NaN while there is none
_T = 3  # s: time of the last fix
_FIRST, _LAST = 4, 6  # (2), (2) m/s: velocities of the first and the last fix, East and North
_DISPLACEMENT, _INTEGRAL = 8, 10  # (2), (2) m: displacement since the first fix, by fixes and by integrated velocities
_LONGEST_PERIOD = 12  # s: longest time between fixes of the step
_ALL_SAME, _SILENT = 13, 14  # (1), (2): 1 while all velocities are identical, and while East and North are zero; else 0
_MOVED = 16  # (2) m: displacement between the last two fixes; NaN where these are far apart in time
_PERIOD = 18  # s: recent shortest time between fixes
VARIANCE = 19  # m^2: variance of a fix on each axis, from second differences
_STATED = 20  # m: stated deviation of the last fix; a receiver that still converges drifts by as much
_COUNT = 21  # number of velocities since the last interruption
WALK = 22  # m/sqrt(s): random walk of the integrated velocities that is not stated
_SIZE = 23
_KEPT = 40  # velocities that are kept


@dataclass(eq=False, slots=True)
class StepMaker:
    """Makes steps from velocities and usable fixes; a fix may end a step."""

    state: NDArray[np.float64] = field(init=False)
    """State of ``take_velocity`` and ``take_fix``."""
    velocities: NDArray[np.float64] = field(default_factory=lambda: np.empty((_KEPT, 4)), init=False)
    """Their rows: time [s] and velocity [m/s], ENU; the oldest one is replaced."""

    def __post_init__(self) -> None:
        self.state = np.zeros(_SIZE)
        self.state[_PERIOD] = math.inf
        self.interrupt()

    def interrupt(self) -> None:
        """End the step in progress: the next samples do not follow the last ones."""
        self.state[_BEGIN] = self.state[_MOVED] = math.nan
        self.state[_COUNT] = 0.0

    def end(self, t: float, lat: float, lon: float) -> Step:
        """The step that a fix at ``t`` [s] and ``lat``, ``lon`` [rad] has ended; the next one begins there."""
        done = _step(self.state)
        _begin(self.state, t, lat, lon, self.state[_LAST], self.state[_LAST + 1])
        return done

    def floor(self, seconds: float) -> float:
        """Standard deviation [m] of displacement minus integral over so many seconds, independent of the motion."""
        return float(_floor(self.state, seconds))


@kernel
def take_velocity(state, velocities, t, east, north, up):
    """Add a velocity [m/s] valid at ``t`` [s]."""
    row = int(state[_COUNT]) % len(velocities)
    velocities[row, 0], velocities[row, 1], velocities[row, 2], velocities[row, 3] = t, east, north, up
    state[_COUNT] += 1.0


@kernel
def own_velocity(state, velocities, t):
    """Row in ``velocities`` of a fix at ``t`` [s]; -1 where none is close in time."""
    received, count = int(state[_COUNT]), len(velocities)
    if received > 0 and velocities[(received - 1) % count, 0] == t:  # nearly always
        return (received - 1) % count
    own, least = -1, _APART
    for i in range(max(received - count, 0), received):
        apart = abs(velocities[i % count, 0] - t)
        if apart < least or (own < 0 and apart == least):
            own, least = i % count, apart
    return own


@kernel
def take_fix(state, velocities, own, t, lat, lon, sd):
    """Add a position [rad, rad] with stated ``sd`` [m] and the row ``own`` of its velocity; True where a step ends."""
    state[_STATED] = min(sd, _STATED_MOST)
    if own < 0:
        state[_BEGIN] = state[_MOVED] = math.nan
        return False
    east, north = velocities[own, 1], velocities[own, 2]
    if math.isnan(state[_BEGIN]) or _is_outage(state, t - state[_T]):
        _begin(state, t, lat, lon, east, north)
        return False
    full_turn = 2.0 * math.pi
    longitudes = lon - state[_LON]
    longitudes -= full_turn * round(longitudes / full_turn)
    period = t - state[_T]
    _update_displacement(state, _EARTH * math.cos(state[_LAT]) * longitudes, _EARTH * (lat - state[_LAT]), period)
    _integrate(state, 0, east, period)
    _integrate(state, 1, north, period)
    state[_T], state[_LONGEST_PERIOD] = t, max(state[_LONGEST_PERIOD], period)
    seconds = t - state[_BEGIN]
    moved = max(
        math.hypot(state[_DISPLACEMENT], state[_DISPLACEMENT + 1]), math.hypot(state[_INTEGRAL], state[_INTEGRAL + 1])
    )
    return seconds >= _SHORTEST and (moved >= _INFORMATIVE * _floor(state, seconds) or seconds >= _LONGEST)


@kernel
def _is_outage(state, period):
    """Whether fixes have paused: the return after a pause is tested by the guard, not by velocities."""
    usual = state[_PERIOD]
    state[_PERIOD] = min(period, _SLOWER * usual)
    return period > min(max(_PAUSES * usual, _SHORTEST_PAUSE), _PAUSE)


@kernel
def _begin(state, t, lat, lon, east, north):
    """Begin a step at a fix with the velocity ``east``, ``north`` [m/s]."""
    state[_LAT], state[_LON], state[_BEGIN], state[_T] = lat, lon, t, t
    state[_FIRST] = state[_LAST] = east
    state[_FIRST + 1] = state[_LAST + 1] = north
    for i in range(_DISPLACEMENT, _ALL_SAME):
        state[i] = 0.0
    for i in range(_ALL_SAME, _MOVED):
        state[i] = 1.0


@kernel
def _update_displacement(state, east, north, period):
    """Take a fix, and update the variance of fixes from second differences, which is six times that of white noise."""
    moved_east, moved_north = east - state[_DISPLACEMENT], north - state[_DISPLACEMENT + 1]
    state[_DISPLACEMENT], state[_DISPLACEMENT + 1] = east, north
    if period > _SHORT:
        state[_MOVED] = math.nan
        return
    if not math.isnan(state[_MOVED]):
        square = (moved_east - state[_MOVED]) ** 2 + (moved_north - state[_MOVED + 1]) ** 2
        state[VARIANCE] += _FADING * (square / 12.0 - state[VARIANCE])
    state[_MOVED], state[_MOVED + 1] = moved_east, moved_north


@kernel
def _integrate(state, axis, velocity, period):
    """Take a velocity of one axis [m/s], ``period`` [s] after the last one."""
    state[_INTEGRAL + axis] += 0.5 * period * (state[_LAST + axis] + velocity)
    state[_LAST + axis] = velocity
    if velocity != state[_FIRST + axis]:
        state[_ALL_SAME] = 0.0
    if velocity != 0.0:
        state[_SILENT + axis] = 0.0


@kernel
def _floor(state, seconds):
    """``StepMaker.floor``."""
    noise = max(_FLOOR, _COVERS * math.sqrt(2.0 * state[VARIANCE]), _DRIFT * state[_STATED])
    noise += _COVERS * state[WALK] * math.sqrt(seconds)
    return noise + _SLOW_BIAS * max(seconds - 1.0, 0.0)


def _step(state: NDArray[np.float64]) -> Step:
    """The step that has just ended."""
    s = state.tolist()
    seconds = s[_T] - s[_BEGIN]
    velocity_change = math.hypot(s[_LAST] - s[_FIRST], s[_LAST + 1] - s[_FIRST + 1])
    return Step(
        begin=s[_BEGIN],
        end=s[_T],
        displacement=complex(s[_DISPLACEMENT], s[_DISPLACEMENT + 1]),
        integral=complex(s[_INTEGRAL], s[_INTEGRAL + 1]),
        velocity_change=velocity_change,
        floor=float(_floor(state, seconds)),
        timing=(_TIMING + 0.5 * max(s[_LONGEST_PERIOD] - _SHORT, 0.0)) * velocity_change,
        all_same=bool(s[_ALL_SAME]),
        silent=(bool(s[_SILENT]), bool(s[_SILENT + 1])),
        dense=s[_LONGEST_PERIOD] <= _DENSE,
    )
