"""Does a receiver's vertical velocity say how its height changes? Tells one that is never filled, or positive down.

Over a climb the sum of the vertical velocities must be the height gained. Pure Python, without a clock: time comes with
the samples, in seconds since the engine's epoch.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

_PAUSE = 6.0  # s: over a longer one nothing can be summed up
_SCATTER = 2.0  # m between two heights seconds apart, at least
_SHARE = 0.3  # of the climb that honest sums are wrong by
_STEEPEST = 60.0  # m/s
_CLIMB = 6.0  # m of height after which vertical sums are compared
_CLIMB_TO_SCATTER = 3.0
_PROOF = 2  # climbs in a row that prove it
_CURE = 3  # ... that clear it
_UNFILLED = 10  # samples with a vertical velocity of exactly zero, and none before with another

SILENT, DOWN = "silent", "down"
"""Never filled; positive down."""


@dataclass
class _Climb:
    t: float
    up: float
    alt: float  # m
    start: float  # m
    summed: float = 0.0


@dataclass(eq=False)
class ClimbCheck:
    """Offer it every height with its vertical velocity; ``fault`` is what is proved to be wrong with that, or empty."""

    fault: str = field(default="", init=False)
    suspect: bool = field(default=False, init=False)
    """Whether the last climb contradicted it, or it has been exactly zero from the beginning while others were not."""
    _zeros: float = field(default=0.0, init=False)
    _climb: _Climb | None = field(default=None, init=False)
    _verdicts: tuple[str, ...] = field(default=(), init=False)

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
            self._zeros = math.inf  # it is filled
            self.suspect = self.suspect and bool(self._verdicts) and bool(self._verdicts[-1])
        elif east != 0.0 and north != 0.0 and self._zeros < math.inf:
            self._zeros += 1
            self.suspect = self.suspect or self._zeros >= _UNFILLED

    def height(self, t: float, alt: float, up: float, variance: float) -> None:
        """The height [m] at ``t`` with the vertical velocity [m/s] of its epoch; ``variance`` [m^2] of a fix."""
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
        scatter = max(_SCATTER, 8.0 * math.sqrt(variance))  # heights scatter twice as much
        if max(abs(gained), abs(climb.summed)) < max(_CLIMB, _CLIMB_TO_SCATTER * scatter):
            return
        self._climb = _Climb(t, up, alt, alt)
        self._conclude(_verdict(gained, climb.summed, scatter))

    def _conclude(self, verdict: str) -> None:
        self._verdicts = (*self._verdicts, verdict)[-_CURE:]
        self.suspect = verdict in (SILENT, DOWN)
        last = self._verdicts[-_PROOF:]
        if len(last) == _PROOF and last[0] == last[1] and last[0] in (SILENT, DOWN):
            self.fault = last[0]
        elif len(self._verdicts) == _CURE and not any(self._verdicts):
            self.fault = ""


def _verdict(gained: float, summed: float, scatter: float) -> str:
    """Empty where they agree, the fault that explains it, or a question mark."""
    tolerance = scatter + _SHARE * max(abs(gained), abs(summed))
    if abs(gained - summed) <= tolerance:
        return ""
    if abs(gained + summed) <= tolerance:
        return DOWN
    return SILENT if abs(summed) < 0.1 * abs(gained) else "?"
