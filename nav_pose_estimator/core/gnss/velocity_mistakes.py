"""Hypotheses about errors in GNSS velocities (axes, signs, units), and their likelihoods for a step.

A step (``velocity_steps``) has the ``displacement`` between two fixes and the ``integral`` of the velocities between
them, as complex numbers East + i North. Most hypotheses are linear: displacement = a integral + b conj(integral).
Exchanged North and East are b = i, an axis of the wrong sign is b = 1 or -1, a rotation is a = exp(i angle), a wrong
unit is a real ``a``. With body axes only the length of the displacement is predicted; with a velocity that repeats
itself, and with an unknown error, nothing is.
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

_SCALE = 0.1  # standard deviation relative to the displacement: coarse sampling, reflections
_WORST = 25.0  # cap of the squared normalised residual of one step
_ANYWHERE, _NEAR = 40.0, 15.0  # m: range of displacements that are independent of the velocity: any error, repeated
_PREDICTS = 1.5  # (faded) steps after which the estimated factor predicts the next displacement ...
_KNOWN = 5.0  # ... and after which it may correct velocities
_UNLIKE = 0.2  # difference from 1, and angle [rad], of a factor that differs from that of a correct velocity
_OTHER_DIRECTION = math.radians(75.0)  # angle between two steps that distinguishes a fixed rotation from body axes
_STANDS_STILL = 0.05  # largest scale of a hypothesis that positions which have stopped explain as well
_MEMORY = 0.93  # forgetting factor of the estimated factor's sums from step to step

NED, TURNED, SILENT, UNIT, UNEXPLAINED = "ned", "turned", "silent", "unit", "unexplained"
"""Kinds of errors: North-East-Down; axes rotated, mirrored or of the body; repeated values while the vehicle moves;
right axes in another unit; any other error."""


class Mistake(NamedTuple):
    """A linear hypothesis, displacement = a integral + b conj(integral), with its kind and name."""

    kind: str
    name: str
    a: complex
    b: complex

    def correct(self, velocity: complex) -> complex:
        """The true velocity of a received one under this hypothesis."""
        return self.a * velocity + self.b * velocity.conjugate()


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
BODY, STUCK, SIMILAR, ANY = (len(LINEAR) + i for i in range(4))
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

_A, _B = np.array([one.a for one in LINEAR]), np.array([one.b for one in LINEAR])  # coefficients of the linear ones
_IMPOSSIBLE = 1e9  # squared normalised residual of an impossible hypothesis
_EXPLAINED = 5.0  # largest squared normalised residual with which a step may raise the odds of a hypothesis


@dataclass(eq=False, slots=True)
class Similarity:
    """Least-squares factor from the integral to the displacement over the last steps: a scale and a rotation angle."""

    _cross: complex = field(default=0j, init=False)  # m^2: faded sums of displacement conj(integral) ...
    _power: float = field(default=0.0, init=False)  # m^2: ... and of |integral|^2
    _steps: float = field(default=0.0, init=False)
    _displacements: deque[complex] = field(default_factory=lambda: deque(maxlen=30), init=False)

    @property
    def factor(self) -> complex:
        """The complex factor; 1 for a correct velocity."""
        return self._cross / self._power if self._power > 0.0 else 1.0 + 0j

    @property
    def predicts(self) -> bool:
        """Whether it is known and differs from that of a correct velocity."""
        return self._steps > _PREDICTS and abs(self.factor - 1.0) > _UNLIKE < abs(self.factor)

    @property
    def is_known(self) -> bool:
        """Whether it is known well enough to correct a velocity."""
        return self._steps > _KNOWN

    @property
    def has_changed_direction(self) -> bool:
        """Whether the directions of the last steps differ enough to show that one rotation angle fits all of them."""
        return any(abs(cmath.phase(a / b)) > _OTHER_DIRECTION for a, b in combinations(self._displacements, 2))

    def learn(self, step: Step) -> None:
        """Learn from an informative step."""
        self._cross = _MEMORY * self._cross + step.displacement * step.integral.conjugate()
        self._power = _MEMORY * self._power + abs(step.integral) ** 2
        self._steps = _MEMORY * self._steps + 1.0
        if step.displacement:
            self._displacements.append(step.displacement)

    def in_words(self) -> tuple[str, str]:
        """Kind and name of the error."""
        size, angle = cmath.polar(self.factor)
        if abs(angle) > _UNLIKE:
            return TURNED, f"turned by {abs(math.degrees(angle)):.0f} deg"
        return UNIT, f"{1.0 / size:.2g} times m/s"

    def has_same_correction(self, mistake: Mistake) -> bool:
        """Whether ``mistake`` is corrected by nearly the same factor."""
        return not mistake.b and abs(mistake.a - self.factor) < _UNLIKE


def is_near_unit(i: int) -> bool:
    """Whether hypothesis ``i`` is a unit close to m/s, which is corrected by the estimated scale."""
    return i < len(LINEAR) and LINEAR[i].kind == UNIT and abs(LINEAR[i].a) > _UNLIKE


def odds_of(step: Step, weight: float, similarity: Similarity) -> tuple[bool, NDArray[np.float64], NDArray[np.bool_]]:
    """Evidence of a step of that ``weight``: whether a correct velocity explains it and, for each hypothesis (COUNT,),
    the increase of 2 ln(odds) against a correct velocity, and whether the hypothesis explains the step."""
    gains, explained = np.empty(COUNT), np.empty(COUNT, dtype=bool)
    factor = similarity.factor if similarity.predicts else complex(math.nan)
    numbers = step.displacement, step.integral, step.floor, step.timing
    is_sound = _weigh(numbers, weight, (step.all_same, *step.silent), factor, gains, explained)
    return is_sound, gains, explained


@kernel
def _weigh(numbers, weight, same, factor, gains, explained):
    """``odds_of`` with the ``numbers`` displacement, integral, floor, timing of a step; ``same``: all velocities
    identical, East zero, North zero; ``factor``: NaN while it is not known."""
    displacement, integral, _, timing = numbers
    sound = _fit(numbers, integral, timing)
    for i in range(len(_A)):
        a, b = _A[i], _B[i]
        fit = _fit(numbers, a * integral + b * integral.conjugate(), abs(a + b) * timing)
        explained[i], gains[i] = _gain(sound, fit)
    variance = _variance(numbers, integral, timing)
    square = (abs(displacement) - abs(integral)) ** 2 / variance
    around = max(abs(integral), math.sqrt(variance / (2.0 * math.pi)))
    cost = min(square, _WORST) + math.log(2.0 * math.pi * variance) + 2.0 * math.log(2.0 * math.pi * around)
    explained[BODY], gains[BODY] = _gain(sound, (square, cost))
    explained[STUCK], gains[STUCK] = _gain(sound, _stuck(displacement, integral, variance, same))
    fit = (
        (_IMPOSSIBLE, _IMPOSSIBLE)
        if math.isnan(factor.real)
        else _fit(numbers, factor * integral, abs(factor) * timing)
    )
    explained[SIMILAR], gains[SIMILAR] = _gain(sound, fit)
    explained[ANY], gains[ANY] = _gain(sound, (0.0, _uniform_cost(displacement, _ANYWHERE)))
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
def _stuck(displacement, integral, variance, same):
    """Fit of a repeated velocity, which carries no information, or of a zero axis, which leaves the other axis."""
    if same[0]:
        return 0.0, _uniform_cost(displacement, _NEAR)
    if not (same[1] or same[2]):
        return _IMPOSSIBLE, _IMPOSSIBLE
    apart = displacement - integral
    square = (apart.imag if same[1] else apart.real) ** 2 / variance
    anywhere = 2.0 * math.log(2.0 * max(_NEAR, abs(displacement)))
    return square, min(square, _WORST) + math.log(2.0 * math.pi * variance) + anywhere


@inlined
def _variance(numbers, predicted, timing):
    displacement, _, floor, _ = numbers
    return floor**2 + (_SCALE * max(abs(displacement), abs(predicted))) ** 2 + timing**2


@inlined
def _uniform_cost(displacement, radius):
    """-2 ln likelihood of a displacement that is uniform within ``radius`` [m], or within its own length if larger."""
    return 2.0 * math.log(math.pi * max(radius, abs(displacement)) ** 2)
