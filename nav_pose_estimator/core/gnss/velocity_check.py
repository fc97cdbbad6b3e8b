"""Does a receiver's velocity say where its positions go? If not, which usual mistake would explain it?

Over a second or so the sum of the velocities must be the way between the fixes. Every such step multiplies the odds of
each usual mistake (``velocity_mistakes``) against a sound velocity by the ratio of their likelihoods (sequential
probability ratio test; A. Wald, Annals of Mathematical Statistics 16(2), 1945). The odds are limited, so that one
blunder proves nothing and what was sound for an hour is found out within seconds.

Whether velocity or position is at fault cannot be told from the two alone. Pure Python, without a clock.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

from nav_pose_estimator.core.gnss import velocity_mistakes as mistakes
from nav_pose_estimator.core.gnss.climb_check import DOWN, ClimbCheck
from nav_pose_estimator.core.gnss.lateness import Lateness
from nav_pose_estimator.core.gnss.velocity_mistakes import ANY, BODY, COUNT, LIKE, LINEAR, NORTH_EAST, STUCK, Similarity
from nav_pose_estimator.core.gnss.velocity_steps import Step, StepMaker

_EXPLAINED = 5.0  # squared deviations within which a mistake has to explain a step for which it is to be blamed
_PRIOR, _CLEARED, _SUSPECT, _PROVED, _MOST = -10.0, 0.0, 5.0, 20.0, 45.0
"""Twice the logarithm of the odds of a mistake. On thirteen recorded flights they rise to -2.4 at most."""
_DOWN_TOO = 15.0  # by which a vertical that is positive down raises the odds of North-East, as long as no step ...
_REFUTED = 9.0  # ... has cost them that much; on a leg to the North-East none can
_STANDS = 6.0  # of which a step takes off where nothing moves: no suspicion outlasts a stand
_ALONE = 12.0  # by which the odds of one mistake exceed those of all others where it may be undone
_GOES = 3.0  # floors that a vehicle has to move in a step that tells cm/s from mm/s
_HARDLY = 0.05  # of what a velocity says
_HELD = 2  # steps that a mistake has to explain after the proof before it is undone
_SETTLED = 20  # steps in motion after which velocities are known to be in the right axes and units
_SAYS = 0.5  # least weight of a step that teaches anything
_SCALE_LEAST, _SCALE_SURE = 0.03, 3.0  # of the way, and deviations, by which a scale has to differ from 1


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
    """Speed [m/s] by which sum and way differed in the last step that says anything."""
    sound_steps: int = field(default=0, init=False)
    """Steps that did not contradict a sound velocity, since the last one that did."""
    felt: bool = field(default=False, init=False)
    """To be set: whether an IMU feels what the velocity says. What is unexplained is the positions' fault then."""
    climb: ClimbCheck = field(default_factory=ClimbCheck, init=False)
    late: Lateness = field(default_factory=Lateness, init=False)
    _steps: StepMaker = field(default_factory=StepMaker, init=False)
    _similarity: Similarity = field(default_factory=Similarity, init=False)
    _odds: list[float] = field(default_factory=lambda: [_PRIOR] * COUNT, init=False)
    _found: int = field(default=-1, init=False)
    _held: int = field(default=0, init=False)  # steps that it has explained since it was found
    _last: tuple[float, float, float] = field(default=(0.0, 0.0, 0.0), init=False)
    _filled: tuple[bool, bool] = field(default=(False, False), init=False)  # East and North have been other than zero
    _waiting: deque[tuple[float, float, float, float, float]] = field(default_factory=deque, init=False)
    _along: float = field(default=0.0, init=False)  # m^2: ways times sums, and sums squared, of steps that agreed
    _square: float = field(default=0.0, init=False)
    _is_not_ned: bool = field(default=False, init=False)
    _agreed: int = field(default=0, init=False)  # steps of a vehicle that moves which agreed, since the start

    @property
    def scale(self) -> float:
        """Way between fixes in parts of what velocities say, where that is surely not 1; else 1.0.

        Time is the only thing that all the velocities of a receiver can share an error in: a clock that stamps 8 % too
        few seconds makes the way 8 % longer.
        """
        if self._square == 0.0:
            return 1.0
        scale, sd = self._along / self._square, 2.0 * self._steps.floor(1.0) / math.sqrt(self._square)
        return scale if abs(scale - 1.0) > _SCALE_LEAST + _SCALE_SURE * sd else 1.0

    @property
    def stands_still(self) -> bool:
        """Whether the velocity is so much too large that positions may as well be what is wrong: they hardly move."""
        return 0 <= self._found < len(LINEAR) and abs(LINEAR[self._found].a) + abs(LINEAR[self._found].b) < _HARDLY

    def forget_time(self) -> None:
        """The clock is another one, or the filter starts again: forget samples, keep what they have proved."""
        self._steps.interrupt()
        self.climb.interrupt()
        self.late.interrupt()
        self._waiting.clear()
        if not self.fault:
            self.suspect, self._odds = False, [_PRIOR] * COUNT

    def velocity(self, t: float, east: float, north: float, up: float) -> None:
        """A velocity [m/s] valid at ``t``, as the driver names its axes."""
        self._last = east, north, up
        self._filled = self._filled[0] or east != 0.0, self._filled[1] or north != 0.0
        self._steps.velocity(t - self.late.delay, complex(east, north), up)
        self.climb.velocity(east, north, up)
        self.late.velocity(t, complex(east, north))

    def fix(self, t: float, lat: float, lon: float, alt: float, sd: float = 0.0) -> None:
        """A position [rad, rad, m] valid at ``t`` with the horizontal deviation ``sd`` [m] that the receiver states.

        It counts once a later one is there, and so its own velocity.
        """
        if self._waiting and t <= self._waiting[-1][0]:
            return
        self._waiting.append((t, lat, lon, alt, sd))
        while self._waiting[0][0] + self.late.delay < t:
            self._compare(*self._waiting.popleft())

    def _compare(self, t: float, lat: float, lon: float, alt: float, sd: float) -> None:
        own = self._steps.own(t)
        if own is None:
            self.climb.interrupt()
        else:
            self.climb.height(t, alt, own[1], self._steps.variance)
        step = self._steps.fix(t, lat, lon, sd, None if own is None else own[0])
        if step is not None:
            self._weigh(step)

    def _weigh(self, step: Step) -> None:
        """Let a step speak for and against every mistake."""
        own, weight = mistakes.sound(step), step.weight
        # a live velocity of nearly nothing is no velocity in wrong axes, whatever the positions do
        says_rest = abs(step.said) < step.floor and not self.fault
        if weight > _SAYS:
            self._learn(step, own.square < _EXPLAINED)
        for i, fit in enumerate(mistakes.fits(step, self._similarity)):
            gain = own.cost - fit.cost
            gain = weight * (gain if fit.square < _EXPLAINED and not (says_rest and i != STUCK) else min(gain, 0.0))
            if i == NORTH_EAST and gain < -_REFUTED:
                self._is_not_ned = True
            goes = abs(step.way) > _GOES * step.floor or not self.stands_still
            if i == self._found and goes and weight > _SAYS and fit.square < _EXPLAINED:
                self._held += 1
            self._odds[i] += gain - (0.0 if i == self._found else _STANDS * (1.0 - weight))
        beyond = max(max(self._odds) - _MOST, 0.0)
        self._odds = [max(odds - beyond, _PRIOR) for odds in self._odds]
        self._conclude(self._with_witnesses())

    def _with_witnesses(self) -> list[float]:
        """The odds with what else is known."""
        odds = list(self._odds)
        if self._agreed >= _SETTLED:  # a driver's axes and units do not change in flight
            odds = [value if mistakes.may_begin_in_flight(i) else _PRIOR for i, value in enumerate(odds)]
        if self.felt:  # by the IMU, what the velocity says: the blame for the unexplained is left with the positions
            odds[ANY] = _PRIOR
        if self.climb.fault == DOWN and not self._is_not_ned:
            odds[NORTH_EAST] += _DOWN_TOO
        return odds

    def _learn(self, step: Step, agrees: bool) -> None:
        self.misfit = step.misfit
        self._similarity.learn(step)
        if not self.fault and not self.suspect:
            self.late.stretch(step)
        if agrees and abs(step.way) > _GOES * step.floor and not self.fault:
            self._agreed += 1
        if agrees and step.dense:
            self._along += (step.way * step.said.conjugate()).real
            self._square += abs(step.said) ** 2

    def _conclude(self, odds: list[float]) -> None:
        best = max(range(COUNT), key=lambda i: odds[i])
        self.suspect = odds[best] > (_CLEARED if self.suspect else _SUSPECT)
        if self.suspect:
            self.late.interrupt()
        self.sound_steps = 0 if self.suspect or self.fault else self.sound_steps + 1
        if self.fault and odds[self._found] <= _CLEARED and not self.suspect:
            self.fault, self.name, self.certain, self._found = "", "", False, -1
        if odds[best] > _PROVED and (not self.fault or odds[best] > odds[self._found] + _SUSPECT):
            self._found, self._held = best, 0
            self.fault, self.name = self._in_words(best)
        if self.fault:
            others = max(value for i, value in enumerate(odds) if not self._is_like_found(i))
            self.certain = self._can_be_undone() and odds[self._found] - others > _ALONE

    def _can_be_undone(self) -> bool:
        if not (self._similarity.is_known and all(self._filled)):
            return False
        if self._held < _HELD:
            return False
        by_turn = self.fault == mistakes.UNIT or self._similarity.has_turned
        return self._found < len(LINEAR) or (self._found == LIKE and by_turn)

    def _is_like_found(self, i: int) -> bool:
        """Whether a mistake is undone in the same way as the one found, or says nothing."""
        if i in (self._found, ANY, LIKE):
            return True
        if self._found == LIKE:
            return i < len(LINEAR) and self._similarity.is_like(LINEAR[i])
        return mistakes.is_near_unit(i) and mistakes.is_near_unit(self._found)

    def mended(self, east: float, north: float) -> tuple[float, float]:
        """A velocity without the mistake that is ``certain``."""
        said = complex(east, north)
        if self._found == LIKE:
            said *= self._similarity.factor
        elif mistakes.is_near_unit(self._found):
            said *= self._similarity.factor.real
        else:
            said = LINEAR[self._found].undo(said)
        return said.real, said.imag

    def _in_words(self, i: int) -> tuple[str, str]:
        """Kind and name."""
        if i < len(LINEAR):
            return LINEAR[i].kind, LINEAR[i].name
        if i == LIKE:
            return self._similarity.in_words()
        if i == STUCK:
            east, north, _ = self._last
            return mistakes.SILENT, "repeats" if east and north else "East" if north else "North" if east else ""
        return (mistakes.TURNED, "body") if i == BODY else (mistakes.UNEXPLAINED, "")
