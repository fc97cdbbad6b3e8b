"""Does a velocity in body axes change as the IMU feels? And if not, which usual mistake would explain it?

Over a second the velocity over ground changes by the impulse of the specific force and of gravity. Both are taken into
the axes that the body had at the window's beginning, by the gyroscope alone: there gravity is constant, and so are a
wrong tilt and an accelerometer's bias. So each loses its mean over the window, and what varies must be equal. Nothing
is asked of a navigator, which a wrong velocity would have bent, nor of GNSS. Only a wrong size of all components alike
needs it: in steady motion nothing varies, and the speed over ground tells.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.alignment.motion_history import ANGLE, BINS
from nav_pose_estimator.core.numerics.rotation import quat_from_rotvec, quat_multiply, quat_to_matrix

Array = NDArray[np.float64]
_PARTS = 5  # parts of a second, of each of which the rotation is taken for one
_RECENT = 100  # velocities whose noise is looked at
_BENDS = 1.18  # median of the squared bend, in parts of the summed variances: 1.5 times that of chi^2(3), 2.37, over 3
_DIFFERENCES = 10.0  # squared differences of seconds less their mean: 2 x 6 x 5/6, of the sum of three variances
_NEAR = 0.15  # s around a whole second of which the median velocity counts
_ROTATIONS = 24  # by which the horizontal axes may be turned: every 15 deg
_LATE = (0.4, 0.8, 1.2)  # s
_UNITS = {"knots": 1.944, "ft/s": 3.281, "km/h": 3.6, "cm/s": 100.0, "mm/s": 1000.0}
_MEMORY = 0.9  # of what has been seen, from one window to the next
_VARIES = 0.8  # m/s, root of the sum of squares in a window that says anything
_NOISE_SHARE = 0.3  # of that which the sensor's noise may be
_UNLIKE = 0.2  # share of what varies that a sound velocity does not leave ...
_ALIKE = 0.1  # ... and below which it is sound; in simulated flights it leaves 0.03, and 0.1 at most
_BETTER, _FITS = 0.35, 0.15
"""Of that, and of what varies, a mistake that is to be named leaves less."""
_SUSPECT, _PROOF = 2, 3  # windows in a row
_UNNAMED, _QUITE_UNLIKE = 6, 0.5  # ... for a mistake that has no name, and the share that is left then
_MOVES = 1.0  # m/s of speed that tell a unit
_SIZE, _SCATTER = 0.12, 0.1  # of a speed: wrong by more, and as steadily
_ENOUGH = 12  # seconds of it


class Mistake(NamedTuple):
    """True from measured axes (3, 3), the age of what is measured [s], and words for a pilot."""

    axes: Array
    late: float
    words: str


def _mistakes() -> list[Mistake]:
    """None first. Of those that are alike for a level vehicle the simpler one comes first."""
    found = [Mistake(np.eye(3), 0.0, "")]
    named = {
        (1.0, -1.0, -1.0): "its axes look like Forward-Right-Down",
        (-1.0, -1.0, -1.0): "its sign looks inverted",
        (1.0, -1.0, 1.0): "its y axis looks inverted",
        (-1.0, 1.0, 1.0): "its x axis looks inverted",
        (1.0, 1.0, -1.0): "its z axis looks inverted",
    }
    found += [Mistake(np.diag(signs), 0.0, words) for signs, words in named.items()]
    for k in range(1, _ROTATIONS):
        angle = 2.0 * math.pi * k / _ROTATIONS
        c, s = math.cos(angle), math.sin(angle)
        turned = f"its axes look turned by {round(math.degrees(math.remainder(angle, 2.0 * math.pi)))} deg about z"
        found.append(Mistake(np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), 0.0, turned))
    for order, signs in itertools.product([(1, 0, 2), (0, 2, 1), (2, 1, 0)], [(1.0, 1.0, 1.0), (1.0, 1.0, -1.0)]):
        matrix = np.zeros((3, 3))
        matrix[range(3), order] = signs
        found.append(Mistake(matrix, 0.0, "two of its axes look exchanged"))
    found += [Mistake(np.eye(3) / size, 0.0, f"it looks like {unit} instead of m/s") for unit, size in _UNITS.items()]
    found += [Mistake(np.eye(3), late, f"it looks {late:g} s late against its stamps") for late in _LATE]
    return found


@dataclass(eq=False)
class BodyMotion:
    """Tell it every velocity, and every window of whole seconds of the IMU."""

    suspect: bool = field(default=False, init=False)
    """Whether the last window that says anything contradicts the velocity."""
    fault: str = field(default="", init=False)
    """What is wrong beyond doubt, a clause; empty if nothing is known to be."""
    _mistakes: list[Mistake] = field(default_factory=_mistakes, init=False)
    _velocities: deque[tuple[float, Array]] = field(default_factory=lambda: deque(maxlen=1000), init=False)
    _left: Array = field(init=False)
    _is_size: bool = field(default=False, init=False)  # whether the fault is one of size
    _varied: float = field(default=0.0, init=False)
    _unlike: int = field(default=0, init=False)
    _strange: int = field(default=0, init=False)
    _alike: int = field(default=0, init=False)
    _wins: Array = field(init=False)
    _sizes: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=60), init=False)

    def __post_init__(self) -> None:
        self._left, self._wins = np.zeros(len(self._mistakes)), np.zeros(len(self._mistakes), int)

    def forget_time(self) -> None:
        """The clock is another one: forget samples, keep what they have proved."""
        self._velocities.clear()
        self._sizes.clear()

    def velocity(self, t: float, velocity: Array) -> None:
        """A velocity (3,) [m/s] in b valid at ``t`` [s]; one with an axis that is not measured says nothing here."""
        if np.isfinite(velocity).all() and (not self._velocities or t > self._velocities[-1][0]):
            self._velocities.append((t, velocity))

    def compare(self, begin: float, seconds: Array, gyro_bias: Array, felt: Array, over_ground: Array) -> None:
        """Compare a window: ``seconds`` (S, 2, BINS, 3) of the IMU from ``begin`` [s] on (``motion_history``).

        ``gyro_bias`` (3,) [rad/s] is in their rates; ``felt`` (S, 3) [m/s] are their impulses without it.
        ``over_ground`` (N, 4): times [s] and velocities ENU [m/s] of GNSS.
        """
        if not self._velocities or self._velocities[-1][0] < begin:
            return
        times = begin + np.arange(len(seconds) + 1.0)
        measured = {late: self._at(times + late) for late in (0.0, *_LATE)}
        if measured[0.0] is None:
            return
        self._compare_sizes(times, measured[0.0], over_ground)
        felt = felt - felt.mean(axis=0)
        varied = float(np.vdot(felt, felt))
        noise = self._noise()
        if not varied > max(_VARIES**2, noise / _NOISE_SHARE):
            return
        rotations = _attitudes(seconds[:, ANGLE] - gyro_bias / BINS)
        left = np.full(len(self._mistakes), math.inf)
        for i, mistake in enumerate(self._mistakes):
            velocities = measured[mistake.late]
            if velocities is None:
                continue
            changes = np.diff(np.einsum("kij,kj->ki", rotations, velocities @ mistake.axes.T), axis=0)
            changes -= changes.mean(axis=0)
            left[i] = max(float(np.square(changes - felt).sum()) - noise, 0.0)
        self._weigh(left, varied)

    def _weigh(self, left: Array, varied: float) -> None:
        """A window that says something: squares (H,) that each mistake leaves of those that have ``varied``."""
        self._left = _MEMORY * self._left + np.minimum(left, 4.0 * varied)
        self._varied = _MEMORY * self._varied + varied
        wins = (left < _BETTER * left[0]) & (left[0] > _ALIKE * varied)
        self._wins = np.where(wins, self._wins + 1, 0)
        self._unlike = self._unlike + 1 if left[0] > _UNLIKE * varied else 0
        self._strange = self._strange + 1 if left[0] > _QUITE_UNLIKE * varied else 0
        self._alike = self._alike + 1 if left[0] < _ALIKE * varied else 0
        self.suspect = self._unlike >= _SUSPECT or (self.suspect and not self._alike)
        if self._alike >= _PROOF and not self._is_size:
            self.fault = ""
        if self.fault or self._left[0] < _ALIKE * self._varied:
            return
        best = int(np.argmin(self._left))
        fits = self._left[best] < min(_BETTER * self._left[0], _FITS * self._varied)
        if fits and self._wins[best] >= _PROOF:
            self.fault = self._mistakes[best].words
        elif self._strange >= _UNNAMED:
            self.fault = "it does not change as the IMU feels: another frame (East-North-Up?), another vehicle's"

    def _noise(self) -> float:
        """What the sensor's noise adds to the squares of a window [m^2/s^2], by how its values bend."""
        velocities = np.array([one[1] for one in self._velocities])[-_RECENT:]
        if len(velocities) < 3:
            return 0.0
        bends = velocities[1:-1] - 0.5 * (velocities[2:] + velocities[:-2])
        variance = float(np.median(np.square(bends).sum(axis=1))) / _BENDS
        t = self._velocities[-1][0] - self._velocities[max(-_RECENT, -len(self._velocities))][0]
        in_a_median = max(2.0 * _NEAR * (len(velocities) - 1) / max(t, 1e-3), 1.0)
        return _DIFFERENCES * variance / in_a_median

    def _compare_sizes(self, times: Array, velocities: Array, over_ground: Array) -> None:
        """Speeds by the sensor and over ground, which have to be equal whatever the axes."""
        if len(over_ground) < 2 or over_ground[0, 0] > times[0] or over_ground[-1, 0] < times[-1]:
            return
        new = len(times) // 2  # the first half was in the window before
        speeds = np.interp(times[new:], over_ground[:, 0], np.linalg.norm(over_ground[:, 1:], axis=1))
        sizes = np.linalg.norm(velocities[new:], axis=1)
        self._sizes.extend((a, b) for a, b in zip(speeds.tolist(), sizes.tolist(), strict=True) if a > _MOVES)
        if len(self._sizes) < _ENOUGH or (self.fault and not self._is_size):
            return
        a, b = np.array(self._sizes).T
        scale = float(a @ b) / max(float(a @ a), 1e-12)
        scatter = float(np.square(b - scale * a).sum()) / max(float(b @ b), 1e-12)
        self._is_size = abs(scale - 1.0) > _SIZE and scatter < _SCATTER**2
        unit = next((name for name, size in _UNITS.items() if abs(scale / size - 1.0) < 0.5 * _SIZE), "")
        words = f"it looks like {unit} instead of m/s" if unit else f"its size is {scale:.2g} times the speed"
        self.fault = words if self._is_size and not self.fault else self.fault if self._is_size else ""

    def _at(self, times: Array) -> Array | None:
        """(K, 3) m/s: medians around ``times``, for single values may be wild; None where there is none."""
        t = np.array([one[0] for one in self._velocities])
        velocities = np.array([one[1] for one in self._velocities])
        found = []
        for time in times.tolist():
            begin, end = np.searchsorted(t, (time - _NEAR, time + _NEAR))
            if begin == end:
                return None
            found.append(np.median(velocities[begin:end], axis=0))
        return np.array(found)


def _attitudes(angles: Array) -> Array:
    """(S + 1, 3, 3): body axes at the beginning of each second, and at the end, in those of the first one.

    ``angles`` (S, BINS, 3) [rad]: integrals of the rate.
    """
    q, found = np.array([1.0, 0.0, 0.0, 0.0]), [np.eye(3)]
    for second in angles:
        for part in second.reshape(BINS // _PARTS, _PARTS, 3).sum(axis=1):
            q = quat_multiply(q, quat_from_rotvec(part))
        found.append(quat_to_matrix(q))
    return np.array(found)
