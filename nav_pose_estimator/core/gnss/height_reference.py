"""Heights that jump while the position beside them stays: a receiver that changes what it measures height from.

Between geoid and ellipsoid lie up to 107 m. A vehicle does not climb that far between two fixes without moving in any
other way, so such a height is left out at first; where it stays, the step is remembered and taken off, so that the
height of a flight goes on from the reference it began with. A receiver that
changes back and forth gives no height at all. Pure Python, without a clock.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

STEP = 6.0
"""m between two fixes in a row."""
_SAME = 6.0  # m within which heights agree on the new reference
_PROOF = 5.0  # s for which they do
PAUSE = 20.0
"""s: over a longer one a height may have changed for many reasons; steps count together."""
_SWITCHES = 4  # steps within ``PAUSE`` after which nobody knows which height is which

USED, LEFT_OUT, MOVED = "used", "left out", "moved"


@dataclass(frozen=True, slots=True)
class _Candidate:
    since: float
    last: float
    step: float


@dataclass(eq=False)
class HeightReference:
    """Offer it the height of every fix beside a good horizontal position; ``shift`` [m] is to be taken off them."""

    shift: float = field(default=0.0, init=False)
    span: float = field(default=0.0, init=False)
    """Metres between the heights of a receiver that changes back and forth, 0 for any other."""
    _before: tuple[float, float] = field(default=(-math.inf, 0.0), init=False)
    _steps: tuple[float, ...] = field(default=(), init=False)  # times [s] of the last ones
    _candidate: _Candidate | None = field(default=None, init=False)

    @property
    def last(self) -> tuple[float, float]:
        """Time [s] of the last height, and how far it was off [m]."""
        return self._before

    def is_calm(self, t: float) -> bool:
        """Whether no change of the reference is under way at ``t`` [s]: a height without a step is then ``USED``."""
        switches = len(self._steps) >= _SWITCHES and t - self._steps[-1] < PAUSE
        return self._candidate is None and self.span == 0.0 and not switches

    def agrees(self, t: float, off: float) -> None:
        """``offer`` of a height without a step and within its bound, where all ``is_calm``."""
        self._before = (t, off)

    def offer(self, t: float, off: float, bound: float, scatter: float, known: bool) -> str:
        """What becomes of a height valid at ``t`` [s].

        Args:
            off: height less ``shift`` minus that of the filter [m].
            bound: how far a good one may be off [m].
            scatter: how far two heights in a row may differ by chance [m].
            known: whether fixes have corrected the filter's height up to now.
        """
        before, self._before = self._before, (t, off)
        stepped = t - before[0] < PAUSE and abs(off - before[1]) > max(scatter, STEP)
        self._steps = tuple(at for at in (*self._steps, t) if t - at < PAUSE) if stepped else self._steps
        if self._steps and len(self._steps) >= _SWITCHES and t - self._steps[-1] < PAUSE:
            self._candidate = None
            self.span = max(self.span, abs(off - before[1]))
            return LEFT_OUT
        self.span = 0.0
        if abs(off) <= bound:
            self._candidate = None
            return USED
        candidate = self._candidate
        if candidate is not None and t - candidate.last < PAUSE and abs(off - candidate.step) < _SAME:
            if t - candidate.since < _PROOF:
                self._candidate = _Candidate(candidate.since, t, candidate.step)
                return LEFT_OUT
            self.shift += off
            self._candidate = None
            return MOVED
        if candidate is None and not (known and stepped):
            return USED  # no step of the receiver's: the filter's height has gone astray, or was never known
        self._candidate = _Candidate(t, t, off)
        return LEFT_OUT
