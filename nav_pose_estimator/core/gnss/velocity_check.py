"""Does a receiver's velocity say where its positions go? If not, which usual mistake would explain it?

Over a second or so the sum of the velocities must be the way between the fixes. As complex numbers, East + i North, the
usual mistakes are linear: ``way = a said + b conj(said)``. North and East exchanged are b = i, an axis of the wrong sign
is b = 1 or -1, a turn by an angle is a = exp(i angle), a unit is a real ``a``. Body axes keep the length and lose the
direction. Every step multiplies the odds of each mistake against a sound velocity by the ratio of their likelihoods
(sequential probability ratio test; A. Wald, Annals of Mathematical Statistics 16(2), 1945), limited so that one blunder
proves nothing, and that what was sound for an hour can be found out within seconds.

Whether velocity or position is at fault cannot be told from the two alone. Pure Python, without a clock: time comes with
the samples, in seconds since the engine's epoch.
"""

from __future__ import annotations

import cmath
import math
from collections import deque
from dataclasses import dataclass, field
from itertools import combinations
from typing import NamedTuple

from nav_pose_estimator.core.gnss.climb_check import ClimbCheck
from nav_pose_estimator.core.gnss.lateness import Lateness, Stretch

_EARTH = 6.371e6  # m
_APART = 0.3  # s: a velocity farther from a fix in time is not its own
_PAUSE = 6.0  # s: over a longer one nothing can be summed up
_STEP, _LONGEST = 0.9, 6.0  # s: the shortest step, and the longest of a vehicle that is too slow to show anything
_FLOOR = 0.6  # m by which way and sum differ in a second, at least; recorded flights: 0.1 to 0.5 (rms)
_SLOW_BIAS = 0.25  # m/s by which the velocity of a slow antenna is wrong for seconds
_TIMING = 0.3  # s between the clocks of position and velocity, filters of receivers included
_SCALE = 0.1  # of the way: coarse sampling, reflections
_STATED = 5.0  # m: of more than that a receiver only seldom means its drift
_DRIFT = 0.8  # of a stated deviation a receiver may drift in a step
_COVERS = 2.0  # deviations of fixes that scatter
_SHORT = 0.5  # s: over a longer one an acceleration looks like scatter
_FADING = 0.1  # share of the newest in the mean of the scatter
_WORST = 25.0  # squared deviations: a worse step says no more
_EXPLAINED = 5.0  # ... within which a mistake has to explain a step for which it is to be blamed
_PRIOR, _SUSPECT, _PROVED, _MOST = -10.0, 5.0, 20.0, 45.0  # twice the logarithm of the odds of a mistake
_CLEARED = 0.0
_STANDS = 3.0  # of which a step takes off where nothing moves: no suspicion outlasts a stand
_ALONE = 12.0  # by which the odds of one mistake exceed those of all others where it may be undone
_INFORMATIVE = 4.0  # floors: of a shorter step every hypothesis says the same
_ANYWHERE, _NEAR = 40.0, 15.0  # m: how far the way of a step leads that has nothing to do with what was said
_LEARNS = 1.5  # steps of which the similarity between way and sum is known well enough to predict with
_KNOWN = 5.0  # ... well enough to undo it
_UNLIKE = 0.2  # of a similarity that differs from that of a sound velocity
_OTHER_WAY = math.radians(45.0)
_MEMORY = 0.93  # of the similarity, from step to step
_SCALE_SURE = 0.03, 3.0  # of the way, and deviations, by which a scale has to differ from 1

NED, TURNED, SILENT, UNIT, UNEXPLAINED = "ned", "turned", "silent", "unit", "unexplained"
"""Kinds of mistakes. North-East-Down; axes turned, mirrored or the body's; zero while the vehicle travels; right axes, but
another unit; anything else."""

_AXES = {"West-North": -1.0, "East-South": 1.0, "South-West": -1.0j, "North-East": 1.0j}
_TURNS = {"West-South": -1.0, "North-West": 1.0j, "South-East": -1.0j}
_UNITS = {"knots": 1.944, "mph": 2.237, "ft/s": 3.281, "km/h": 3.6, "cm/s": 100.0, "mm/s": 1000.0}
"""Numbers in that unit for 1 m/s."""


class Mistake(NamedTuple):
    """``way = a said + b conj(said)``, and what to call it."""

    kind: str
    name: str
    a: complex
    b: complex


MISTAKES = (
    *(Mistake(NED if name == "North-East" else TURNED, name, 0.0, b) for name, b in _AXES.items()),
    *(Mistake(TURNED, name, a, 0.0) for name, a in _TURNS.items()),
    *(Mistake(UNIT, name, 1.0 / numbers, 0.0) for name, numbers in _UNITS.items()),
    Mistake(UNIT, "57 times m/s", 1.0 / 57.3, 0.0),
)
_BODY, _STUCK, _LIKE, _ANY = (len(MISTAKES) + i for i in range(4))
_COUNT = len(MISTAKES) + 4


@dataclass(frozen=True, slots=True)
class _Epoch:
    t: float
    place: complex  # m
    velocity: complex


@dataclass
class _Step:
    """From one fix on."""

    lat: float
    lon: float
    first: _Epoch
    last: _Epoch
    said: complex = 0j
    longest: float = 0.0  # s between fixes
    all_same: bool = True
    silent: tuple[bool, bool] = (True, True)
    """Whether East and North are zero to the last digit."""


@dataclass(eq=False)
class VelocityCheck:
    """Offer it every usable fix and every velocity.

    ``fault`` is the kind of mistake that is proved, or empty, and ``name`` which one; ``suspect`` while a mistake is
    likelier than none; ``certain`` once it is told from all others, so that it can be undone (``mended``).
    """

    fault: str = field(default="", init=False)
    name: str = field(default="", init=False)
    suspect: bool = field(default=False, init=False)
    certain: bool = field(default=False, init=False)
    misfit: float = field(default=0.0, init=False)
    """Speed [m/s] by which sum and way differed in the last step of which anything can be said."""
    sound_steps: int = field(default=0, init=False)
    """Steps that did not contradict a sound velocity, since the last one that did."""
    felt: bool = field(default=False, init=False)
    """To be set: whether an IMU feels what the velocity says. What is unexplained is the positions' fault then."""
    climb: ClimbCheck = field(default_factory=ClimbCheck, init=False)
    late: Lateness = field(default_factory=Lateness, init=False)
    _odds: list[float] = field(default_factory=lambda: [_PRIOR] * _COUNT, init=False)
    _found: int = field(default=-1, init=False)
    _velocities: deque[tuple[float, float, float, float]] = field(default_factory=lambda: deque(maxlen=40), init=False)
    _filled: tuple[bool, bool] = field(default=(False, False), init=False)  # East and North have been other than zero
    _waiting: tuple[float, float, float, float] | None = field(default=None, init=False)
    _step: _Step | None = field(default=None, init=False)
    _recent: deque[complex] = field(default_factory=lambda: deque(maxlen=3), init=False)
    _variance: float = field(default=0.0, init=False)  # m^2 of a fix on each axis, by second differences
    _stated: float = field(default=0.0, init=False)  # m: a receiver that still converges drifts by what it states
    _cross: complex = field(default=0j, init=False)  # m^2: ways times sums, and sums squared, that fade
    _power: float = field(default=0.0, init=False)
    _steps: float = field(default=0.0, init=False)
    _ways: deque[complex] = field(default_factory=lambda: deque(maxlen=12), init=False)
    _along: float = field(default=0.0, init=False)  # m^2: the same of all steps that agreed, for the scale
    _square: float = field(default=0.0, init=False)

    @property
    def scale(self) -> float:
        """Way between fixes in parts of what velocities say, where that is surely not 1; else 1.0.

        Time is the only thing that all the velocities of a receiver can share an error in: a clock that stamps 8 % too
        few seconds makes the way 8 % longer.
        """
        if self._square == 0.0:
            return 1.0
        least, deviations = _SCALE_SURE
        scale, sd = self._along / self._square, 2.0 * self._floor(1.0) / math.sqrt(self._square)
        return scale if abs(scale - 1.0) > least + deviations * sd else 1.0

    @property
    def similarity(self) -> complex:
        """Way over sum of the last steps: its length is a scale, its argument the angle [rad] to turn the sum by."""
        return self._cross / self._power if self._power > 0.0 else 1.0

    def forget_time(self) -> None:
        """The clock is another one, or the filter starts again: forget samples, keep what they have proved."""
        self._velocities.clear()
        self._recent.clear()
        self._waiting = self._step = None
        self.climb.interrupt()
        self.late.interrupt()
        if not self.fault:
            self.suspect, self._odds = False, [_PRIOR] * _COUNT

    def velocity(self, t: float, east: float, north: float, up: float) -> None:
        """A velocity [m/s] valid at ``t``, as the driver names its axes."""
        self._filled = self._filled[0] or east != 0.0, self._filled[1] or north != 0.0
        self._velocities.append((t - self.late.delay, east, north, up))
        self.climb.velocity(east, north, up)
        self.late.velocity(t, complex(east, north))

    def mended(self, east: float, north: float) -> tuple[float, float]:
        """A velocity without the mistake that is ``certain``."""
        said = complex(east, north)
        if self._found == _LIKE:
            said *= self.similarity
        elif self.fault == UNIT:
            said *= self.similarity.real
        else:
            mistake = MISTAKES[self._found]
            said = mistake.a * said + mistake.b * said.conjugate()
        return said.real, said.imag

    def fix(self, t: float, lat: float, lon: float, alt: float, sd: float = 0.0) -> None:
        """A position [rad, rad, m] valid at ``t`` with the horizontal deviation ``sd`` [m] that the receiver states.

        It counts once the next one is there, and so its own velocity.
        """
        self._stated = min(sd, _STATED)
        before, self._waiting = self._waiting, (t, lat, lon, alt)
        if before is None or not before[0] < t:
            return
        own = min(self._velocities, key=lambda v: abs(v[0] - before[0]), default=None)
        if own is None or abs(own[0] - before[0]) > _APART:
            self._step = None
            self._recent.clear()
            self.climb.interrupt()
            return
        self.climb.height(before[0], before[3], own[3], self._variance)
        self._add(before, complex(own[1], own[2]))

    def _add(self, fix: tuple[float, float, float, float], velocity: complex) -> None:
        t, lat, lon, _ = fix
        step = self._step
        if step is None or t - step.last.t > _PAUSE:
            self._begin(t, lat, lon, velocity)
            return
        east = _EARTH * math.cos(step.lat) * math.remainder(lon - step.lon, 2.0 * math.pi)
        epoch = _Epoch(t, complex(east, _EARTH * (lat - step.lat)), velocity)
        period = t - step.last.t
        self._watch_scatter(epoch.place - step.last.place, period)
        step.said += 0.5 * period * (step.last.velocity + velocity)
        step.longest, step.last = max(step.longest, period), epoch
        step.all_same = step.all_same and velocity == step.first.velocity
        step.silent = step.silent[0] and velocity.real == 0.0, step.silent[1] and velocity.imag == 0.0
        seconds, moved = t - step.first.t, max(abs(epoch.place), abs(step.said))
        if seconds >= _STEP and (moved >= _INFORMATIVE * self._floor(seconds) or seconds >= _LONGEST):
            self._weigh(step)
            self._begin(t, lat, lon, velocity)

    def _begin(self, t: float, lat: float, lon: float, velocity: complex) -> None:
        first = _Epoch(t, 0.0, velocity)
        self._step = _Step(lat, lon, first, first)

    def _floor(self, seconds: float) -> float:
        """By which way and sum of a step differ whatever the motion [m]."""
        noise = max(_FLOOR, _COVERS * math.sqrt(2.0 * self._variance), _DRIFT * self._stated)
        return noise + _SLOW_BIAS * max(seconds - 1.0, 0.0)

    def _watch_scatter(self, moved: complex, period: float) -> None:
        """White errors of fixes show in their second differences, whose variance is six times theirs."""
        if period > _SHORT:
            self._recent.clear()
            return
        if self._recent:
            square = abs(moved - self._recent[-1]) ** 2
            self._variance += _FADING * (square / 12.0 - self._variance)
        self._recent.append(moved)

    def _weigh(self, step: _Step) -> None:
        """Let a step speak for and against every mistake."""
        way, said, seconds = step.last.place, step.said, step.last.t - step.first.t
        floor = self._floor(seconds)
        timing = (_TIMING + 0.5 * max(step.longest - _SHORT, 0.0)) * abs(step.last.velocity - step.first.velocity)
        weight = min(max(abs(way), abs(said)) / (_INFORMATIVE * floor), 1.0) ** 2
        own = _fit(way, said, floor, timing)
        if weight > 0.5:
            self.misfit = abs(way - said) / seconds
            self._learn(way, said, own)
            turn = abs(step.last.velocity - step.first.velocity)
            if not self.fault and not self.suspect:
                self.late.stretch(Stretch(step.first.t, step.last.t, way, floor, turn))
        for i, fit in enumerate(self._fits(step, floor, timing)):
            gain = own.cost - fit.cost
            gain = weight * (gain if fit.square < _EXPLAINED else min(gain, 0.0))
            self._odds[i] += gain - (0.0 if i == self._found else _STANDS * (1.0 - weight))
        beyond = max(max(self._odds) - _MOST, 0.0)
        self._odds = [max(odds - beyond, _PRIOR) for odds in self._odds]
        self._conclude()

    def _fits(self, step: _Step, floor: float, timing: float) -> list[_Fit]:
        """How well every mistake explains a step."""
        way, said = step.last.place, step.said
        fits = [
            _fit(way, m.a * said + m.b * said.conjugate(), floor, abs(m.a + m.b) * timing) for m in MISTAKES
        ]
        variance = _variance(way, said, floor, timing)
        square = (abs(way) - abs(said)) ** 2 / variance
        around = max(abs(said), math.sqrt(variance / (2.0 * math.pi)))
        body = min(square, _WORST) + math.log(2.0 * math.pi * variance) + 2.0 * math.log(2.0 * math.pi * around)
        fits.append(_Fit(square, body))
        fits.append(_stuck(step, variance))
        if self._steps > _LEARNS and abs(self.similarity - 1.0) > _UNLIKE < abs(self.similarity):
            fits.append(_fit(way, self.similarity * said, floor, abs(self.similarity) * timing))
        else:
            fits.append(_Fit(math.inf, math.inf))
        return [*fits, _Fit(0.0, _spread(way, _ANYWHERE))]

    def _learn(self, way: complex, said: complex, own: _Fit) -> None:
        self._cross = _MEMORY * self._cross + way * said.conjugate()
        self._power = _MEMORY * self._power + abs(said) ** 2
        self._steps = _MEMORY * self._steps + 1.0
        if way:
            self._ways.append(way)
        if own.square < _EXPLAINED:
            self._along += (way * said.conjugate()).real
            self._square += abs(said) ** 2

    def _conclude(self) -> None:
        odds = [value if self._may_be(i) else _PRIOR for i, value in enumerate(self._odds)]
        best = max(range(_COUNT), key=lambda i: odds[i])
        self.suspect = odds[best] > (_CLEARED if self.suspect else _SUSPECT)
        if self.suspect:
            self.late.interrupt()
        self.sound_steps = 0 if self.suspect or self.fault else self.sound_steps + 1
        if self.fault and odds[self._found] <= _CLEARED and not self.suspect:
            self.fault, self.name, self.certain, self._found = "", "", False, -1
        if odds[best] > _PROVED and (not self.fault or odds[best] > odds[self._found] + _SUSPECT):
            self._found = best
            self.fault, self.name = self._words(best)
        if self.fault:
            undone = self._found < len(MISTAKES) or (self._found == _LIKE and self._has_turned)
            others = max(value for i, value in enumerate(odds) if not self._is_like_found(i))
            undone = undone and all(self._filled)
            self.certain = undone and self._steps > _KNOWN and odds[self._found] - others > _ALONE

    def _is_like_found(self, i: int) -> bool:
        """Whether a mistake is undone in the same way as the one found, or says nothing."""
        if i in (self._found, _ANY, _LIKE):
            return True
        if i >= len(MISTAKES) or self._found == _STUCK or self._found == _BODY:
            return False
        if self._found == _LIKE:
            return MISTAKES[i].b == 0.0 and abs(MISTAKES[i].a - self.similarity) < _UNLIKE
        return MISTAKES[i].kind == UNIT == self.fault

    @property
    def _has_turned(self) -> bool:
        """Whether the last steps have led in ways different enough to tell one angle for all of them."""
        return any(abs(cmath.phase(a / b)) > _OTHER_WAY for a, b in combinations(self._ways, 2))

    def _may_be(self, i: int) -> bool:
        """An IMU that feels what the velocity says leaves the blame for the unexplained with the positions."""
        return not (self.felt and i == _ANY)

    def _words(self, i: int) -> tuple[str, str]:
        if i < len(MISTAKES):
            return MISTAKES[i].kind, MISTAKES[i].name
        if i == _LIKE:
            size, angle = cmath.polar(self.similarity)
            if abs(angle) > _UNLIKE:
                return TURNED, f"turned by {abs(math.degrees(angle)):.0f} deg"
            return UNIT, f"{1.0 / size:.2g} times m/s"
        if i == _STUCK:
            east, north = self._velocities[-1][1:3]
            return SILENT, "repeats" if east and north else "East" if north else "North" if east else ""
        return (TURNED, "body") if i == _BODY else (UNEXPLAINED, "")


class _Fit(NamedTuple):
    """By how many squared deviations a prediction is off, and minus twice its log-likelihood."""

    square: float
    cost: float


def _fit(way: complex, predicted: complex, floor: float, timing: float) -> _Fit:
    variance = _variance(way, predicted, floor, timing)
    square = abs(way - predicted) ** 2 / variance
    return _Fit(square, min(square, _WORST) + 2.0 * math.log(2.0 * math.pi * variance))


def _stuck(step: _Step, variance: float) -> _Fit:
    """The same velocity again and again says nothing; an axis that is always zero leaves the other one."""
    way, apart = step.last.place, step.last.place - step.said
    if step.all_same:
        return _Fit(0.0, _spread(way, _NEAR))
    if not any(step.silent):
        return _Fit(math.inf, math.inf)
    square = (apart.imag if step.silent[0] else apart.real) ** 2 / variance
    cost = min(square, _WORST) + math.log(2.0 * math.pi * variance) + 2.0 * math.log(2.0 * max(_NEAR, abs(way)))
    return _Fit(square, cost)


def _variance(way: complex, predicted: complex, floor: float, timing: float) -> float:
    return floor**2 + (_SCALE * max(abs(way), abs(predicted))) ** 2 + timing**2


def _spread(way: complex, radius: float) -> float:
    """Minus twice the log-likelihood of a way that may lead anywhere within ``radius`` [m], or where it does."""
    return 2.0 * math.log(math.pi * max(radius, abs(way)) ** 2)
