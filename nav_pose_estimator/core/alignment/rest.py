"""Is the vehicle at rest? Two answers: ``RestDetector`` for an alignment, ``Stillness`` for a filter that flies.

The detector has means and spreads of rate and force over a sliding window, at constant cost per sample. It must bear a
gyroscope whose offset nobody knows yet, so a steady turn may look like rest to it. The window is made of blocks of
equal duration, and the oldest one leaves when a new one is complete. So the cost does not depend on the sample rate,
nothing is summed for ever, and the window slides in steps of a seventh of its length.
All memory is one float64 vector: a snapshot is one copy.
"""

import math
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nav_pose_estimator.core.numerics.jit import kernel

BLOCKS = 8
_AXES = 6  # rate and force
_COUNT, _START, _SUM, _SQUARES, _BLOCK = 0, 1, 2, 8, 14  # layout of one block
_CURRENT = BLOCKS * _BLOCK  # index of the block that is being filled
_BASE = _CURRENT + 1  # 6: the first sample; sums are of differences from it, which keeps their digits
_LAST = _BASE + _AXES
_STATE = _LAST + 1

_MEAN, _SD, _RESULT = 0, _AXES, 2 * _AXES

_PROOF = 3  # seconds in a row that prove stillness
_SECOND = 1.0  # s
_PARTS = 10  # of a second, over which vibration averages out and swaying does not
_CALM_RATE, _CALM_FORCE = 0.01, 0.35  # rad/s, m/s^2: spread of the samples of a second
_SWAY_RATE, _SWAY_FORCE = 0.003, 0.05  # rad/s, m/s^2: spread of the means over tenths of a second


@dataclass(frozen=True, slots=True)
class RestSettings:
    """Thresholds of ``RestDetector``."""

    window: float  # s
    gyro_sd: float  # rad/s, largest spread of each axis
    accel_sd: float  # m/s^2
    rate: float  # rad/s, largest mean rate beside ``offset``: a bias, not a turn
    force: float  # m/s^2, largest difference of the mean force from gravity
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)  # rad/s, what is known of the gyroscope's offset
    gravity: float = 9.80665  # m/s^2


@dataclass(init=False, eq=False, slots=True)
class RestDetector:
    """Says whether the last ``window`` seconds were at rest, and their mean rate and force."""

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
        """Spread (3,) of the angular rate over the window [rad/s]."""
        return self._statistics[_SD : _SD + 3].copy()

    @property
    def force_sd(self) -> NDArray[np.float64]:
        """Spread (3,) of the specific force over the window [m/s^2]."""
        return self._statistics[_SD + 3 : _SD + 6].copy()

    def why_not(self) -> str:
        """What speaks against rest, in a few words; empty at rest."""
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
    """Add one sample to ``state``; True when a block has been completed. Samples that are not later are left out."""
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
    """Write mean (6,) and spread (6,) of all complete blocks to ``out``; False while the window is not full.

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


@dataclass(eq=False)
class Stillness:
    """Proof that nothing moves: three seconds in a row without a trace of vibration or swaying.

    It is stricter than an alignment has to be, because it speaks in flight as well. On recorded flights rotors and
    airframes shook the gyroscope by 0.016 rad/s and more in every second in the air, by 0.0003 to 0.002 rad/s with
    motors off; a simulated hover without vibration still sways by 0.005 rad/s. A steady motion leaves no trace at all:
    whoever asks must know the speed, and the gyroscope's bias.
    """

    PERIOD: ClassVar[float] = _SECOND
    """s of IMU that ``add`` is given."""

    _tenths: NDArray[np.float64] = field(default_factory=lambda: np.zeros((_PROOF * _PARTS, _AXES)), init=False)
    """Means over tenths of a second, the newest last."""
    _calm: int = field(default=0, init=False)
    """Seconds in a row that were calm."""

    def add(self, rows: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """Take the IMU rows (N, 7) [t, rate, force] of one second.

        Returns the mean rate (3,) [rad/s] over the last three seconds when they were still, else None.
        """
        tenths = self._tenths
        tenths[:-_PARTS] = tenths[_PARTS:]
        self._calm = self._calm + 1 if calm_tenths(rows, tenths[-_PARTS:]) else 0
        mean = np.empty(_AXES)
        return mean[:3] if self._calm >= _PROOF and is_still(tenths, mean) else None


@kernel
def calm_tenths(rows, tenths):
    """Means (_PARTS, 6) over the tenths of one second of IMU rows (N, 7); False unless complete and without vibration.

    Values that are exactly equal prove nothing: such a sensor is stuck.
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
    """Whether means over tenths of a second (N, 6) do not sway; ``mean`` (6,) receives theirs as far as it is known."""
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
