"""Detection of rest from the IMU alone: ``RestDetector`` for an alignment, ``Stillness`` for a running filter.

The detector keeps mean and standard deviation of rate and force over a sliding window, at constant cost per sample. The
bias of the gyroscope is still unknown then, so a steady turn may look like rest to it. The window consists of blocks of
equal duration; the oldest block is dropped when a new one is complete. The window thus slides in steps of a seventh of
its length, and no sum runs on for ever and loses its digits. The state is one float64 vector: a snapshot is one copy.
"""

import math
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nav_pose_estimator.core.numerics.jit import kernel
from nav_pose_estimator.core.numerics.units import STANDARD_GRAVITY

BLOCKS = 8
_AXES = 6  # rate and force
_COUNT, _START, _SUM, _SQUARES, _BLOCK = 0, 1, 2, 8, 14  # layout of one block
_CURRENT = BLOCKS * _BLOCK  # index of the block that is being filled
_BASE = _CURRENT + 1  # 6: the first sample; the sums are of differences from it, which keeps their precision
_LAST = _BASE + _AXES
_STATE = _LAST + 1

_MEAN, _SD, _RESULT = 0, _AXES, 2 * _AXES

_PROOF = 3  # consecutive calm seconds that ``Stillness`` requires
_SECOND = 1.0  # s: length of one block of IMU rows that ``Stillness`` receives
_PARTS = 10  # parts of a second: means over one of them average out vibration, but not swaying
# Limits of the standard deviations, from recorded flights and parked vehicles (see ``Stillness``).
_CALM_RATE, _CALM_FORCE = 0.01, 0.35  # rad/s, m/s^2: of the samples of one second
_SWAY_RATE, _SWAY_FORCE = 0.003, 0.05  # rad/s, m/s^2: of the means over tenths of a second


@dataclass(frozen=True, slots=True)
class RestSettings:
    """Thresholds of ``RestDetector``."""

    window: float  # s
    gyro_sd: float  # rad/s, largest standard deviation of an axis
    accel_sd: float  # m/s^2, largest standard deviation of an axis
    rate: float  # rad/s, largest mean rate beside ``offset`` that passes for a bias and not for a turn
    force: float  # m/s^2, largest difference of the mean force's norm from gravity
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)  # rad/s, known bias of the gyroscope
    gravity: float = STANDARD_GRAVITY  # m/s^2


@dataclass(init=False, eq=False, slots=True)
class RestDetector:
    """Tests whether the last ``window`` seconds were at rest, and gives their mean rate and force."""

    settings: RestSettings
    state: NDArray[np.float64]
    at_rest: bool
    full: bool  # whether a whole window has been seen
    _statistics: NDArray[np.float64]

    def __init__(self, settings: RestSettings) -> None:
        self.settings = settings
        self.state, self._statistics = np.empty(_STATE), np.empty(_RESULT)
        self.reset()

    def reset(self) -> None:
        """Forget all samples."""
        self.state.fill(0.0)
        self.state[_LAST] = -math.inf
        self._statistics.fill(math.nan)
        self.at_rest = self.full = False

    def update(self, t: float, gyro: ArrayLike, accel: ArrayLike) -> bool:
        """Take one sample (time [s], rate [rad/s], force [m/s^2], body frame); returns ``at_rest``."""
        s = self.settings
        if push(self.state, s.window, t, gyro, accel):
            self.full = summarise(self.state, self._statistics)
            self.at_rest = self.full and self._is_quiet()
        return self.at_rest

    @property
    def mean_rate(self) -> NDArray[np.float64]:
        """Mean angular rate (3,) over the window [rad/s]; NaN before the first window is full."""
        return self._statistics[_MEAN : _MEAN + 3].copy()

    @property
    def mean_force(self) -> NDArray[np.float64]:
        """Mean specific force (3,) over the window [m/s^2]."""
        return self._statistics[_MEAN + 3 : _MEAN + 6].copy()

    @property
    def rate_sd(self) -> NDArray[np.float64]:
        """Standard deviation (3,) of the angular rate over the window [rad/s]."""
        return self._statistics[_SD : _SD + 3].copy()

    @property
    def force_sd(self) -> NDArray[np.float64]:
        """Standard deviation (3,) of the specific force over the window [m/s^2]."""
        return self._statistics[_SD + 3 : _SD + 6].copy()

    def why_not(self) -> str:
        """The test that failed worst, in a few words for the user; empty at rest."""
        s, stats = self.settings, self._statistics
        if not self.full:
            return f"{s.window:g} s of IMU data"
        checks = (
            (max(stats[_SD : _SD + 3]), s.gyro_sd, "rotation", "rad/s"),
            (max(stats[_SD + 3 : _SD + 6]), s.accel_sd, "vibration", "m/s^2"),
            (math.dist(stats[:3], s.offset), s.rate, "mean rotation", "rad/s"),
            (abs(math.hypot(*stats[3:6]) - s.gravity), s.force, "force against gravity", "m/s^2"),
        )
        value, limit, name, unit = max(checks, key=lambda check: check[0] / check[1])
        return "" if value <= limit else f"{name} {value:.2g} {unit}, more than {limit:g}"

    def _is_quiet(self) -> bool:
        return self.why_not() == ""


@kernel
def push(state, window, t, gyro, accel):
    """Add a sample to ``state``; True when it completed a block. Samples not later than the last are ignored."""
    if not t > state[_LAST]:
        return False
    if t - state[_LAST] > window:  # first sample, or a gap as long as the window
        for i in range(_CURRENT):
            state[i] = 0.0
        state[_CURRENT] = 0.0
        state[_START] = t
        for i in range(3):
            state[_BASE + i] = gyro[i]
            state[_BASE + 3 + i] = accel[i]
    state[_LAST] = t
    block = int(state[_CURRENT]) * _BLOCK
    done = t - state[block + _START] >= window / (BLOCKS - 1)
    if done:
        state[_CURRENT] = (int(state[_CURRENT]) + 1) % BLOCKS
        block = int(state[_CURRENT]) * _BLOCK
        for i in range(_BLOCK):
            state[block + i] = 0.0
        state[block + _START] = t
    state[block + _COUNT] += 1.0
    for i in range(_AXES):
        value = (gyro[i] if i < 3 else accel[i - 3]) - state[_BASE + i]
        state[block + _SUM + i] += value
        state[block + _SQUARES + i] += value * value
    return done


@kernel
def summarise(state, out):
    """Write mean (6,) and deviation (6,) of all complete blocks to ``out``; False while the window is not full.

    A window is full when all blocks but the one just begun hold samples.
    """
    current = int(state[_CURRENT])
    count = 0.0
    for b in range(BLOCKS):
        if b != current:
            if state[b * _BLOCK + _COUNT] == 0.0:
                return False
            count += state[b * _BLOCK + _COUNT]
    for i in range(_AXES):
        total, squares = 0.0, 0.0
        for b in range(BLOCKS):
            if b != current:
                total += state[b * _BLOCK + _SUM + i]
                squares += state[b * _BLOCK + _SQUARES + i]
        mean = total / count
        out[_MEAN + i] = state[_BASE + i] + mean
        out[_SD + i] = math.sqrt(max(squares / count - mean * mean, 0.0))
    return True


@dataclass(eq=False, slots=True)
class Stillness:
    """Strict test for rest: three consecutive seconds with neither vibration nor swaying.

    It is stricter than the test of an alignment, because a false detection in flight would do harm. On recorded flights
    the standard deviation of the gyroscope was at least 0.016 rad/s in every second in the air, and 0.0003 to
    0.002 rad/s with the motors off. A simulated hover without vibration still sways by 0.005 rad/s. Steady motion is
    indistinguishable from rest here: the caller has to check the speed, and the mean rate against the gyroscope bias.
    """

    PERIOD: ClassVar[float] = _SECOND
    """s of IMU rows that each call of ``add`` receives."""

    _tenths: NDArray[np.float64] = field(default_factory=lambda: np.zeros((_PROOF * _PARTS, _AXES)), init=False)
    """Means over tenths of a second, the newest last."""
    _calm: int = field(default=0, init=False)
    """Consecutive seconds without vibration."""

    def add(self, rows: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """Take the IMU rows (N, 7) [t, rate, force] of one second.

        Returns the mean rate (3,) [rad/s] over the last three seconds if they were at rest, else None.
        """
        tenths = self._tenths
        tenths[:-_PARTS] = tenths[_PARTS:]
        self._calm = self._calm + 1 if calm_tenths(rows, tenths[-_PARTS:]) else 0
        mean = np.empty(_AXES)
        return mean[:3] if self._calm >= _PROOF and is_still(tenths, mean) else None


@kernel
def calm_tenths(rows, tenths):
    """Means (_PARTS, 6) over the tenths of one second of IMU rows (N, 7); False unless complete and without vibration.

    False, too, where all values of a sensor are equal: it is stuck.
    """
    count = len(rows)
    if count < _PARTS or rows[count - 1, 0] - rows[0, 0] < 0.8 * _SECOND:
        return False
    gyro_changes = accel_changes = False
    for axis in range(_AXES):
        end, mean, square, changes = 0, 0.0, 0.0, False
        for part in range(_PARTS):
            begin, end = end, end + count // _PARTS + (1 if part < count % _PARTS else 0)
            total = 0.0
            for i in range(begin, end):
                total += float(rows[i, 1 + axis])
            tenths[part, axis] = total / (end - begin)
            mean += total / count
        first = float(rows[0, 1 + axis])
        for i in range(count):
            value = float(rows[i, 1 + axis])
            changes = changes or value != first
            square += (value - mean) ** 2
        if not math.sqrt(square / count) < (_CALM_RATE if axis < 3 else _CALM_FORCE):
            return False
        gyro_changes = gyro_changes or (changes and axis < 3)
        accel_changes = accel_changes or (changes and axis >= 3)
    return gyro_changes and accel_changes


@kernel
def is_still(tenths, mean):
    """Whether the means over tenths of a second (N, 6) stay within the limits of swaying.

    ``mean`` (6,) receives their mean; where the result is False, the axes after the failing one are not written.
    """
    count = len(tenths)
    for axis in range(_AXES):
        total, square = 0.0, 0.0
        for i in range(count):
            total += tenths[i, axis]
        mean[axis] = total / count
        for i in range(count):
            square += (tenths[i, axis] - mean[axis]) ** 2
        if not math.sqrt(square / count) < (_SWAY_RATE if axis < 3 else _SWAY_FORCE):
            return False
    return True
