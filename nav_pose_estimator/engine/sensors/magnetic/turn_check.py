"""Turns of the magnetometer against those of the gyroscope, and the search for wrong signs or axes that explain them.

This needs neither GNSS nor a manoeuvre other than turning. Scale errors and biases are not looked for: motor currents
and nearby steel distort a turn by some ten degrees, but they do not reverse it. Hard iron stronger than the horizontal
field may, but it also changes the strength.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable

import numpy as np

from nav_pose_estimator.core.alignment.motion_history import BINS, axis_rotations
from nav_pose_estimator.core.attitude.field_turns import spreads
from nav_pose_estimator.engine.samples import Vector3

_WINDOW, _EVERY, _LAG = 6, 3, 2  # s: a window, from one to the next, and after its end until it is evaluated
_CLOSEST, _APART = 0.05, 0.7  # s: fields that follow sooner are left out; largest gap that is interpolated
_KEPT = 400  # fields: more than any window and what arrives until it is evaluated, so that none depends on when
_FASTEST = 2.0  # rad in a second beyond which fields half a second apart, and late ones, are no measure
_SUSPICIOUS = 0.02  # spread above which hypotheses are tested
_CONSTANT = 0.1  # largest change of the strength within a window, relative to its mean, of a field that is a measure
_MEMORY = 0.93  # forgetting factor of the evidence from one window to the next
_BETTER, _GAIN = 0.2, 0.1
"""A hypothesis must reduce the summed spread to less than this fraction, and by at least this amount.

On ten recorded flights an inverted z axis leaves a spread of more than 0.06 in 352 windows. The right hypothesis leaves
less than 0.11 of it in nine of ten windows of each flight, and the strength is constant in 323 of them.
"""
_WIN, _WINS = 0.06, 0.9  # spread by which a window is won, and faded number of such windows
_ALIKE = 0.5  # a mirrored hypothesis must leave less than this fraction of what the best proper one leaves


class TurnCheck:
    """Evidence that gyroscope and magnetometer turn differently."""

    def __init__(self) -> None:
        turns = axis_rotations()
        self._gyros = np.concatenate([turns, -turns])
        self._sums, self._wins = np.zeros(len(self._gyros)), np.zeros(len(self._gyros))
        self._fields: deque[tuple[float, float, float, float]] = deque(maxlen=_KEPT)
        self.differs = False
        """Whether other signs or axes of one of the two sensors explain how they turn far better."""
        self.is_mirrored = False
        """Whether only those of the gyroscope do."""

    def field(self, t: float, field: Vector3) -> None:
        """Add a field in b, in any unit, valid at ``t`` [s]."""
        strength = math.hypot(*field)
        while self._fields and self._fields[-1][0] > t + _LAG:
            self._fields.pop()  # a wrong stamp, which would keep all later ones out
        if strength > 0.0 and (not self._fields or t >= self._fields[-1][0] + _CLOSEST):
            self._fields.append((t, *field))

    def second(self, k: int, angles: Callable[[int], np.ndarray | None]) -> None:
        """Evaluate a window every three seconds, at the second that ends at ``k``.

        ``angles(i)``: integrated rates (BINS, 3) [rad] of the second that ends at i, None where they are not known.
        """
        if k % _EVERY:
            return
        ends = range(k - _LAG - _WINDOW, k - _LAG + 1)
        fields = self._fields_at(np.array(ends, dtype=float))
        seconds = [angles(i) for i in ends[1:]]
        known = [second for second in seconds if second is not None]
        while self._fields and self._fields[0][0] < ends[0]:
            self._fields.popleft()
        if fields is None or len(known) < _WINDOW:
            return
        turned = np.array(known)
        if np.linalg.norm(turned.sum(axis=1), axis=1).max() < _FASTEST:
            self._weigh(turned, fields)

    def _fields_at(self, times: np.ndarray) -> np.ndarray | None:
        """The field (N, 3) at ``times`` (N,) [s]; None where there are too few."""
        if len(self._fields) < 2:
            return None
        rows = np.array(self._fields)
        after = np.searchsorted(rows[:, 0], times)
        if (after[0] == 0 and rows[0, 0] > times[0]) or after[-1] == len(rows):
            return None
        after = np.maximum(after, 1)
        gap = rows[after, 0] - rows[after - 1, 0]
        if (gap > _APART).any():
            return None
        share = ((times - rows[after - 1, 0]) / gap)[:, np.newaxis]
        length = np.linalg.norm(rows[:, 1:], axis=1)
        between = (1.0 - share) * rows[after - 1, 1:] + share * rows[after, 1:]
        return None if np.linalg.norm(between, axis=1).min() < 0.1 * length.max() else between

    def _weigh(self, seconds: np.ndarray, fields: np.ndarray) -> None:
        strength = np.linalg.norm(fields, axis=1)
        directions = fields / strength[:, np.newaxis]
        self._sums *= _MEMORY
        self._wins *= _MEMORY
        own = float(spreads(seconds, directions, self._gyros[:1])[0])
        if own > _SUSPICIOUS and np.ptp(strength) < _CONSTANT * strength.mean():
            found = spreads(seconds, directions, self._gyros)
            self._sums += found
            self._wins += (found < _BETTER * own) & (own - found > _WIN)
        else:
            self._sums += own  # evidence for and against no hypothesis
        proper, half = float(self._sums[: len(self._sums) // 2].min()), len(self._sums) // 2
        best, mirrored = int(self._sums.argmin()), half + int(self._sums[half:].argmin())
        self.differs = self._explains(best, float(self._sums[0]), _BETTER)
        self.is_mirrored = self.differs and self._explains(mirrored, proper, _ALIKE)

    def _explains(self, index: int, other: float, share: float) -> bool:
        """Whether a hypothesis that has won explains the turns better than one that leaves ``other``."""
        left = float(self._sums[index])
        return left < share * other and other - left > _GAIN and float(self._wins[index]) > _WINS


def warm_up() -> None:
    """Compile the kernels: a turn of the field that the gyroscope measures with the wrong sign."""
    check, angles = TurnCheck(), np.zeros((BINS, 3))
    angles[:, 2] = 0.5 / BINS
    for k in range(2 * _WINDOW):
        for t in (k - 0.5, float(k)):
            check.field(t, (math.cos(0.5 * t), math.sin(0.5 * t), 0.5))
        check.second(k, lambda _: angles)
