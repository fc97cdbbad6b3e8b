"""Does a receiver's vertical velocity say how its height changes? And if not, which of the two is wrong?

Over a climb the sum of the vertical velocities must be the height gained. A barometer, where there is one, tells which
of them to blame: the velocity (never filled, positive down) or the height (in another unit, positive down). Pure
Python, without a clock: time comes with the samples, in seconds since the engine's epoch.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

_PAUSE = 6.0  # s: over a longer one nothing can be summed up
_LONGEST = 20.0  # s: in a slower climb biases of a decimetre per second count
_SCATTER = 2.0  # m between two heights seconds apart, at least
_SHARE = 0.3  # of the climb that honest sums are wrong by
_STEEPEST = 60.0  # m/s
_CLIMB = 6.0  # m of height after which vertical sums are compared
_CLIMB_TO_SCATTER = 3.0
_PROOF = 2  # climbs in a row that prove it
_CURE = 3  # ... that clear it
_UNFILLED = 10  # samples with a vertical velocity of exactly zero, and none before with another
_HIGH, _NO_WEATHER = 300.0, 500.0  # m above which weather is a part of the height; by which no weather changes it
_LIKE = 0.25  # by which a ratio may differ from a unit's

SILENT, DOWN, OTHER = "silent", "down", "other"
"""Of a velocity: never filled; positive down; wrong in another way, as the barometer shows."""
_NEITHER = "?"
_HEIGHT = "height"
_UNITS = {"in feet": 3.281, "in cm": 100.0, "in mm": 1000.0, "positive down": -1.0}
"""Numbers for 1 m."""


@dataclass
class _Climb:
    t: float
    up: float
    alt: float  # m
    start: float  # m
    baro_start: float  # m, NaN without one
    begin: float  # s
    summed: float = 0.0


@dataclass(eq=False)
class ClimbCheck:
    """Offer it every height with its vertical velocity.

    ``fault`` is what is proved to be wrong with the velocity, or empty; ``height_fault`` what is wrong with the height.
    """

    fault: str = field(default="", init=False)
    height_fault: str = field(default="", init=False)
    suspect: bool = field(default=False, init=False)
    """Whether the last climb contradicted it, or it has been exactly zero from the beginning while others were not."""
    baro: float = field(default=math.nan, init=False)
    """To be set: the barometer's height [m] in the standard atmosphere."""
    _zeros: float = field(default=0.0, init=False)
    _climb: _Climb | None = field(default=None, init=False)
    _verdicts: tuple[str, ...] = field(default=(), init=False)
    _unit: str = field(default="", init=False)  # that the last wrong height looked like

    @property
    def goes_up(self) -> bool:
        """Whether the last climb bore out a velocity that is positive up."""
        return bool(self._verdicts) and not self._verdicts[-1]

    @property
    def goes_down(self) -> bool:
        """Whether the last climb bore out a velocity that is positive down."""
        return bool(self._verdicts) and self._verdicts[-1] == DOWN

    def interrupt(self) -> None:
        """What comes next does not follow what came before."""
        self._climb = None

    def velocity(self, east: float, north: float, up: float) -> None:
        """A velocity [m/s] as it arrives."""
        if up != 0.0:
            if self._zeros < math.inf and not self._verdicts:
                self.suspect = False  # it is filled
            self._zeros = math.inf
        elif east != 0.0 and north != 0.0 and self._zeros < math.inf:
            self._zeros += 1
            self.suspect = self.suspect or self._zeros >= _UNFILLED

    def height(self, t: float, alt: float, up: float, variance: float) -> None:
        """The height [m] at ``t`` with the vertical velocity [m/s] of its epoch; ``variance`` [m^2] of a fix."""
        if self.baro > _HIGH:
            self._look_at(alt)
        climb = self._climb
        if not math.isfinite(alt + up):
            self._climb = None
            return
        if climb is None or t - climb.t > _PAUSE or t - climb.begin > _LONGEST:
            self._climb = _Climb(t, up, alt, alt, self.baro, t)
            return
        if abs(alt - climb.alt) > _STEEPEST * (t - climb.t) + _SCATTER:
            self._climb = _Climb(t, up, alt, alt, self.baro, t)  # heights that jump are no witness
            return
        climb.summed += 0.5 * (t - climb.t) * (climb.up + up)
        climb.t, climb.up, climb.alt = t, up, alt
        gained = alt - climb.start
        scatter = max(_SCATTER, 8.0 * math.sqrt(variance))  # heights scatter twice as much
        if max(min(abs(gained), abs(self.baro - climb.baro_start)), abs(climb.summed)) < max(
            _CLIMB, _CLIMB_TO_SCATTER * scatter
        ):
            return
        undecided = abs(gained - climb.summed) > scatter and max(abs(gained), abs(climb.summed)) < 2.0 * _CLIMB
        if undecided and _agree(gained, climb.summed, scatter):
            return  # a longer climb tells
        self._climb = _Climb(t, up, alt, alt, self.baro, t)
        self._conclude(self._verdict(gained, climb.summed, self.baro - climb.baro_start, scatter))

    def _look_at(self, alt: float) -> None:
        """Far from the barometer's, a height shows its unit by itself."""
        if abs(alt - self.baro) > _NO_WEATHER and (unit := _unit(alt / self.baro)):
            self.height_fault = unit

    def _verdict(self, gained: float, summed: float, by_baro: float, scatter: float) -> str:
        """Empty where height and velocity agree, the fault that explains it, or a question mark."""
        if _agree(gained, summed, scatter):
            return ""
        if math.isfinite(by_baro) and not _agree(gained, by_baro, scatter):
            if not _agree(summed, by_baro, scatter):
                return _NEITHER
            self._unit = _unit(gained / by_baro) or "in another unit, or stuck"
            return _HEIGHT
        if _agree(gained, -summed, scatter):
            return DOWN
        if abs(summed) < 0.1 * abs(gained):
            return SILENT
        return OTHER if math.isfinite(by_baro) and abs(gained) > 0.6 * _CLIMB else _NEITHER

    def _conclude(self, verdict: str) -> None:
        self._verdicts = (*self._verdicts, verdict)[-_CURE:]
        self.suspect = verdict in (SILENT, DOWN, OTHER)
        last = self._verdicts[-_PROOF:]
        if len(last) == _PROOF and last[0] == last[1] and last[0] in (SILENT, DOWN):
            self.fault = last[0]
        elif self._verdicts == (OTHER,) * _CURE:
            self.fault = OTHER
        elif len(last) == _PROOF and last[0] == last[1] == _HEIGHT:
            self.height_fault = self._unit
        elif len(self._verdicts) == _CURE and not any(self._verdicts):
            self.fault = self.height_fault = ""


def _agree(a: float, b: float, scatter: float) -> bool:
    return abs(a - b) <= scatter + _SHARE * max(abs(a), abs(b))


def _unit(ratio: float) -> str:
    """What a height is that is ``ratio`` times as much as the true one; empty where nothing fits."""
    return next((words for words, numbers in _UNITS.items() if abs(ratio / numbers - 1.0) < _LIKE), "")
