"""Consistency of a body velocity with the IMU, and the search for the integration mistake that explains a misfit.

Over a second the velocity over ground changes by the integral of specific force and gravity. Both sides are rotated, by
the gyroscope alone, into the axes that the body had at the beginning of the window: there gravity is constant, and so
are tilt errors and accelerometer biases. After removal of the means over the window, both sides must be equal. The test
uses neither the navigator, which a wrong velocity would have corrupted, nor GNSS. Only a scale error common to all
components is tested against the speed over ground of GNSS, since it does not show in steady motion otherwise.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.alignment.motion_history import ANGLE, rotation_of
from nav_pose_estimator.core.alignment.velocity_history import VelocityHistory
from nav_pose_estimator.core.numerics.rotation import quat_multiply, quat_to_matrix
from nav_pose_estimator.core.numerics.units import SPEEDS

Array = NDArray[np.float64]
_STORED = 1000  # velocities
_RECENT = 100  # velocities from which the noise is estimated
# median squared second difference over the sum of variances: 1.5 times 2.37 (median of chi^2(3)), over 3
_SECOND_DIFFERENCE = 1.18
_DIFFERENCES = 10.0  # expected squares of six differences about their mean, over the sum of variances: 2 x 6 x 5/6
_NEAR = 0.15  # s: half the interval around a whole second whose median velocity is used
_ROTATIONS = 24  # rotations about z that are tested: every 15 deg
_LATE = (0.4, 0.8, 1.2)  # s: delays that are tested
_MEMORY = 0.9  # forgetting factor of the evidence from one window to the next
_VARIES = 0.8  # m/s: smallest variation (root of the sum of squares) of a window that is evaluated
_NOISE_SHARE = 0.3  # largest fraction of its square that may be noise of the sensor
_CONTRADICTS = 0.2  # unexplained fraction of the squared variation above which the velocity contradicts the IMU ...
_AGREES = 0.1  # ... and below which it agrees; a sound velocity leaves 0.03 in simulated flights, at most 0.1
_BETTER, _FITS = 0.35, 0.15
"""A mistake must reduce the residual to less than these fractions: of the one as received, and of the variation."""
_SUSPECT, _PROOF = 2, 3  # consecutive windows that make a velocity suspect, and that establish or clear a fault
_UNNAMED, _CONTRADICTS_CLEARLY = 6, 0.5  # consecutive windows, and unexplained fraction, of a fault without a name
_MOVES = 1.0  # m/s: smallest speed over ground at which speeds are compared
_SIZE, _SCATTER = 0.12, 0.1  # smallest relative scale error of a fault, and largest relative scatter about that scale
_ENOUGH = 12  # s: least number of seconds of such speeds
_HALF_KNOWN = 0.3  # possible error, relative to the speed, where only axes or only size are confirmed


class Mistake(NamedTuple):
    """Matrix (3, 3) from measured to true axes, delay of the measurement [s], and the clause for the user."""

    axes: Array
    late: float
    words: str


def _mistakes() -> list[Mistake]:
    """All mistakes, beginning with none. Of those that are equal for a level vehicle the simpler comes first."""
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
    found += [Mistake(np.eye(3) / size, 0.0, f"it looks like {unit} instead of m/s") for unit, size in SPEEDS.items()]
    found += [Mistake(np.eye(3), late, f"it looks {late:g} s late against its stamps") for late in _LATE]
    return found


_MISTAKES = tuple(_mistakes())


@dataclass(eq=False)
class BodyMotion:
    """The test. It receives every velocity, and every window of whole seconds of the IMU."""

    suspect: bool = field(default=False, init=False)
    """Whether the last informative windows contradict the velocity."""
    fault: str = field(default="", init=False)
    """The established fault, one clause for the user; empty without one."""
    is_proven: bool = field(default=False, init=False)
    """Whether windows in a row have confirmed the velocity, and nothing has contradicted it since."""
    _scale_error: float = field(default=math.inf, init=False)  # possible one, by the speed over ground
    _velocities: VelocityHistory = field(init=False)  # in b
    _residuals: Array = field(init=False)
    _is_size: bool = field(default=False, init=False)  # whether the fault is one of scale
    _varied: float = field(default=0.0, init=False)
    _contradicting: int = field(default=0, init=False)
    _clear_contradictions: int = field(default=0, init=False)
    _agreeing: int = field(default=0, init=False)
    _wins: Array = field(init=False)
    _speeds: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=60), init=False)

    def __post_init__(self) -> None:
        self._residuals, self._wins = np.zeros(len(_MISTAKES)), np.zeros(len(_MISTAKES), int)
        self._velocities = VelocityHistory(_STORED)

    @property
    def possible_error(self) -> float:
        """Possible error of a velocity that nothing contradicts, relative to the speed."""
        if self.is_proven and self._scale_error < _HALF_KNOWN:
            return self._scale_error
        return _HALF_KNOWN if self.is_proven or self._scale_error < _SIZE else 1.0

    def begin_with(self, possible_error: float) -> None:
        """Start with a velocity that was confirmed before a restart, and with its ``possible_error`` then."""
        self.is_proven, self._scale_error = True, possible_error

    def forget_time(self) -> None:
        """The clock changed: forget the samples, keep the established fault."""
        self._velocities = VelocityHistory(_STORED)
        self._speeds.clear()

    def velocity(self, t: float, velocity: Array) -> None:
        """Add a velocity (3,) [m/s] in b valid at ``t`` [s]; it is ignored unless it is later than the last one."""
        self._velocities.add(t, *velocity.tolist())

    def compare(self, begin: float, seconds: Array, gyro_bias: Array, impulses: Array, over_ground: Array) -> None:
        """Compare a window: ``seconds`` (S, 2, BINS, 3) of the IMU from ``begin`` [s] on (``motion_history``).

        ``gyro_bias`` (3,) [rad/s]: included in their rates. ``impulses`` (S, 3) [m/s]: their integrals of specific
        force without that bias, in the axes of b at ``begin``. ``over_ground`` (N, 4): times [s] and velocities ENU
        [m/s] of GNSS.
        """
        known = self._velocities.rows()
        if not len(known) or known[-1, 0] < begin:
            return
        times = begin + np.arange(len(seconds) + 1.0)
        measured = {late: _medians(known, times + late) for late in (0.0, *_LATE)}
        if measured[0.0] is None:
            return
        self._compare_sizes(times, measured[0.0], over_ground)
        self.is_proven = self.is_proven and not self.fault
        impulses = impulses - impulses.mean(axis=0)
        varied = float(np.vdot(impulses, impulses))
        noise = _noise(known[-_RECENT:])
        if not varied > max(_VARIES**2, noise / _NOISE_SHARE):
            return
        rotations = _attitudes(seconds[:, ANGLE], gyro_bias)
        residuals = np.full(len(_MISTAKES), math.inf)
        for i, mistake in enumerate(_MISTAKES):
            velocities = measured[mistake.late]
            if velocities is None:
                continue
            changes = np.diff(np.einsum("kij,kj->ki", rotations, velocities @ mistake.axes.T), axis=0)
            changes -= changes.mean(axis=0)
            residuals[i] = max(float(np.square(changes - impulses).sum()) - noise, 0.0)
        self._weigh(residuals, varied, noise)

    def _weigh(self, residuals: Array, varied: float, noise: float) -> None:
        """Add the evidence of a window.

        ``residuals`` (H,): squared residual of each mistake beyond the ``noise``; ``varied``: squared variation.
        """
        self._residuals = _MEMORY * self._residuals + np.minimum(residuals, 4.0 * varied)
        self._varied = _MEMORY * self._varied + varied
        wins = (residuals < _BETTER * residuals[0]) & (residuals[0] > _AGREES * varied)
        self._wins = np.where(wins, self._wins + 1, 0)
        # by chance a window has up to twice the expected noise
        self._contradicting = self._contradicting + 1 if residuals[0] > _CONTRADICTS * varied + noise else 0
        is_clear = residuals[0] > _CONTRADICTS_CLEARLY * varied
        self._clear_contradictions = self._clear_contradictions + 1 if is_clear else 0
        self._agreeing = self._agreeing + 1 if residuals[0] < _AGREES * varied else 0
        self.suspect = self._contradicting >= _SUSPECT or (self.suspect and not self._agreeing)
        self._name()
        self.is_proven = not (self.suspect or self.fault) and (self.is_proven or self._agreeing >= _PROOF)

    def _name(self) -> None:
        """Establish or clear a fault by the evidence so far."""
        if self._agreeing >= _PROOF and not self._is_size:
            self.fault = ""
        if self.fault or self._residuals[0] < _AGREES * self._varied:
            return
        best = int(np.argmin(self._residuals))
        fits = self._residuals[best] < min(_BETTER * self._residuals[0], _FITS * self._varied)
        if fits and self._wins[best] >= _PROOF:
            self.fault = _MISTAKES[best].words
        elif self._clear_contradictions >= _UNNAMED:
            self.fault = "its changes contradict the IMU: is it in another frame (East-North-Up), or another vehicle's?"

    def _compare_sizes(self, times: Array, velocities: Array, over_ground: Array) -> None:
        """Compare the speeds of sensor and GNSS, which must be equal whatever the axes are."""
        if len(over_ground) < 2 or over_ground[0, 0] > times[0] or over_ground[-1, 0] < times[-1]:
            return
        new = len(times) // 2  # the first half was in the window before
        speeds = np.interp(times[new:], over_ground[:, 0], np.linalg.norm(over_ground[:, 1:], axis=1))
        sizes = np.linalg.norm(velocities[new:], axis=1)
        self._speeds.extend((a, b) for a, b in zip(speeds.tolist(), sizes.tolist(), strict=True) if a > _MOVES)
        if len(self._speeds) < _ENOUGH or (self.fault and not self._is_size):
            return
        a, b = np.array(self._speeds).T
        scale = float(a @ b) / max(float(a @ a), 1e-12)
        scatter = float(np.square(b - scale * a).sum()) / max(float(b @ b), 1e-12)
        self._is_size = abs(scale - 1.0) > _SIZE and scatter < _SCATTER**2
        self._scale_error = abs(scale - 1.0) + math.sqrt(scatter / len(self._speeds))
        unit = next((name for name, size in SPEEDS.items() if abs(scale / size - 1.0) < 0.5 * _SIZE), "")
        words = f"it looks like {unit} instead of m/s" if unit else f"its size is {scale:.2g} times the speed"
        self.fault = (self.fault or words) if self._is_size else ""


def _noise(known: Array) -> float:
    """Expected squares of a window due to noise of the sensor [m^2/s^2], from second differences of its values."""
    t, velocities = known[:, 0], known[:, 1:]
    if len(t) < 3:
        return 0.0
    second_differences = velocities[1:-1] - 0.5 * (velocities[2:] + velocities[:-2])
    variance = float(np.median(np.square(second_differences).sum(axis=1))) / _SECOND_DIFFERENCE
    in_a_median = max(2.0 * _NEAR * (len(t) - 1) / max(float(t[-1] - t[0]), 1e-3), 1.0)
    return _DIFFERENCES * variance / in_a_median


def _medians(known: Array, times: Array) -> Array | None:
    """Medians (K, 3) [m/s] around ``times`` (K,) [s], robust against outliers; None where one has no velocity."""
    begins, ends = (known[:, 0].searchsorted(times + side * _NEAR) for side in (-1.0, 1.0))
    if (begins == ends).any():
        return None
    return np.array([np.median(known[begin:end, 1:], axis=0) for begin, end in zip(begins, ends, strict=True)])


def _attitudes(angles: Array, bias: Array) -> Array:
    """Body axes (S + 1, 3, 3) at the beginning of each second and at the end, in the axes at the beginning.

    ``angles`` (S, BINS, 3) [rad]: integrals of the rate, with the ``bias`` (3,) [rad/s].
    """
    q, found = np.array([1.0, 0.0, 0.0, 0.0]), [np.eye(3)]
    for second in angles:
        q = quat_multiply(q, rotation_of(second, bias))
        found.append(quat_to_matrix(q))
    return np.array(found)
