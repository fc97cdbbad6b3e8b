"""Detects our own pose coming back as GNSS: autopilots publish their fused position under names like a receiver's."""

import math
from collections import deque
from enum import Enum
from itertools import pairwise

from nav_pose_estimator.core.earth.ellipsoid import cos_latitude, radii
from nav_pose_estimator.engine.samples import GnssFix

_MEMORY_NS = 2_000_000_000
_PROOF_NS = 3_000_000_000
_PROOF_FIXES = 5
_TO_THE_DIGIT = 0.02  # m: positions pass through MAVLink in steps of 1e-7 degrees
_OF_SIGMA = 0.02
_DOUBTFUL_SIGMA = 0.5  # m: an estimate this uncertain does not agree with a receiver to the digit by chance
_EXACT = 0.003  # m: tolerance while sigma is smaller, when only an exact copy is suspect


class Finding(Enum):
    """What a fix tells of a feedback loop."""

    NONE = 0
    SUSPECT = 1  # this fix lies on our own track
    LOOP = 2  # so did those of the last seconds: for the first time
    ENDED = 3  # a fix of its own, after a loop


class EchoWatch:
    """Compares fixes with what was sent to the autopilot while GNSS is denied.

    Without GNSS the estimate drifts by its sigma, and a receiver knows nothing of that. A fix within 2 % of sigma of
    the track that was sent (chance for one position: 0.02 %) is suspect and not used; five of them, and nothing else
    for three seconds, are a loop. A genuine return may lose a fix. Where sigma is small only a copy is suspect.
    """

    def __init__(self) -> None:
        self._track: deque[tuple[int, float, float]] = deque()
        self._sigma = 0.0
        self._since_ns, self._fixes = 0, 0
        self.is_loop = False

    @property
    def suspects(self) -> bool:
        """Whether the last fix lay on our own track."""
        return self._fixes > 0 or self.is_loop

    def sent(self, stamp_ns: int, lat: float, lon: float, sigma: float) -> None:
        """A position that left, in radians, and its horizontal sigma [m]."""
        self._track.append((stamp_ns, lat, lon))
        self._sigma = sigma
        while self._track[0][0] < stamp_ns - _MEMORY_NS:
            self._track.popleft()

    def stopped(self) -> None:
        """Nothing is sent any more: fixes can no longer be compared, and a loop is assumed to go on."""
        self._track.clear()
        self._fixes = 0

    def judge(self, fix: GnssFix) -> Finding:
        """Compare one fix."""
        if not self._track:
            return Finding.SUSPECT if self.is_loop else Finding.NONE
        if not self._distance(fix) <= self._tolerance():  # true for NaN as well: the gate has a name for that
            was_loop, self.is_loop, self._fixes = self.is_loop, False, 0
            return Finding.ENDED if was_loop else Finding.NONE
        if self._fixes == 0:
            self._since_ns = fix.stamp_ns
        self._fixes += 1
        lasts = self._fixes >= _PROOF_FIXES and fix.stamp_ns - self._since_ns >= _PROOF_NS
        if lasts and not self.is_loop:
            self.is_loop = True
            return Finding.LOOP
        return Finding.SUSPECT

    def _tolerance(self) -> float:
        return _EXACT if self._sigma < _DOUBTFUL_SIGMA else max(_TO_THE_DIGIT, _OF_SIGMA * self._sigma)

    def _distance(self, fix: GnssFix) -> float:
        """Horizontal distance [m] to the track that was sent: to its nearest leg."""
        R_M, R_N = radii(fix.lat)
        east = R_N * cos_latitude(fix.lat)
        points = [((lat - fix.lat) * R_M, (lon - fix.lon) * east) for _, lat, lon in self._track]
        if len(points) == 1:
            return math.hypot(*points[0])
        return min(_from_zero(*a, *b) for a, b in pairwise(points))


def _from_zero(ax: float, ay: float, bx: float, by: float) -> float:
    """Distance of the origin from the leg between a and b."""
    dx, dy = bx - ax, by - ay
    length2 = dx * dx + dy * dy
    s = 0.0 if length2 == 0.0 else min(max(-(ax * dx + ay * dy) / length2, 0.0), 1.0)
    return math.hypot(ax + s * dx, ay + s * dy)
