"""The usual mistakes of a velocity, and how well each of them explains a step (``velocity_steps``).

As complex numbers, East + i North, most are linear: ``way = a said + b conj(said)``. North and East exchanged are
b = i, an axis of the wrong sign is b = 1 or -1, a turn by an angle is a = exp(i angle), a unit is a real ``a``. Body
axes keep the length and lose the direction; a velocity that repeats itself, and anything else, leaves the way unknown.
"""

from __future__ import annotations

import cmath
import math
from collections import deque
from dataclasses import dataclass, field
from itertools import combinations
from typing import NamedTuple

from nav_pose_estimator.core.gnss.velocity_steps import Step

_SCALE = 0.1  # of the way: coarse sampling, reflections
_WORST = 25.0  # squared deviations: a worse step says no more
_ANYWHERE, _NEAR = 40.0, 15.0  # m: how far the way of a step leads that has nothing to do with what was said
_LEARNS = 1.5  # steps of which the similarity between way and sum is known well enough to predict with ...
_KNOWN = 5.0  # ... and to undo a mistake with
_UNLIKE = 0.2  # of a similarity that differs from that of a sound velocity
_OTHER_WAY = math.radians(75.0)  # between steps that tell a turn by one angle from body axes
_STANDS_STILL = 0.05  # of a velocity: positions that go no farther may as well have stopped
_MEMORY = 0.93  # of the similarity, from step to step

NED, TURNED, SILENT, UNIT, UNEXPLAINED = "ned", "turned", "silent", "unit", "unexplained"
"""Kinds of mistakes. North-East-Down; axes turned, mirrored or the body's; the same again and again while the vehicle
travels; right axes, but another unit; anything else."""
_UNITS = {"knots": 1.944, "mph": 2.237, "ft/s": 3.281, "km/h": 3.6, "cm/s": 100.0, "mm/s": 1000.0}
"""Numbers in that unit for 1 m/s."""


class Mistake(NamedTuple):
    """``way = a said + b conj(said)``, and what to call it."""

    kind: str
    name: str
    a: complex
    b: complex

    def undo(self, said: complex) -> complex:
        """The velocity behind what was said."""
        return self.a * said + self.b * said.conjugate()


LINEAR = (
    Mistake(NED, "North-East", 0j, 1j),
    Mistake(TURNED, "West-North", 0j, -1.0),
    Mistake(TURNED, "East-South", 0j, 1.0),
    Mistake(TURNED, "South-West", 0j, -1j),
    Mistake(TURNED, "West-South", -1.0, 0j),
    Mistake(TURNED, "North-West", 1j, 0j),
    Mistake(TURNED, "South-East", -1j, 0j),
    *(Mistake(UNIT, name, 1.0 / numbers, 0j) for name, numbers in _UNITS.items()),
    Mistake(UNIT, "57 times m/s", math.radians(1.0), 0j),
)
NORTH_EAST = 0
"""Number of what a driver that sends North-East-Down does to the horizontal axes."""
BODY, STUCK, LIKE, ANY = (len(LINEAR) + i for i in range(4))
"""Numbers of the mistakes that are not linear, or whose factor the flight has to show."""
COUNT = len(LINEAR) + 4


def may_begin_in_flight(i: int) -> bool:
    """Whether the mistake ``i`` may befall a velocity that was sound: it stops, or the positions do.

    Axes and units are those of the driver. Positions that leave sound velocities are dragged or reflected.
    """
    return i == STUCK or (i < len(LINEAR) and LINEAR[i].kind == UNIT and abs(LINEAR[i].a) < _STANDS_STILL)


class Fit(NamedTuple):
    """By how many squared deviations a prediction is off, and minus twice its log-likelihood."""

    square: float
    cost: float


_IMPOSSIBLE = Fit(math.inf, math.inf)


@dataclass(eq=False)
class Similarity:
    """Way over sum of the last steps: its length is a scale, its argument the angle [rad] to turn the sum by."""

    _cross: complex = field(default=0j, init=False)  # m^2: ways times sums, and sums squared, that fade
    _power: float = field(default=0.0, init=False)
    _steps: float = field(default=0.0, init=False)
    _ways: deque[complex] = field(default_factory=lambda: deque(maxlen=30), init=False)

    @property
    def factor(self) -> complex:
        """1 of a sound velocity."""
        return self._cross / self._power if self._power > 0.0 else 1.0 + 0j

    @property
    def predicts(self) -> bool:
        """Whether it says anything else than a sound velocity does."""
        return self._steps > _LEARNS and abs(self.factor - 1.0) > _UNLIKE < abs(self.factor)

    @property
    def is_known(self) -> bool:
        """Whether it is known well enough to undo a mistake with."""
        return self._steps > _KNOWN

    @property
    def has_turned(self) -> bool:
        """Whether the last steps have led in ways different enough to tell one angle for all of them."""
        return any(abs(cmath.phase(a / b)) > _OTHER_WAY for a, b in combinations(self._ways, 2))

    def learn(self, step: Step) -> None:
        """From a step that says something."""
        self._cross = _MEMORY * self._cross + step.way * step.said.conjugate()
        self._power = _MEMORY * self._power + abs(step.said) ** 2
        self._steps = _MEMORY * self._steps + 1.0
        if step.way:
            self._ways.append(step.way)

    def in_words(self) -> tuple[str, str]:
        """Kind and name of the mistake."""
        size, angle = cmath.polar(self.factor)
        if abs(angle) > _UNLIKE:
            return TURNED, f"turned by {abs(math.degrees(angle)):.0f} deg"
        return UNIT, f"{1.0 / size:.2g} times m/s"

    def is_like(self, mistake: Mistake) -> bool:
        """Whether a mistake is undone in nearly the same way."""
        return not mistake.b and abs(mistake.a - self.factor) < _UNLIKE


def is_near_unit(i: int) -> bool:
    """Whether a mistake is one of the units that differ too little for a name, and enough for a scale."""
    return i < len(LINEAR) and LINEAR[i].kind == UNIT and abs(LINEAR[i].a) > _UNLIKE


def sound(step: Step) -> Fit:
    """How well a sound velocity explains a step."""
    return _fit(step, step.said, step.timing)


def fits(step: Step, similarity: Similarity) -> list[Fit]:
    """How well every mistake explains a step."""
    found = [_fit(step, m.undo(step.said), abs(m.a + m.b) * step.timing) for m in LINEAR]
    way, said, variance = step.way, step.said, _variance(step, step.said, step.timing)
    square = (abs(way) - abs(said)) ** 2 / variance
    around = max(abs(said), math.sqrt(variance / (2.0 * math.pi)))
    body = min(square, _WORST) + math.log(2.0 * math.pi * variance) + 2.0 * math.log(2.0 * math.pi * around)
    like = similarity.factor
    found += [
        Fit(square, body),
        _stuck(step, variance),
        _fit(step, like * said, abs(like) * step.timing) if similarity.predicts else _IMPOSSIBLE,
        Fit(0.0, _spread(way, _ANYWHERE)),
    ]
    return found


def _fit(step: Step, predicted: complex, timing: float) -> Fit:
    variance = _variance(step, predicted, timing)
    square = abs(step.way - predicted) ** 2 / variance
    return Fit(square, min(square, _WORST) + 2.0 * math.log(2.0 * math.pi * variance))


def _stuck(step: Step, variance: float) -> Fit:
    """The same velocity again and again says nothing; an axis that is always zero leaves the other one."""
    if step.all_same:
        return Fit(0.0, _spread(step.way, _NEAR))
    if not any(step.silent):
        return _IMPOSSIBLE
    apart = step.way - step.said
    square = (apart.imag if step.silent[0] else apart.real) ** 2 / variance
    anywhere = 2.0 * math.log(2.0 * max(_NEAR, abs(step.way)))
    return Fit(square, min(square, _WORST) + math.log(2.0 * math.pi * variance) + anywhere)


def _variance(step: Step, predicted: complex, timing: float) -> float:
    return step.floor**2 + (_SCALE * max(abs(step.way), abs(predicted))) ** 2 + timing**2


def _spread(way: complex, radius: float) -> float:
    """Minus twice the log-likelihood of a way that may lead anywhere within ``radius`` [m], or where it does."""
    return 2.0 * math.log(math.pi * max(radius, abs(way)) ** 2)
