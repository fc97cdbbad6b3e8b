"""Consistency of GNSS velocities with positions: a sequential test of a correct velocity against usual errors.

Over about a second the integral of the velocities must equal the displacement between fixes. Every such step multiplies
the odds of each error hypothesis (``velocity_mistakes``) against a correct velocity by their likelihood ratio
(sequential probability ratio test; A. Wald, Annals of Mathematical Statistics 16(2), 1945). The odds are bounded, so
that one outlier establishes nothing, and an error that begins after an hour is detected within seconds.

From the two alone one cannot decide whether velocity or position is wrong. Without a clock.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.gnss import climb_check, lateness, velocity_steps
from nav_pose_estimator.core.gnss import velocity_mistakes as mistakes
from nav_pose_estimator.core.gnss.climb_check import DOWN, ClimbCheck
from nav_pose_estimator.core.gnss.lateness import Lateness
from nav_pose_estimator.core.gnss.velocity_mistakes import (
    ANY,
    BODY,
    COUNT,
    LINEAR,
    MAY_BEGIN_IN_FLIGHT,
    NORTH_EAST,
    NOT_STUCK,
    SIMILAR,
    STUCK,
    Similarity,
)
from nav_pose_estimator.core.gnss.velocity_steps import WALK, Step, StepMaker
from nav_pose_estimator.core.numerics.jit import kernel

_PRIOR, _CLEARED, _SUSPECT, _PROVED, _MOST = -10.0, 0.0, 5.0, 20.0, 45.0
"""Twice the logarithm of the odds of a mistake. On thirteen recorded flights they rise to -2.4 at most."""
_DOWN_BONUS = 15.0  # increase of the odds of North-East by a vertical velocity that is positive down, unless a step ...
_REFUTED = 9.0  # ... has lowered them by this much; on a leg to the North-East none can
_STANDSTILL = 6.0  # decrease of the odds per step at rest, so that a suspicion does not outlast a stop
_MARGIN = 12.0  # by which the odds of a mistake must exceed those of all others before it is corrected
_MOVES = 3.0  # smallest displacement, in floors, of a step that distinguishes cm/s from mm/s
_NO_MOTION = 0.05  # displacement relative to the integrated velocity below which positions hardly move
_CONFIRMATIONS = 2  # further steps that an established mistake must explain before it is corrected
_SETTLED = 20  # informative steps in motion after which axes and units of the velocities are established
_INFORMATIVE = 0.5  # smallest weight of a step from which scale and factor are learned
_SCALE_LEAST, _SCALE_SURE = 0.03, 3.0  # difference of a significant scale from 1, and standard deviations beyond that
_STEP = 4
"""Result of ``_compare`` besides those of ``climb_check``: a step has ended."""


@dataclass(eq=False, slots=True)
class VelocityCheck:
    """The test. It receives every usable fix and every velocity.

    ``fault`` is the kind of an established error, or empty, and ``name`` the error; ``suspect`` while an error is more
    likely than none; ``certain`` once it is distinguished from all others, so that ``corrected`` can undo it.
    """

    fault: str = field(default="", init=False)
    name: str = field(default="", init=False)
    suspect: bool = field(default=False, init=False)
    certain: bool = field(default=False, init=False)
    is_new: bool = field(default=False, init=False)
    """Whether the test has come to a conclusion; to be cleared by the caller."""
    misfit: float = field(default=0.0, init=False)
    """m/s: difference of integral and displacement in the last informative step."""
    sound_steps: int = field(default=0, init=False)
    """Consecutive steps that agree with a correct velocity."""
    imu_agrees: bool = field(default=False, init=False)
    """To be set by the caller: whether the IMU confirms the velocity. An unexplained error is then in the positions."""
    climb: ClimbCheck = field(default_factory=ClimbCheck, init=False)
    late: Lateness = field(default_factory=Lateness, init=False)
    _steps: StepMaker = field(default_factory=StepMaker, init=False)
    _similarity: Similarity = field(default_factory=Similarity, init=False)
    _odds: NDArray[np.float64] = field(default_factory=lambda: np.full(COUNT, _PRIOR), init=False)
    _found: int = field(default=-1, init=False)
    _confirmations: int = field(default=0, init=False)  # steps that the mistake has explained since it was found
    _last: tuple[float, float, float] = field(default=(0.0, 0.0, 0.0), init=False)
    _filled: tuple[bool, bool] = field(default=(False, False), init=False)  # East and North have been other than zero
    _waiting: deque[tuple[float, float, float, float, float]] = field(default_factory=deque, init=False)
    _cross_sum: float = field(default=0.0, init=False)  # m^2: displacement times integral, of steps that agreed
    _power_sum: float = field(default=0.0, init=False)  # m^2: their squared integrals
    _is_not_ned: bool = field(default=False, init=False)
    _agreed: int = field(default=0, init=False)  # steps in motion that agreed, since the start

    @property
    def scale(self) -> float:
        """Displacement between fixes relative to the integrated velocity, where it is significantly not 1; else 1.0.

        The only error that all velocities of a receiver have in common is that of time: with a clock that stamps 8 %
        too few seconds the displacement is 8 % larger.
        """
        if self._power_sum == 0.0:
            return 1.0
        scale, sd = self._cross_sum / self._power_sum, 2.0 * self._steps.floor(1.0) / math.sqrt(self._power_sum)
        return scale if abs(scale - 1.0) > _SCALE_LEAST + _SCALE_SURE * sd else 1.0

    @property
    def stands_still(self) -> bool:
        """Whether positions hardly move compared with the velocity, so that they may be wrong instead."""
        return 0 <= self._found < len(LINEAR) and abs(LINEAR[self._found].a) + abs(LINEAR[self._found].b) < _NO_MOTION

    def forget_time(self) -> None:
        """The clock changed or the filter starts again: forget the samples, keep established errors."""
        self._steps.interrupt()
        self.climb.interrupt()
        self.late.interrupt()
        self._waiting.clear()
        self.is_new = True
        if not self.fault:
            self.suspect, self._odds = False, np.full(COUNT, _PRIOR)

    def velocity(self, t: float, east: float, north: float, up: float) -> None:
        """Add a velocity [m/s] valid at ``t`` [s], in the axes that the driver claims."""
        self._last = east, north, up
        if not all(self._filled):
            self._filled = self._filled[0] or east != 0.0, self._filled[1] or north != 0.0
        self.climb.velocity(east, north, up)
        steps, late = self._steps, self.late
        late.make_room()
        _note_velocity(steps.state, steps.velocities, late.state, late.sums, t, late.delay, east, north, up)
        self.is_new = late.evaluate(t) or self.is_new

    def expect_walk(self, walk: float) -> None:
        """Take the random walk of the integrated velocities that is not stated [m/sqrt(s)]."""
        if walk > 0.0 and self._steps.state[WALK] == 0.0:
            self.late.interrupt()  # what looked late may have been noise
        self._steps.state[WALK] = walk

    def fix(self, t: float, lat: float, lon: float, alt: float, sd: float = 0.0) -> None:
        """Add a position [rad, rad, m] valid at ``t`` [s] with the stated horizontal deviation ``sd`` [m].

        It is processed when a later one has arrived, because its own velocity may arrive after it.
        """
        if self._waiting and t <= self._waiting[-1][0]:
            return
        self._waiting.append((t, lat, lon, alt, sd))
        while self._waiting[0][0] + self.late.delay < t:
            self._compare(*self._waiting.popleft())

    def _compare(self, t: float, lat: float, lon: float, alt: float, sd: float) -> None:
        steps, climb = self._steps, self.climb
        found = _compare(steps.state, steps.velocities, climb.state, t, lat, lon, alt, sd, climb.baro)
        if found:
            self.is_new = True
            climb.conclude(found, alt)
            if found & _STEP:
                self._weigh(steps.end(t, lat, lon))

    def _weigh(self, step: Step) -> None:
        """Update the odds of all hypotheses by a step."""
        weight = step.weight
        is_informative = weight > _INFORMATIVE
        if is_informative:
            self._similarity.learn(step)
        is_sound, gains, explained = mistakes.odds_of(step, weight, self._similarity)
        if is_informative:
            self._learn(step, is_sound)
        if abs(step.integral) < step.floor and not self.fault:  # a velocity near zero shows neither axes nor unit
            gains[NOT_STUCK] = np.minimum(gains[NOT_STUCK], 0.0)
        self._is_not_ned = self._is_not_ned or bool(gains[NORTH_EAST] < -_REFUTED)
        if self._found >= 0:
            moves = abs(step.displacement) > _MOVES * step.floor or not self.stands_still
            self._confirmations += bool(moves and is_informative and explained[self._found])
        _add_up(self._odds, gains, _STANDSTILL * (1.0 - weight), self._found)
        # The axes and units of a driver do not change in flight; if the IMU confirms the velocity, an unexplained error
        # is in the positions.
        other_evidence = self._agreed >= _SETTLED, self.imu_agrees, self.climb.fault == DOWN and not self._is_not_ned
        odds = np.empty(COUNT)
        self._conclude(odds, int(_with_other_evidence(self._odds, other_evidence, odds)))

    def _learn(self, step: Step, agrees: bool) -> None:
        self.misfit = step.misfit
        if not self.fault and not self.suspect:
            self.late.add_step(step)
        if agrees and abs(step.displacement) > _MOVES * step.floor and not self.fault:
            self._agreed += 1
        if agrees and step.dense:
            self._cross_sum += (step.displacement * step.integral.conjugate()).real
            self._power_sum += abs(step.integral) ** 2

    def _conclude(self, odds: NDArray[np.float64], best: int) -> None:
        self.suspect = bool(odds[best] > (_CLEARED if self.suspect else _SUSPECT))
        if self.suspect:
            self.late.interrupt()
        self.sound_steps = 0 if self.suspect or self.fault else self.sound_steps + 1
        if self.fault and odds[self._found] <= _CLEARED and not self.suspect:
            self.fault, self.name, self.certain, self._found = "", "", False, -1
        if odds[best] > _PROVED and (not self.fault or odds[best] > odds[self._found] + _SUSPECT):
            self._found, self._confirmations = best, 0
            self.fault, self.name = self._in_words(best)
        if self.fault:
            others = max(value for i, value in enumerate(odds.tolist()) if not self._has_correction_of_found(i))
            self.certain = self._is_correctable() and bool(odds[self._found] - others > _MARGIN)

    def _is_correctable(self) -> bool:
        if not (self._similarity.is_known and all(self._filled)):
            return False
        if self._confirmations < _CONFIRMATIONS:
            return False
        by_turn = self.fault == mistakes.UNIT or self._similarity.has_changed_direction
        return self._found < len(LINEAR) or (self._found == SIMILAR and by_turn)

    def _has_correction_of_found(self, i: int) -> bool:
        """Whether hypothesis ``i`` has the same correction as the one found, or none at all."""
        if i in (self._found, ANY, SIMILAR):
            return True
        if self._found == SIMILAR:
            return i < len(LINEAR) and self._similarity.has_same_correction(LINEAR[i])
        return mistakes.is_near_unit(i) and mistakes.is_near_unit(self._found)

    def corrected(self, east: float, north: float) -> tuple[float, float]:
        """A velocity [m/s], corrected for the ``certain`` error."""
        velocity = complex(east, north)
        if self._found == SIMILAR:
            velocity *= self._similarity.factor
        elif mistakes.is_near_unit(self._found):
            velocity *= self._similarity.factor.real
        else:
            velocity = LINEAR[self._found].correct(velocity)
        return velocity.real, velocity.imag

    def _in_words(self, i: int) -> tuple[str, str]:
        """Kind and name of hypothesis ``i``."""
        if i < len(LINEAR):
            return LINEAR[i].kind, LINEAR[i].name
        if i == SIMILAR:
            return self._similarity.in_words()
        if i == STUCK:
            east, north, _ = self._last
            return mistakes.SILENT, "repeats" if east and north else "East" if north else "North" if east else ""
        return (mistakes.TURNED, "body") if i == BODY else (mistakes.UNEXPLAINED, "")


@kernel
def _note_velocity(steps, velocities, late, sums, t, delay, east, north, up):
    """Add a velocity valid at ``t`` [s], or ``delay`` [s] before that. Arguments as of ``take_velocity`` in
    ``velocity_steps`` and ``integrate`` in ``lateness``."""
    velocity_steps.take_velocity(steps, velocities, t - delay, east, north, up)
    lateness.integrate(late, sums, t, east, north)


@kernel
def _compare(steps, velocities, climb, t, lat, lon, alt, sd, baro):
    """Compare a fix with its own velocity; returns what that has ended or shows. Arguments as in ``take_fix`` of
    ``velocity_steps`` and ``take_height`` of ``climb_check``."""
    own, found = velocity_steps.own_velocity(steps, velocities, t), 0
    if own < 0:
        climb_check.end(climb)
    else:
        variance = steps[velocity_steps.VARIANCE]
        found = climb_check.take_height(climb, t, alt, velocities[own, 3], variance, baro)
    if velocity_steps.take_fix(steps, velocities, own, t, lat, lon, sd):
        found += _STEP
    return found


@kernel
def _add_up(odds, gains, decay, found):
    """Add the ``gains`` of a step to the ``odds`` (COUNT,), less ``decay`` for all but the mistake ``found``."""
    largest = -math.inf
    for i in range(COUNT):
        odds[i] += gains[i] if i == found else gains[i] - decay
        largest = max(largest, odds[i])
    beyond = max(largest - _MOST, 0.0)
    for i in range(COUNT):
        odds[i] = max(odds[i] - beyond, _PRIOR)


@kernel
def _with_other_evidence(odds, other_evidence, out):
    """Write the ``odds`` combined with ``other_evidence`` to ``out`` (COUNT,); returns the index of the largest.

    ``other_evidence``: whether axes and units are established, whether the IMU confirms the velocity, and whether the
    vertical velocity is positive down and nothing refutes North-East.
    """
    is_settled, imu_agrees, is_down = other_evidence
    best = 0
    for i in range(COUNT):
        excluded = (is_settled and not MAY_BEGIN_IN_FLIGHT[i]) or (imu_agrees and i == ANY)
        out[i] = _PRIOR if excluded else odds[i]
        if is_down and i == NORTH_EAST:
            out[i] += _DOWN_BONUS
        best = i if out[i] > out[best] else best
    return best
