"""What the digits of positions show: too few of them (a rounding driver), or the same ones again (a stuck receiver).

A driver that prints latitude and longitude with three decimals has a grid of 100 m. Such a position can be wrong by
half a step for as long as the vehicle stays in its cell, and no innovation shows it. But all fixes lie on the grid. A
fix of a receiver with a resolution of 1e-7 deg lies on a grid of 1e-3 deg with a probability of 1e-8.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from nav_pose_estimator.core.earth.ellipsoid import radii
from nav_pose_estimator.core.numerics.jit import kernel
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.samples import GnssFix
from nav_pose_estimator.engine.sensors.frozen import FROZEN, LIVE, Frozen, take_value
from nav_pose_estimator.engine.sensors.gnss.velocity_input import VelocityInput
from nav_pose_estimator.engine.solutions import Level

_GRIDS = sorted(
    [10.0**-k for k in range(1, 5)] + [10.0**-k / 60.0 for k in range(4)] + [1.0 / 3600.0, 0.1 / 3600.0], reverse=True
)
"""deg: decimals of a degree, of a minute, of a second. The error of a finer grid is below that of receivers."""
_CHOSEN_GRID = 1e-2  # deg: a place with two decimals may be the chosen start of a simulator without noise
_FIXES = 10  # smallest number of fixes, all of them since the start
_ON_GRID = 1e-6  # tolerance, relative to a step
_UNIFORM = 12.0**-0.5  # standard deviation of a uniform distribution over one step
_RADIAN = math.degrees(1.0)

_UNFILLED = FROZEN + 1  # another verdict on heights besides those of ``frozen``
_HEIGHT_FAULTS = {
    _UNFILLED: "it is exactly zero, as drivers send it that do not fill it",
    FROZEN: "it repeats to the last digit while latitude and longitude change",
}
"""Why heights are not used, one clause for the user."""
_STUCK = 4  # consecutive repetitions of a position after which the receiver may be stuck
_WEATHER = 0.02  # m/s: change of the barometric height by weather and warming up, which is no evidence
_CLIMBED = 4.0  # m: change of the barometric height at which a receiver's static hold should have ended
_HELD = 3.0  # s over which it must repeat: some drivers publish each fix of a slow receiver several times
_ALIKE = 1.25  # ratio of the times over which copies of a slow receiver's fixes repeat
_SLOWEST = 3.0  # s: longest such time
_LONGER = 1.5  # than a driver has repeated each fix of a slow receiver
_LEFT = 4.0  # m: displacement of the navigator beyond which a position that repeats is stuck, without velocities
CELLS = 2.0
"""Steps of the grid of rounded positions by which the vehicle must have moved, for a repeated position to be stuck."""
_ZEROS_UNFILLED = 2  # heights of exactly zero, from the start and at different positions, that show an unfilled field

# --- the state of ``Repeats``: index of each quantity, with its size if that is not 1 --------------------------------
_PLACE, _T = 0, 3  # (3) rad, rad, m: last fix, and its time [s]
_REPEATS, _STAYS = 4, 5  # its repetitions, and those of latitude and longitude
_INTEGRAL = 6  # (2) m: integral of the velocities when the position came for the first time, East and North
_HEIGHT = 8  # m: pressure altitude then, which follows the weather
_HEIGHT_T, _ZEROS = 9, 10  # s: last height; heights of zero so far (none once the field is filled)
_VERDICT = 11  # on the height
_SINCE = 12  # s: when the position came for the first time
_HOLDS = 13  # (2) s: how long the last two positions repeated, zero where they did not
_SIZE = 15


class Rounding:
    """The test. It receives every valid fix; ``sd`` (2,) [m] is the rounding error's deviation, East and North."""

    def __init__(self, journal: Journal) -> None:
        self._journal = journal
        self._grids = list(_GRIDS)  # grids on which all fixes lie, the coarsest first
        self._fixes = 0
        self._first: tuple[float, float] | None = None
        self._has_moved = False
        self.sd = (0.0, 0.0)

    @property
    def is_on(self) -> bool:
        """Whether positions are rounded."""
        return self.sd[1] > 0.0

    @property
    def step(self) -> float:
        """m: step of the grid, 0 where none is established."""
        return max(self.sd) / _UNIFORM

    @property
    def least_sd(self) -> float:
        """Floor of the standard deviation [m] on each axis, since rounding errors do not average out."""
        return max(self.sd)

    def fix(self, lat: float, lon: float, moves: bool, stamp_ns: int) -> None:
        """Add a position [rad], used or not; ``moves``: it repeats while the velocities show motion."""
        if not self._grids:
            return
        self._has_moved = self._has_moved or moves
        place = (lat * _RADIAN, lon * _RADIAN)
        if place == self._first:
            self._fixes += 1
        else:
            self._grids = [grid for grid in self._grids if all(_is_on(angle, grid) for angle in place)]
            self._fixes, self._has_moved = self._fixes + 1, self._has_moved or self._first is not None
            self._first = self._first or place
        was_on = self.is_on
        self._weigh(lat)
        if self.is_on and not was_on:
            text = f"{self.reason}; they are used with that error"
            self._journal.say(stamp_ns, "gnss.rounded", Level.WARN, text, step=self.step)
        elif was_on and not self.is_on:
            self._journal.say(stamp_ns, "gnss.rounded.ended", Level.INFO, "GNSS positions have more digits again")

    def _weigh(self, lat: float) -> None:
        may_be_chosen = not self._has_moved and _CHOSEN_GRID in self._grids
        if not self._grids or self._fixes < _FIXES or may_be_chosen:
            self.sd = (0.0, 0.0)
            return
        r_m, r_n = radii(lat)
        step = math.radians(self._grids[0])
        self.sd = (_UNIFORM * step * r_n * math.cos(lat), _UNIFORM * step * r_m)

    @property
    def reason(self) -> str:
        """Why the position is less certain than usual, one clause for the user; empty where it is not."""
        if not self.is_on:
            return ""
        return (
            f"GNSS positions lie on a grid of {self._grids[0]:.2g} deg ({self.step:.3g} m): the driver has lost digits"
        )


def _is_on(angle: float, grid: float) -> bool:
    """Whether ``angle`` [deg] is a multiple of ``grid``."""
    steps = angle / grid
    return abs(steps - round(steps)) < _ON_GRID


class Repeats:
    """Detection of positions that repeat exactly, and of a height that the driver never fills or that is frozen."""

    def __init__(self, journal: Journal) -> None:
        self._journal, self._frozen = journal, Frozen()
        self._state = np.full(_SIZE, math.nan)
        self._state[_T] = self._state[_HEIGHT_T] = -math.inf
        self._state[_REPEATS] = self._state[_STAYS] = self._state[_ZEROS] = 0.0
        self._state[_HOLDS:_SIZE] = 0.0
        self._state[_VERDICT] = LIVE
        self._verdict = LIVE  # on the height
        self.is_new = True
        """Whether the last fix differed from the one before it."""
        self.stuck_at: tuple[float, ...] = ()
        """Latitude and longitude [rad] at which the receiver was found stuck; empty without."""
        self.was_there = False

    @property
    def place(self) -> np.ndarray:
        """Latitude, longitude [rad] and height [m] (3,) of the last fix."""
        return self._state[_PLACE : _PLACE + 3]

    @property
    def is_copy(self) -> bool:
        """Whether the last fix is an old one with a new stamp: the two before it repeated as well, for as long."""
        short, long = sorted(self._state[_HOLDS:_SIZE].tolist())
        lasts = float(self._state[_T] - self._state[_SINCE])
        return not self.is_new and lasts <= _ALIKE * short and 0.0 < long <= min(_ALIKE * short, _SLOWEST)

    def count(self, t: float, velocities: VelocityInput) -> int:
        """How often latitude and longitude have repeated, for a while; 0 where velocities show whether that is right.

        They do not at ``t`` [s] if they are exactly zero, as of a receiver that holds its position. Where a driver has
        repeated the fixes of a slow receiver, it must take longer than that.
        """
        shows = velocities.is_fresh(t) and not velocities.is_zero
        needed = max(_HELD, _LONGER * float(self._state[_HOLDS:_SIZE].min()))
        lasts = self._state[_STAYS] >= _STUCK and self._state[_T] - self._state[_SINCE] >= needed
        return int(self._state[_STAYS]) if lasts and not shows else 0

    def find_stuck(self, moved: float, step: float) -> bool:
        """Whether the last position is newly found to be of a stuck receiver, as the vehicle has ``moved`` [m].

        It is refused until it changes. ``step`` [m]: grid of rounded positions, 0 without.
        """
        place = tuple(self.place[:2].tolist())
        if moved <= max(_LEFT, CELLS * step) or place == self.stuck_at:
            return False
        self.stuck_at, self.was_there = place, True
        return True

    def in_hindsight(self, later: Repeats) -> None:
        """Take the position at which ``later`` has found the receiver stuck, for a second pass over past samples."""
        self.stuck_at, self.was_there = later.stuck_at, False

    def note(self, sample: GnssFix, t: float, velocities: VelocityInput) -> float:
        """Displacement [m] by velocities while the position has repeated up to the fix valid at ``t`` [s].

        It is infinite if velocities repeat as well, are zero while the barometer climbs or sinks, or if the receiver
        was found stuck. An event reports a height that is not filled or frozen, and its recovery.
        """
        place, integral = (sample.lat, sample.lon, sample.alt), velocities.integral
        others = integral.real, integral.imag, velocities.pressure_altitude, velocities.is_zero, velocities.repeats
        was = self._verdict
        self.is_new, moved, self._verdict = _take_place(self._state, self._frozen.state, t, place, others)
        if self._verdict != was:
            self._report_height(was in _HEIGHT_FAULTS, sample.stamp_ns)
        if self.stuck_at:
            if self.stuck_at == place[:2]:
                self.was_there = True
                return math.inf
            if self.was_there:  # it has left
                self.stuck_at = ()
        return moved

    def _report_height(self, was_at_fault: bool, stamp_ns: int) -> None:
        reason = _HEIGHT_FAULTS.get(self._verdict)
        if reason and not was_at_fault:
            text = f"GNSS height not used: {reason}; it is the barometer's or held"
            self._journal.say(stamp_ns, "gnss.height.stuck", Level.WARN, text)
        elif was_at_fault and not reason:
            self._journal.say(stamp_ns, "gnss.height.stuck.ended", Level.INFO, "GNSS heights change again")

    def without_bad_height(self, sample: GnssFix) -> GnssFix:
        """The fix, without its height while that is or may be at fault."""
        return sample if self._verdict == LIVE else replace(sample, alt=math.nan)


@kernel
def _take_place(state, frozen, t, place, others):
    """``Repeats.note``; ``others``: integral of the velocities [m], East and North, pressure altitude [m], whether the
    velocity is zero, and how often it has been repeated. Returns also ``is_new`` and the verdict on the height."""
    integral_east, integral_north, altitude, is_zero, repeated = others
    stays = place[0] == state[_PLACE] and place[1] == state[_PLACE + 1]
    repeats = stays and place[2] == state[_PLACE + 2]
    if not stays:
        state[_HOLDS] = state[_HOLDS + 1]
        state[_HOLDS + 1] = state[_T] - state[_SINCE] if state[_STAYS] > 0.0 else 0.0
    state[_STAYS] = state[_STAYS] + 1.0 if stays else 0.0
    state[_REPEATS] = state[_REPEATS] + 1.0 if repeats else 0.0
    for axis in range(3):
        state[_PLACE + axis] = place[axis]
    if not stays:
        state[_INTEGRAL], state[_INTEGRAL + 1], state[_HEIGHT] = integral_east, integral_north, altitude
        state[_SINCE] = t
    climbed = altitude - state[_HEIGHT]
    if t > state[_T] > -math.inf and math.isfinite(climbed):
        state[_HEIGHT] += math.copysign(min(abs(climbed), _WEATHER * (t - state[_T])), climbed)
    state[_T] = t
    if not repeats and not math.isnan(place[2]) and t > state[_HEIGHT_T]:
        _take_height(state, frozen, t, place[2])
    moved = 0.0
    if state[_STAYS] >= _STUCK:
        held = is_zero and abs(climbed) > _CLIMBED
        moved = math.hypot(integral_east - state[_INTEGRAL], integral_north - state[_INTEGRAL + 1])
        if held or min(state[_REPEATS], repeated) >= _STUCK:
            moved = math.inf
    return not repeats, moved, int(state[_VERDICT])


@kernel
def _take_height(state, frozen, t, alt):
    """Judge the height [m] of a fix that differs from the one before it."""
    state[_HEIGHT_T] = t
    if alt != 0.0:
        state[_ZEROS] = -math.inf  # it is filled
    state[_ZEROS] += 1.0
    verdict = take_value(frozen, t, alt)
    state[_VERDICT] = _UNFILLED if state[_ZEROS] >= _ZEROS_UNFILLED else verdict
