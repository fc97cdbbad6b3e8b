"""Consistency of GNSS height and vertical velocity, with the barometer as the arbiter.

Over a climb the integral of the vertical velocities must equal the change of height. A barometer, where there is one,
shows which of them is wrong: the velocity (not filled in, positive down) or the height (in another unit, positive
down). Without a barometer, a height that changes as if in feet is: a velocity whose horizontal components fit the
displacements between fixes is in no other unit vertically. Without a clock: time comes with the samples, in seconds
since the engine's epoch.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.numerics.jit import kernel

_PAUSE = 6.0  # s: longest pause over which velocities are integrated
_LONGEST = 20.0  # s: longest climb, so that velocity biases of 0.1 m/s do not matter
_SCATTER_LEAST = 2.0  # m: smallest tolerance of a difference of heights
_RELATIVE_TOLERANCE = 0.3  # relative tolerance of a climb
_STEEPEST = 60.0  # m/s: faster changes of the height are jumps
_CLIMB = 6.0  # m: smallest climb that is evaluated
_CLIMB_TO_SCATTER = 3.0  # ... and its smallest ratio to the tolerance
_PROOF = 2  # consecutive climbs that establish a fault
_CLEAR = 3  # consecutive climbs that clear it
_UNFILLED = 10  # samples with a vertical velocity of exactly zero from the start, after which it is suspect
_HIGH, _NO_WEATHER = 300.0, 500.0  # m: height above which a unit is tested; difference that weather cannot cause
_UNIT_TOLERANCE = 0.25  # relative tolerance of a ratio that identifies a unit

SILENT, DOWN, OTHER = "silent", "down", "other"
"""Faults of a vertical velocity: not filled in; positive down; wrong in another way according to the barometer."""
_HEIGHT = "height"
_VERDICTS = "", SILENT, DOWN, OTHER, "?", _HEIGHT
"""Results of a climb: height and velocity agree, or the fault that explains it."""
_IS_SOUND, _IS_SILENT, _IS_DOWN, _IS_OTHER, _IS_UNCLEAR, _IS_HEIGHT = range(len(_VERDICTS))
_FEET = 3.281  # 1 m
_UNITS = {"in feet": _FEET, "in cm": 100.0, "in mm": 1000.0, "positive down": -1.0}
"""Value of 1 m in that unit."""


# --- the state of the climb in progress: index of each quantity ------------------------------------------------------
_T, _UP, _ALT = 0, 1, 2  # s, m/s, m: last height; the time is NaN while there is no climb
_BEGIN, _START, _BARO_START = 3, 4, 5  # s, m, m: its beginning, by heights and by the barometer (NaN without one)
_INTEGRAL = 6  # m: integral of the vertical velocities
_VERDICT = 7  # on the last climb: index in ``_VERDICTS``
_RATIO = 8  # of its height change to the barometer's, or to the integral without one
_SIZE = 9
ENDED, FAR = 1, 2
"""Results of ``take_height``, to be added: a climb has ended; the height is far from the barometer's."""


@dataclass(eq=False, slots=True)
class ClimbCheck:
    """The test. It receives every height with its vertical velocity.

    ``fault`` is the established fault of the velocity, or empty; ``height_fault`` that of the height.
    """

    fault: str = field(default="", init=False)
    height_fault: str = field(default="", init=False)
    suspect: bool = field(default=False, init=False)
    """Whether the last climb contradicted the velocity, or it alone of all components has been exactly zero so far."""
    baro: float = field(default=math.nan, init=False)
    """To be set by the caller: pressure altitude [m] of the barometer."""
    _zeros: float = field(default=0.0, init=False)
    state: NDArray[np.float64] = field(default_factory=lambda: np.full(_SIZE, math.nan), init=False)
    """State of ``take_height``."""
    _verdicts: tuple[str, ...] = field(default=(), init=False)
    _unit: str = field(default="", init=False)  # in which the last wrong height seemed to be

    @property
    def goes_up(self) -> bool:
        """Whether the last climb confirmed a velocity that is positive up."""
        return bool(self._verdicts) and not self._verdicts[-1]

    @property
    def goes_down(self) -> bool:
        """Whether the last climb confirmed a velocity that is positive down."""
        return bool(self._verdicts) and self._verdicts[-1] == DOWN

    def interrupt(self) -> None:
        """End the climb: the next samples do not follow the last ones."""
        self.state[_T] = math.nan  # not by ``end``: a restart would wait for its compilation

    def velocity(self, east: float, north: float, up: float) -> None:
        """Add a velocity [m/s] as received."""
        if up != 0.0:
            if self._zeros < math.inf and not self._verdicts:
                self.suspect = False  # the field is filled
            self._zeros = math.inf
        elif east != 0.0 and north != 0.0 and self._zeros < math.inf:
            self._zeros += 1
            self.suspect = self.suspect or self._zeros >= _UNFILLED

    def conclude(self, found: int, alt: float) -> None:
        """Conclude from what ``take_height`` has ``found`` with a height ``alt`` [m]."""
        if found & FAR and (unit := _unit(alt / self.baro)):
            self.height_fault = unit
        if found & ENDED:
            verdict, ratio = self.state[_VERDICT:].tolist()
            self._note(_VERDICTS[int(verdict)], ratio)

    def _note(self, verdict: str, ratio: float) -> None:
        if verdict == _HEIGHT:
            self._unit = _unit(ratio) or "in another unit, or stuck"
        self._verdicts = (*self._verdicts, verdict)[-_CLEAR:]
        self.suspect = verdict in (SILENT, DOWN, OTHER)
        last = self._verdicts[-_PROOF:]
        if len(last) == _PROOF and last[0] == last[1] and last[0] in (SILENT, DOWN):
            self.fault = last[0]
        elif self._verdicts == (OTHER,) * _CLEAR:
            self.fault = OTHER
        elif len(last) == _PROOF and last[0] == last[1] == _HEIGHT:
            self.height_fault = self._unit
        elif len(self._verdicts) == _CLEAR and not any(self._verdicts):
            self.fault = self.height_fault = ""


@kernel
def take_height(state, t, alt, up, variance, baro):
    """Add a height [m] at ``t`` [s] with the vertical velocity [m/s] of its epoch; returns what it shows.

    ``variance`` [m^2] of a fix; ``baro`` [m]: pressure altitude, NaN without a barometer.
    """
    found = FAR if baro > _HIGH and abs(alt - baro) > _NO_WEATHER else 0
    if not math.isfinite(alt + up):
        end(state)
        return found
    seconds = t - state[_T]
    follows = seconds <= _PAUSE and t - state[_BEGIN] <= _LONGEST
    if not follows or abs(alt - state[_ALT]) > _STEEPEST * seconds + _SCATTER_LEAST:  # heights that jump are not used
        _begin(state, t, alt, up, baro)
        return found
    state[_INTEGRAL] += 0.5 * seconds * (state[_UP] + up)
    state[_T], state[_UP], state[_ALT] = t, up, alt
    height_change, integral, baro_change = alt - state[_START], state[_INTEGRAL], baro - state[_BARO_START]
    scatter = max(_SCATTER_LEAST, 8.0 * math.sqrt(variance))  # heights scatter twice as much
    climbed = max(min(abs(height_change), abs(baro_change)), abs(integral))
    if climbed < max(_CLIMB, _CLIMB_TO_SCATTER * scatter):
        return found
    undecided = abs(height_change - integral) > scatter and max(abs(height_change), abs(integral)) < 2.0 * _CLIMB
    if undecided and _agree(height_change, integral, scatter):
        return found  # a longer climb decides
    state[_VERDICT] = _verdict(height_change, integral, baro_change, scatter)
    standard = baro_change if math.isfinite(baro_change) else integral
    state[_RATIO] = height_change / standard if standard != 0.0 else math.inf
    _begin(state, t, alt, up, baro)
    return found + ENDED


@kernel
def end(state):
    """End the climb."""
    state[_T] = math.nan


@kernel
def _begin(state, t, alt, up, baro):
    """Begin a climb."""
    state[_T], state[_UP], state[_ALT] = t, up, alt
    state[_BEGIN], state[_START], state[_BARO_START] = t, alt, baro
    state[_INTEGRAL] = 0.0


@kernel
def _verdict(height_change, integral, baro_change, scatter):
    """Result of a climb, as an index in ``_VERDICTS``."""
    if _agree(height_change, integral, scatter):
        return _IS_SOUND
    if math.isfinite(baro_change) and not _agree(height_change, baro_change, scatter):
        return _IS_HEIGHT if _agree(integral, baro_change, scatter) else _IS_UNCLEAR
    if _agree(height_change, -integral, scatter):
        return _IS_DOWN
    if abs(integral) < 0.1 * abs(height_change):
        return _IS_SILENT
    if math.isnan(baro_change) and abs(height_change / integral / _FEET - 1.0) < _UNIT_TOLERANCE:
        return _IS_HEIGHT
    return _IS_OTHER if math.isfinite(baro_change) and abs(height_change) > 0.6 * _CLIMB else _IS_UNCLEAR


@kernel
def _agree(a, b, scatter):
    """Whether two climbs [m] agree."""
    return abs(a - b) <= scatter + _RELATIVE_TOLERANCE * max(abs(a), abs(b))


def _unit(ratio: float) -> str:
    """Error of a height that is ``ratio`` times the true one, in words; empty where nothing fits."""
    return next((words for words, numbers in _UNITS.items() if abs(ratio / numbers - 1.0) < _UNIT_TOLERANCE), "")
