"""Hypotheses about errors in GNSS velocities (axes, signs, units), and their likelihoods for a step.

A step (``velocity_steps``) has the displacement between two fixes (``way``) and the integral of the velocities between
them (``said``), as complex numbers East + i North. Most hypotheses are linear: ``way = a said + b conj(said)``.
Exchanged North and East are b = i, an axis of the wrong sign is b = 1 or -1, a rotation is a = exp(i angle), a wrong
unit is a real ``a``. With body axes only the length of ``way`` is known; with a velocity that repeats itself, and with
an unknown error, ``way`` is not known at all.
"""

from __future__ import annotations

import cmath
import math
from collections import deque
from dataclasses import dataclass, field
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.gnss.velocity_steps import Step
from nav_pose_estimator.core.numerics.jit import inlined, kernel
from nav_pose_estimator.core.numerics.units import SPEEDS

_SCALE = 0.1  # of the way: coarse sampling, reflections
_WORST = 25.0  # squared deviations: a worse step says no more
_ANYWHERE, _NEAR = 40.0, 15.0  # m: how far the way of a step leads that has nothing to do with what was said
_LEARNS = 1.5  # steps of which the similarity between way and sum is known well enough to predict with ...
_KNOWN = 5.0  # ... and to undo a mistake with
_UNLIKE = 0.2  # of a similarity that differs from that of a sound velocity
_OTHER_WAY = math.radians(75.0)  # between steps that tell a turn by one angle from body axes
_STANDS_STILL = 0.05  # largest scale of a hypothesis that positions which have stopped explain as well
_MEMORY = 0.93  # of the similarity, from step to step

NED, TURNED, SILENT, UNIT, UNEXPLAINED = "ned", "turned", "silent", "unit", "unexplained"
"""Kinds of errors: North-East-Down; axes rotated, mirrored or of the body; repeated values while the vehicle moves;
right axes in another unit; any other error."""


class Mistake(NamedTuple):
    """A linear hypothesis ``way = a said + b conj(said)`` with its kind and name."""

    kind: str
    name: str
    a: complex
    b: complex

    def undo(self, said: complex) -> complex:
        """The true velocity of a received one under this hypothesis."""
        return self.a * said + self.b * said.conjugate()


LINEAR = (
    Mistake(NED, "North-East", 0j, 1j),
    Mistake(TURNED, "West-North", 0j, -1.0),
    Mistake(TURNED, "East-South", 0j, 1.0),
    Mistake(TURNED, "South-West", 0j, -1j),
    Mistake(TURNED, "West-South", -1.0, 0j),
    Mistake(TURNED, "North-West", 1j, 0j),
    Mistake(TURNED, "South-East", -1j, 0j),
    *(Mistake(UNIT, name, 1.0 / numbers, 0j) for name, numbers in SPEEDS.items()),
    Mistake(UNIT, "57 times m/s", math.radians(1.0), 0j),
)
NORTH_EAST = 0
"""Index of the hypothesis of exchanged horizontal axes, as from a driver that sends North-East-Down."""
BODY, STUCK, LIKE, ANY = (len(LINEAR) + i for i in range(4))
"""Indices of the hypotheses that are not linear, or whose factor is estimated in flight."""
COUNT = len(LINEAR) + 4
NOT_STUCK = np.arange(COUNT) != STUCK
MAY_BEGIN_IN_FLIGHT = (
    *(one.kind == UNIT and abs(one.a) < _STANDS_STILL for one in LINEAR),
    *(i == STUCK for i in range(len(LINEAR), COUNT)),
)
"""Hypotheses (COUNT,) that may become true of a velocity that was correct: it repeats itself, or the positions do.

Axes and units are fixed by the driver. Positions that leave correct velocities are dragged or reflected.
"""

_STRAIGHT, _MIRRORED = np.array([one.a for one in LINEAR]), np.array([one.b for one in LINEAR])  # a and b of each
_NEVER = 1e9  # squared normalised residual of an impossible hypothesis
_EXPLAINED = 5.0  # largest squared normalised residual with which a step may raise the odds of a hypothesis


@dataclass(eq=False)
class Similarity:
    """Least-squares factor from ``said`` to ``way`` over the last steps: a scale and a rotation angle [rad]."""

    _cross: complex = field(default=0j, init=False)  # m^2: faded sums of way times conj(said), and of |said| squared
    _power: float = field(default=0.0, init=False)
    _steps: float = field(default=0.0, init=False)
    _ways: deque[complex] = field(default_factory=lambda: deque(maxlen=30), init=False)

    @property
    def factor(self) -> complex:
        """The complex factor; 1 for a correct velocity."""
        return self._cross / self._power if self._power > 0.0 else 1.0 + 0j

    @property
    def predicts(self) -> bool:
        """Whether it is known and differs from that of a correct velocity."""
        return self._steps > _LEARNS and abs(self.factor - 1.0) > _UNLIKE < abs(self.factor)

    @property
    def is_known(self) -> bool:
        """Whether it is known well enough to correct a velocity."""
        return self._steps > _KNOWN

    @property
    def has_turned(self) -> bool:
        """Whether the directions of the last steps differ enough to show that one rotation angle fits all of them."""
        return any(abs(cmath.phase(a / b)) > _OTHER_WAY for a, b in combinations(self._ways, 2))

    def learn(self, step: Step) -> None:
        """Learn from an informative step."""
        self._cross = _MEMORY * self._cross + step.way * step.said.conjugate()
        self._power = _MEMORY * self._power + abs(step.said) ** 2
        self._steps = _MEMORY * self._steps + 1.0
        if step.way:
            self._ways.append(step.way)

    def in_words(self) -> tuple[str, str]:
        """Kind and name of the error."""
        size, angle = cmath.polar(self.factor)
        if abs(angle) > _UNLIKE:
            return TURNED, f"turned by {abs(math.degrees(angle)):.0f} deg"
        return UNIT, f"{1.0 / size:.2g} times m/s"

    def is_like(self, mistake: Mistake) -> bool:
        """Whether ``mistake`` is corrected by nearly the same factor."""
        return not mistake.b and abs(mistake.a - self.factor) < _UNLIKE


def is_near_unit(i: int) -> bool:
    """Whether hypothesis ``i`` is a unit close to m/s, which is corrected by the estimated scale."""
    return i < len(LINEAR) and LINEAR[i].kind == UNIT and abs(LINEAR[i].a) > _UNLIKE


def odds_of(step: Step, weight: float, similarity: Similarity) -> tuple[bool, NDArray[np.float64], NDArray[np.bool_]]:
    """Evidence of a step of that ``weight``: whether a correct velocity explains it and, for each hypothesis (COUNT,),
    the increase of 2 ln(odds) against a correct velocity, and whether the hypothesis explains the step."""
    gains, explained = np.empty(COUNT), np.empty(COUNT, dtype=bool)
    like = similarity.factor if similarity.predicts else complex(math.nan)
    numbers = step.way, step.said, step.floor, step.timing
    is_sound = _weigh(numbers, weight, (step.all_same, *step.silent), like, gains, explained)
    return is_sound, gains, explained


@kernel
def _weigh(numbers, weight, same, like, gains, explained):
    """``odds_of`` with the ``numbers`` way, said, floor, timing of a step; ``same``: all velocities identical, East
    zero, North zero."""
    way, said, _, timing = numbers
    sound = _fit(numbers, said, timing)
    for i in range(len(_STRAIGHT)):
        a, b = _STRAIGHT[i], _MIRRORED[i]
        fit = _fit(numbers, a * said + b * said.conjugate(), abs(a + b) * timing)
        explained[i], gains[i] = _gain(sound, fit)
    variance = _variance(numbers, said, timing)
    square = (abs(way) - abs(said)) ** 2 / variance
    around = max(abs(said), math.sqrt(variance / (2.0 * math.pi)))
    cost = min(square, _WORST) + math.log(2.0 * math.pi * variance) + 2.0 * math.log(2.0 * math.pi * around)
    explained[BODY], gains[BODY] = _gain(sound, (square, cost))
    explained[STUCK], gains[STUCK] = _gain(sound, _stuck(way, said, variance, same))
    fit = (_NEVER, _NEVER) if math.isnan(like.real) else _fit(numbers, like * said, abs(like) * timing)
    explained[LIKE], gains[LIKE] = _gain(sound, fit)
    explained[ANY], gains[ANY] = _gain(sound, (0.0, _spread(way, _ANYWHERE)))
    for i in range(COUNT):
        gains[i] *= weight
    return sound[0] < _EXPLAINED


@inlined
def _gain(sound, fit):
    """Whether a ``fit`` explains the step, and its log likelihood gain (twice) over a ``sound`` velocity."""
    gain = sound[1] - fit[1]
    return fit[0] < _EXPLAINED, (gain if fit[0] < _EXPLAINED else min(gain, 0.0))


@inlined
def _fit(numbers, predicted, timing):
    """Squared normalised residual of a hypothesis for one step, and -2 ln of its likelihood."""
    variance = _variance(numbers, predicted, timing)
    square = abs(numbers[0] - predicted) ** 2 / variance
    return square, min(square, _WORST) + 2.0 * math.log(2.0 * math.pi * variance)


@inlined
def _stuck(way, said, variance, same):
    """Fit of a repeated velocity, which carries no information, or of a zero axis, which leaves the other axis."""
    if same[0]:
        return 0.0, _spread(way, _NEAR)
    if not (same[1] or same[2]):
        return _NEVER, _NEVER
    apart = way - said
    square = (apart.imag if same[1] else apart.real) ** 2 / variance
    anywhere = 2.0 * math.log(2.0 * max(_NEAR, abs(way)))
    return square, min(square, _WORST) + math.log(2.0 * math.pi * variance) + anywhere


@inlined
def _variance(numbers, predicted, timing):
    way, _, floor, _ = numbers
    return floor**2 + (_SCALE * max(abs(way), abs(predicted))) ** 2 + timing**2


@inlined
def _spread(way, radius):
    """-2 ln likelihood of a displacement that is uniform within ``radius`` [m], or within its own length if larger."""
    return 2.0 * math.log(math.pi * max(radius, abs(way)) ** 2)
