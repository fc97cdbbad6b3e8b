"""Does a receiver's velocity say where its positions go? Tells axes that are not East-North-Up, and values never filled.

Over a stretch of a few seconds the sum of the velocities must be the way between the fixes. Where it is not, but would
be with North and East exchanged, the velocity is North-East-Down; where only the length fits, its axes are turned, as
those of the body are. A disagreement that none of this explains says nothing of the velocity: the position may lie.
Pure Python, without a clock: time comes with the samples, in seconds since the engine's epoch.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

_EARTH = 6.371e6  # m
_APART = 0.3  # s: a velocity farther from a fix in time is not its own
_PAUSE = 6.0  # s: over a longer one nothing can be summed up
_SHORTEST = 1.5  # s of a stretch
_LONGEST = 12.0  # s: a slower vehicle shows nothing
_WAY = 8.0  # m: of a shorter one the scatter of fixes hides too much
_SCATTER = 2.0  # m between two fixes seconds apart
_SHARE = 0.3  # of the way that honest sums are wrong by: coarse sampling, scale, reflections
_PROOF = 2  # stretches in a row that prove it
_CURE = 3  # ... that clear it
_UNFILLED = 10  # samples with a vertical velocity of exactly zero while the others move

NED, TURNED, SILENT = "ned", "turned", "silent"
"""Wrong axes, by name: North-East-Down; turned by some angle, as body axes are; zero while the vehicle travels."""


@dataclass(frozen=True, slots=True)
class _Epoch:
    t: float
    place: tuple[float, float]  # m East, North
    velocity: tuple[float, float]


@dataclass(eq=False)
class VelocityCheck:
    """Offer it every usable fix and every velocity; ``fault`` is what is wrong with the velocity's axes, or empty."""

    fault: str = field(default="", init=False)
    vertical_unfilled: bool = field(default=False, init=False)
    misfit: float = field(default=0.0, init=False)
    """Speed [m/s] by which sums and ways differed in the last stretch."""
    _velocities: deque[tuple[float, float, float]] = field(default_factory=lambda: deque(maxlen=40), init=False)
    _waiting: tuple[float, float, float] | None = field(default=None, init=False)
    _epochs: list[_Epoch] = field(default_factory=list, init=False)
    _verdicts: tuple[str, ...] = field(default=(), init=False)
    _zeros: int = field(default=0, init=False)

    def velocity(self, t: float, east: float, north: float, up: float) -> None:
        """A velocity [m/s] valid at ``t``, as the driver names its axes."""
        self._velocities.append((t, east, north))
        if up != 0.0:
            self._zeros, self.vertical_unfilled = 0, False
        elif east != 0.0 and north != 0.0:
            self._zeros += 1
            self.vertical_unfilled = self._zeros >= _UNFILLED

    def fix(self, t: float, lat: float, lon: float) -> None:
        """A position [rad] valid at ``t``. It counts once the next one is there, and with it its own velocity."""
        before, self._waiting = self._waiting, (t, lat, lon)
        if before is None or not before[0] < t:
            return
        own = min(self._velocities, key=lambda v: abs(v[0] - before[0]), default=None)
        if own is None or abs(own[0] - before[0]) > _APART:
            self._epochs.clear()
            return
        place = before[2] * _EARTH * math.cos(before[1]), before[1] * _EARTH
        self._add(_Epoch(before[0], place, (own[1], own[2])))

    def _add(self, epoch: _Epoch) -> None:
        epochs = self._epochs
        if epochs and epoch.t - epochs[-1].t > _PAUSE:
            epochs.clear()
        epochs.append(epoch)
        seconds = epoch.t - epochs[0].t
        if seconds < _SHORTEST:
            return
        way = epoch.place[0] - epochs[0].place[0], epoch.place[1] - epochs[0].place[1]
        said = _sum(epochs)
        if max(math.hypot(*way), math.hypot(*said)) >= _WAY:
            self._conclude(_verdict(way, said))
            self.misfit = math.dist(way, said) / seconds
        elif seconds < _LONGEST:
            return
        self._epochs = [epoch]

    def _conclude(self, verdict: str) -> None:
        self._verdicts = (*self._verdicts, verdict)[-_CURE:]
        last = self._verdicts[-_PROOF:]
        if len(last) == _PROOF and all(one not in ("", "?") for one in last):
            self.fault = last[0] if last[0] == last[1] else TURNED
        elif len(self._verdicts) == _CURE and not any(self._verdicts):
            self.fault = ""


def _sum(epochs: list[_Epoch]) -> tuple[float, float]:
    """Where the velocities lead, trapezoidal rule [m]."""
    x = y = 0.0
    for a, b in zip(epochs, epochs[1:], strict=False):
        half = 0.5 * (b.t - a.t)
        x += half * (a.velocity[0] + b.velocity[0])
        y += half * (a.velocity[1] + b.velocity[1])
    return x, y


def _verdict(way: tuple[float, float], said: tuple[float, float]) -> str:
    """Empty where they agree, the fault that explains it, or a question mark."""
    went, summed = math.hypot(*way), math.hypot(*said)
    tolerance = _SCATTER + _SHARE * max(went, summed)
    if math.dist(way, said) <= tolerance:
        return ""
    if math.dist(way, (said[1], said[0])) <= tolerance:
        return NED
    if summed < 0.1 * went:
        return SILENT
    return TURNED if abs(went - summed) <= tolerance else "?"
