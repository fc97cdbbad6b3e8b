"""Monitor of the height reference: heights that jump while the horizontal position stays.

Geoid and ellipsoid differ by up to 107 m, and some receivers change between them. A vehicle does not climb that far
between two fixes without any other motion. So such a height is left out at first; if it persists, the step is
subtracted from later heights, and the flight continues with its first reference. The heights of a receiver that changes
back and forth are not used. Pure Python, without a clock.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

STEP = 6.0
"""m: change of height between consecutive fixes that counts as a step."""
_SAME = 6.0  # m within which heights agree on a new reference
_PROOF = 5.0  # s for which they have to agree
PAUSE = 20.0
"""s: after a longer pause the height may have changed for other reasons. Steps within it are counted together."""
_SWITCHES = 4  # steps within ``PAUSE`` after which the reference is ambiguous

USED, LEFT_OUT, MOVED = "used", "left out", "moved"


@dataclass(frozen=True, slots=True)
class _Candidate:
    since: float
    last: float
    step: float


@dataclass(eq=False, slots=True)
class HeightReference:
    """The monitor. It receives the height of every fix with a good horizontal position.

    ``shift`` [m] is to be subtracted from the heights.
    """

    shift: float = field(default=0.0, init=False)
    span: float = field(default=0.0, init=False)
    """m: step between the references of a receiver that changes back and forth, 0 for others."""
    _before: tuple[float, float] = field(default=(-math.inf, 0.0), init=False)
    _steps: tuple[float, ...] = field(default=(), init=False)  # times [s] of the last ones
    _candidate: _Candidate | None = field(default=None, init=False)

    @property
    def last(self) -> tuple[float, float]:
        """Time [s] of the last height, and its difference from the filter [m]."""
        return self._before

    def is_calm(self, t: float) -> bool:
        """Whether no change of the reference is suspected at ``t`` [s]: a height without a step is then ``USED``."""
        switches = len(self._steps) >= _SWITCHES and t - self._steps[-1] < PAUSE
        return self._candidate is None and self.span == 0.0 and not switches

    def agrees(self, t: float, off: float) -> None:
        """Same as ``offer`` for a height without a step and within its bound, while ``is_calm``."""
        self._before = (t, off)

    def offer(self, t: float, off: float, bound: float, scatter: float, known: bool) -> str:
        """Decide on a height valid at ``t`` [s]: ``USED``, ``LEFT_OUT`` or ``MOVED`` (used with a new ``shift``).

        Args:
            off: height minus ``shift`` and minus the filter's height [m].
            bound: largest ``off`` of a good height [m].
            scatter: largest difference of two consecutive heights by noise [m].
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
            return USED  # no step of the receiver: the filter's height has drifted, or was never known
        self._candidate = _Candidate(t, t, off)
        return LEFT_OUT
