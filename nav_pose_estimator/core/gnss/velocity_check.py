"""Does a receiver's velocity say where its positions go? Tells axes other than East-North-Up, and values never filled.

Over a stretch of a few seconds the sum of the velocities must be the way between the fixes. Where it is not, but would
be with North and East exchanged, the velocity is North-East-Down; where only the length fits, its axes are turned, as
those of the body are. A disagreement that none of this explains says nothing of the velocity: the position may lie.
Pure Python, without a clock: time comes with the samples, in seconds since the engine's epoch.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from itertools import pairwise

_EARTH = 6.371e6  # m
_APART = 0.3  # s: a velocity farther from a fix in time is not its own
_PAUSE = 6.0  # s: over a longer one nothing can be summed up
_SHORTEST = 1.5  # s of a stretch
_LONGEST = 12.0  # s: a slower vehicle shows nothing
_WAY = 6.0  # m: of a shorter one the scatter of fixes hides too much
_SCATTER = 2.0  # m between two fixes seconds apart, at least
_STATED = 5.0  # m: of more than that a receiver only seldom means its drift
_COVERS = 4.0  # deviations of a fix, three of a difference between two
_SHORT = 0.5  # s: over a longer one an acceleration looks like scatter
_FADING = 0.1  # share of the newest in the mean of the scatter
_WAY_TO_SCATTER = 3.0
_WAY_TO_STATED = 2.0
_SHARE = 0.3  # of the way that honest sums are wrong by: coarse sampling, scale, reflections
_PROOF = 2  # stretches in a row that prove it
_OTHER_WAY = math.radians(45.0)  # two stretches in such directions tell a reflection from any rotation
_CURE = 3  # ... that clear it
_UNFILLED = 10  # samples with a vertical velocity of exactly zero, and none before with another
_STEEPEST = 60.0  # m/s
_CLIMB = 6.0  # m of height after which vertical sums are compared

_SCALE, _SURE = 0.03, 3.0  # of the way, and deviations, by which a scale has to differ from 1

_UNITS = {"knots": 1.944, "mph": 2.237, "ft/s": 3.281, "km/h": 3.6, "cm/s": 100.0, "mm/s": 1000.0}
"""Numbers in that unit for 1 m/s."""
_LIKE = 0.12  # of the logarithm, by which a ratio may differ from a unit's
_ALONG = 0.9  # cosine: sum and way point the same way

NED, TURNED, SILENT, DOWN, UNIT = "ned", "turned", "silent", "down", "unit"
"""Wrong axes, by name: North-East-Down; turned by some angle, as body axes are; zero while the vehicle travels; right
axes, but another unit than m/s.
A vertical velocity alone may be ``SILENT`` or positive ``DOWN``."""


@dataclass(frozen=True, slots=True)
class _Epoch:
    t: float
    place: tuple[float, float]  # m East, North
    velocity: tuple[float, float]


@dataclass
class _Climb:
    t: float
    up: float
    alt: float  # m
    start: float  # m
    summed: float = 0.0


@dataclass(eq=False)
class VelocityCheck:
    """Offer it every usable fix and every velocity.

    ``fault`` is what is proved to be wrong with the velocity's axes, or empty; ``suspect`` while the last stretch
    contradicted it and the vehicle moves, ``certain`` once North-East-Down is told from body axes, which a straight
    flight does not do.
    """

    fault: str = field(default="", init=False)
    suspect: bool = field(default=False, init=False)
    certain: bool = field(default=False, init=False)
    vertical_fault: str = field(default="", init=False)
    vertical_suspect: bool = field(default=False, init=False)
    """Whether the vertical velocity has been exactly zero from the beginning while the others were not."""
    unit: str = field(default="", init=False)
    """That fits where the fault is ``UNIT``."""
    misfit: float = field(default=0.0, init=False)
    """Speed [m/s] by which sums and ways differed in the last stretch."""
    _velocities: deque[tuple[float, float, float, float]] = field(default_factory=lambda: deque(maxlen=40), init=False)
    _ordered: int = field(default=0, init=False)  # so many of the last ones came in order of time
    _waiting: tuple[float, float, float, float] | None = field(default=None, init=False)
    _zero: tuple[float, float] = field(default=(0.0, 0.0), init=False)  # lat, lon of the stretch's first fix
    _epochs: list[_Epoch] = field(default_factory=list, init=False)
    _verdicts: tuple[str, ...] = field(default=(), init=False)
    _ned_ways: list[float] = field(default_factory=list, init=False)
    _zeros: float = field(default=0.0, init=False)
    _agreed: bool = field(default=False, init=False)
    _variance: float = field(default=0.0, init=False)  # m^2 of a fix on each axis, by second differences
    _stated: float = field(default=0.0, init=False)  # m: a receiver that still converges drifts by what it states
    _along: float = field(default=0.0, init=False)  # m^2: ways times sums, and sums squared, of all that agreed
    _square: float = field(default=0.0, init=False)
    _climb: _Climb | None = field(default=None, init=False)
    _climbs: tuple[str, ...] = field(default=(), init=False)

    @property
    def scale(self) -> float:
        """Way between fixes in parts of what velocities say, where that is surely not 1; else 1.0.

        Time is the only thing that all the velocities of a receiver can share an error in: a clock that stamps 8 % too
        few seconds makes the way 8 % longer.
        """
        if self._square == 0.0:
            return 1.0
        scale, sd = self._along / self._square, self._scatter / math.sqrt(self._square)
        return scale if abs(scale - 1.0) > _SCALE + _SURE * sd else 1.0

    def forget_time(self) -> None:
        """The clock is another one, or the filter starts again: forget samples, keep what they have proved."""
        self._velocities.clear()
        self._epochs.clear()
        self._waiting = self._climb = None
        if not self.fault:
            self.suspect, self._verdicts = False, ()

    def velocity(self, t: float, east: float, north: float, up: float) -> None:
        """A velocity [m/s] valid at ``t``, as the driver names its axes."""
        self._ordered = self._ordered + 1 if self._velocities and t >= self._velocities[-1][0] else 1
        self._velocities.append((t, east, north, up))
        if up != 0.0:
            self._zeros, self.vertical_suspect = math.inf, False  # it is filled
        elif east != 0.0 and north != 0.0 and self._zeros < math.inf:
            self._zeros += 1
            self.vertical_suspect = self._zeros >= _UNFILLED

    def fix(self, t: float, lat: float, lon: float, alt: float, sd: float = 0.0) -> None:
        """A position [rad, rad, m] valid at ``t`` with the horizontal deviation ``sd`` [m] that the receiver states.

        It counts once the next one is there, and so its own velocity.
        """
        self._stated = min(sd, _STATED)
        before, self._waiting = self._waiting, (t, lat, lon, alt)
        if before is None or not before[0] < t:
            return
        own = self._nearest_velocity(before[0])
        if own is None or abs(own[0] - before[0]) > _APART:
            self._epochs.clear()
            self._climb = None
            return
        self._climb_on(before[0], before[3], own[3])
        if not self._epochs:
            self._zero = before[1:3]
        lat, lon = self._zero
        east = _EARTH * math.cos(lat) * math.remainder(before[2] - lon, 2.0 * math.pi)
        self._add(_Epoch(before[0], (east, _EARTH * (before[1] - lat)), (own[1], own[2])))

    def _nearest_velocity(self, t: float) -> tuple[float, float, float, float] | None:
        """The one nearest in time, of two as near the earlier one to arrive; None without any."""
        best, least = None, math.inf
        for velocity in reversed(self._velocities):
            apart = abs(velocity[0] - t)
            if apart <= least:
                best, least = velocity, apart
            elif velocity[0] < t and self._ordered >= len(self._velocities):
                break  # those that arrived before it are older still
        return best

    def _add(self, epoch: _Epoch) -> None:
        epochs = self._epochs
        if epochs and epoch.t - epochs[-1].t > _PAUSE:
            epochs.clear()
        epochs.append(epoch)
        self._watch_scatter()
        seconds = epoch.t - epochs[0].t
        if seconds < _SHORTEST:
            return
        way = epoch.place[0] - epochs[0].place[0], epoch.place[1] - epochs[0].place[1]
        said = _sum(epochs)
        least = max(_WAY, _WAY_TO_SCATTER * self._scatter, _WAY_TO_STATED * self._stated)
        went = math.hypot(*way)
        if went >= least or (math.hypot(*said) >= least and (seconds >= _LONGEST or not _may_be_unit(way, said))):
            verdict = _verdict(way, said, max(self._scatter, self._stated))
            self.unit = _unit(way, said) or self.unit
            self._conclude(verdict, math.atan2(way[1], way[0]))
            if not verdict:
                self._along += way[0] * said[0] + way[1] * said[1]
                self._square += said[0] ** 2 + said[1] ** 2
            self.misfit = math.dist(way, said) / seconds
        elif seconds < _LONGEST:
            return
        elif not self.vertical_fault:
            self.suspect = False  # hardly moving, it is as slow in any axes; nothing may come for minutes to clear it
        lat, lon = self._zero
        self._zero = lat + epoch.place[1] / _EARTH, lon + epoch.place[0] / (_EARTH * math.cos(lat))
        self._epochs = [_Epoch(epoch.t, (0.0, 0.0), epoch.velocity)]

    @property
    def _scatter(self) -> float:
        return max(_SCATTER, _COVERS * math.sqrt(self._variance))

    def _watch_scatter(self) -> None:
        """White errors of fixes show in their second differences, whose variance is six times theirs."""
        if len(self._epochs) < 3 or self._epochs[-1].t - self._epochs[-2].t > _SHORT:
            return
        a, b, c = (epoch.place for epoch in self._epochs[-3:])
        square = math.hypot(a[0] - 2.0 * b[0] + c[0], a[1] - 2.0 * b[1] + c[1]) ** 2
        self._variance += _FADING * (square / 12.0 - self._variance)

    def _climb_on(self, t: float, alt: float, up: float) -> None:
        """Compare the height gained with the sum of the vertical velocities."""
        climb = self._climb
        if not (math.isfinite(alt) and math.isfinite(up)) or climb is None or t - climb.t > _PAUSE:
            self._climb = _Climb(t, up, alt, alt) if math.isfinite(alt) and math.isfinite(up) else None
            return
        if abs(alt - climb.alt) > _STEEPEST * (t - climb.t) + _SCATTER:
            self._climb = _Climb(t, up, alt, alt)  # heights that jump are no witness
            return
        climb.summed += 0.5 * (t - climb.t) * (climb.up + up)
        climb.t, climb.up, climb.alt = t, up, alt
        gained = alt - climb.start
        scatter = max(_SCATTER, 2.0 * _COVERS * math.sqrt(self._variance))  # heights scatter twice as much
        if max(abs(gained), abs(climb.summed)) < max(_CLIMB, _WAY_TO_SCATTER * scatter):
            return
        self._climb = _Climb(t, up, alt, alt)
        self._climbs = (*self._climbs, _vertical_verdict(gained, climb.summed, scatter))[-_CURE:]
        last = self._climbs[-_PROOF:]
        if len(last) == _PROOF and last[0] == last[1] and last[0] in (SILENT, DOWN):
            self.vertical_fault = last[0]
        elif len(self._climbs) == _CURE and not any(self._climbs):
            self.vertical_fault = ""
        if self._climbs[-1] == DOWN and not self._agreed:
            self.suspect = True  # whose vertical is wrong has given no proof of its other axes yet

    def _conclude(self, verdict: str, direction: float) -> None:
        self.suspect = verdict not in ("", "?")
        self._agreed = self._agreed or not verdict
        if verdict == NED:
            self._ned_ways = [*self._ned_ways, direction][-10:]
            self.certain = (
                any(abs(math.remainder(direction - a, 2.0 * math.pi)) > _OTHER_WAY for a in self._ned_ways)
                or DOWN in self._climbs
            )
        elif verdict != "?":
            self._ned_ways, self.certain = [], False
        self._verdicts = (*self._verdicts, verdict)[-_CURE:]
        last = self._verdicts[-_PROOF:]
        if len(last) == _PROOF and all(one not in ("", "?") for one in last):
            self.fault = last[0] if last[0] == last[1] else TURNED
        elif len(self._verdicts) == _CURE and not any(self._verdicts):
            self.fault = ""


def _sum(epochs: list[_Epoch]) -> tuple[float, float]:
    """Where the velocities lead, trapezoidal rule [m]."""
    x = y = 0.0
    for a, b in pairwise(epochs):
        half = 0.5 * (b.t - a.t)
        x += half * (a.velocity[0] + b.velocity[0])
        y += half * (a.velocity[1] + b.velocity[1])
    return x, y


def _verdict(way: tuple[float, float], said: tuple[float, float], scatter: float) -> str:
    """Empty where they agree, the fault that explains it, or a question mark."""
    went, summed = math.hypot(*way), math.hypot(*said)
    tolerance = scatter + _SHARE * max(went, summed)
    if math.dist(way, said) <= tolerance:
        return ""
    if math.dist(way, (said[1], said[0])) <= tolerance:
        return NED
    if summed < 0.1 * went:
        return SILENT
    if _unit(way, said):
        return UNIT
    return TURNED if abs(went - summed) <= tolerance else "?"


def _may_be_unit(way: tuple[float, float], said: tuple[float, float]) -> bool:
    """Whether the sum is so much longer that only a longer way tells why."""
    return math.hypot(*said) > 1.5 * math.hypot(*way)


def _unit(way: tuple[float, float], said: tuple[float, float]) -> str:
    """The unit that makes the sum the way, empty if none does."""
    went, summed, along = math.hypot(*way), math.hypot(*said), way[0] * said[0] + way[1] * said[1]
    if went == 0.0 or along < _ALONG * went * summed:
        return ""
    off = {name: abs(math.log(along / went**2 / numbers)) for name, numbers in _UNITS.items()}
    best = min(off, key=lambda name: off[name])
    return best if off[best] < _LIKE else ""


def _vertical_verdict(gained: float, summed: float, scatter: float) -> str:
    """As ``_verdict``, of a height [m]."""
    tolerance = scatter + _SHARE * max(abs(gained), abs(summed))
    if abs(gained - summed) <= tolerance:
        return ""
    if abs(gained + summed) <= tolerance:
        return DOWN
    return SILENT if abs(summed) < 0.1 * abs(gained) else "?"
