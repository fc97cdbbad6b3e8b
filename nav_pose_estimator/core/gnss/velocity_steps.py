"""Steps of a second or so: the way between fixes beside the sum of the velocities, and what they may differ by.

A vehicle that is slow takes longer steps. Pure Python, without a clock: time comes with the samples, in seconds since
the engine's epoch. Places are complex numbers, East + i North [m].
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

_EARTH = 6.371e6  # m
_APART = 0.3  # s: a velocity farther from a fix in time is not its own
_PAUSE = 6.0  # s: over a longer one nothing can be summed up
_PAUSES, _SHORTEST_PAUSE = 2.5, 1.0  # usual periods and s: a longer one is an outage as well
_SLOWER = 1.2  # by which the usual period grows from one fix to the next, at most
_SHORTEST, _LONGEST = 0.9, 6.0  # s of a step; the longest is that of a vehicle that is too slow to show anything
_FLOOR = 0.6  # m by which way and sum differ in a second, at least; recorded flights: 0.1 to 0.5 (rms)
_SLOW_BIAS = 0.25  # m/s by which the velocity of a slow antenna is wrong for seconds
_TIMING = 0.3  # s between the clocks of position and velocity, filters of receivers included
_STATED = 5.0  # m: of more than that a receiver only seldom means its drift
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


@dataclass(slots=True)
class _Open:
    """A step that goes on."""

    lat: float  # of its first fix
    lon: float
    begin: float
    first: complex  # velocity
    t: float  # the last one so far
    place: complex
    velocity: complex
    said: complex = 0j
    longest: float = 0.0  # s between fixes
    all_same: bool = True
    silent: tuple[bool, bool] = (True, True)


@dataclass(eq=False)
class StepMaker:
    """Offer it every velocity and every usable fix; a fix may end a step."""

    variance: float = field(default=0.0, init=False)
    """m^2 of a fix on each axis, by second differences."""
    _velocities: deque[tuple[float, complex, float]] = field(default_factory=lambda: deque(maxlen=40), init=False)
    _open: _Open | None = field(default=None, init=False)
    _moved: complex | None = field(default=None, init=False)  # between the last two fixes
    _period: float = field(default=math.inf, init=False)  # s between fixes, the shortest lately
    _stated: float = field(default=0.0, init=False)  # m: a receiver that still converges drifts by what it states

    def interrupt(self) -> None:
        """What comes next does not follow what came before."""
        self._velocities.clear()
        self._open = self._moved = None

    def velocity(self, t: float, velocity: complex, up: float) -> None:
        """A velocity [m/s] valid at ``t``."""
        self._velocities.append((t, velocity, up))

    def own(self, t: float) -> tuple[complex, float] | None:
        """The velocity, horizontal and vertical, that belongs to a fix at ``t``; None where none is near."""
        apart = [abs(one[0] - t) for one in self._velocities]
        least = min(apart, default=math.inf)
        return None if least > _APART else self._velocities[apart.index(least)][1:]

    def fix(self, t: float, lat: float, lon: float, sd: float, velocity: complex | None) -> Step | None:
        """A position [rad, rad] with its ``own`` velocity; ``sd`` [m] that is stated. The step that ends there."""
        self._stated = min(sd, _STATED)
        step = self._open
        if velocity is None:
            self._open = self._moved = None
            return None
        if step is None or self._is_outage(t - step.t):
            self._begin(t, lat, lon, velocity)
            return None
        east = _EARTH * math.cos(step.lat) * math.remainder(lon - step.lon, 2.0 * math.pi)
        place, period = complex(east, _EARTH * (lat - step.lat)), t - step.t
        self._watch_scatter(place - step.place, period)
        step.said += 0.5 * period * (step.velocity + velocity)
        step.t, step.place, step.velocity, step.longest = t, place, velocity, max(step.longest, period)
        step.all_same = step.all_same and velocity == step.first
        step.silent = step.silent[0] and velocity.real == 0.0, step.silent[1] and velocity.imag == 0.0
        done = self._done(step)
        if done is not None:
            self._begin(t, lat, lon, velocity)
        return done

    def _is_outage(self, period: float) -> bool:
        """Whether fixes have paused: where they go on, the guard of the return asks, and no velocity answers."""
        usual, self._period = self._period, min(period, _SLOWER * self._period)
        return period > min(max(_PAUSES * usual, _SHORTEST_PAUSE), _PAUSE)

    def _begin(self, t: float, lat: float, lon: float, velocity: complex) -> None:
        self._open = _Open(lat, lon, t, velocity, t, 0j, velocity)

    def _done(self, step: _Open) -> Step | None:
        seconds, moved = step.t - step.begin, max(abs(step.place), abs(step.said))
        floor = self.floor(seconds)
        if seconds < _SHORTEST or (moved < _INFORMATIVE * floor and seconds < _LONGEST):
            return None
        turn = abs(step.velocity - step.first)
        dense = step.longest <= _DENSE
        timing = (_TIMING + 0.5 * max(step.longest - _SHORT, 0.0)) * turn
        return Step(step.begin, step.t, step.place, step.said, turn, floor, timing, step.all_same, step.silent, dense)

    def floor(self, seconds: float) -> float:
        """By which way and sum differ over so many seconds whatever the motion [m]."""
        noise = max(_FLOOR, _COVERS * math.sqrt(2.0 * self.variance), _DRIFT * self._stated)
        return noise + _SLOW_BIAS * max(seconds - 1.0, 0.0)

    def _watch_scatter(self, moved: complex, period: float) -> None:
        """White errors of fixes show in their second differences, whose variance is six times theirs."""
        if period > _SHORT:
            self._moved = None
            return
        if self._moved is not None:
            self.variance += _FADING * (abs(moved - self._moved) ** 2 / 12.0 - self.variance)
        self._moved = moved
