"""Detection of a feedback loop: the pose sent to the autopilot returns as a GNSS fix.

Autopilots publish their fused position under names that look like those of a receiver.
"""

import math
from collections import deque
from enum import Enum
from itertools import pairwise

from nav_pose_estimator.core.earth.ellipsoid import cos_latitude, radii
from nav_pose_estimator.engine.samples import GnssFix

_MEMORY_NS = 2_000_000_000  # length of the sent track that fixes are compared with
_PROOF_NS = 3_000_000_000  # duration of consecutive suspect fixes that establishes a loop
_PROOF_FIXES = 5  # smallest number of them
_TO_THE_DIGIT = 0.02  # m: tolerance for rounding, because MAVLink has a resolution of 1e-7 deg
_OF_SIGMA = 0.02  # tolerance relative to the horizontal sigma, if that is larger
_DOUBTFUL_SIGMA = 0.5  # m: from this sigma on, a receiver practically never agrees to the tolerance by chance
_EXACT = 0.003  # m: tolerance below that sigma, where only an exact copy is suspect


class Finding(Enum):
    """Result of the comparison of one fix with the sent track."""

    NONE = 0
    SUSPECT = 1  # the fix lies on the sent track
    LOOP = 2  # the fix establishes a loop
    ENDED = 3  # the first fix off the sent track after a loop


class EchoWatch:
    """Compares fixes with the positions sent to the autopilot while GNSS is denied.

    Without GNSS the estimate drifts by about its sigma, and the fixes of a real receiver do not follow that drift. A
    fix closer to the sent track than 2 % of sigma (by chance: 0.02 % for one position) is suspect and not used. Five
    consecutive suspect fixes over three seconds establish a loop. At a genuine return of GNSS a single fix may be lost.
    Where sigma is small, only an exact copy is suspect.
    """

    def __init__(self) -> None:
        self._track: deque[tuple[int, float, float]] = deque()
        self._sigma = 0.0
        self._since_ns, self._fixes = 0, 0
        self.is_loop = False

    @property
    def suspects(self) -> bool:
        """Whether the last fix lay on the sent track."""
        return self._fixes > 0 or self.is_loop

    def sent(self, stamp_ns: int, lat: float, lon: float, sigma: float) -> None:
        """Store a position [rad] that was sent, and its horizontal sigma [m]."""
        self._track.append((stamp_ns, lat, lon))
        self._sigma = sigma
        while self._track[0][0] < stamp_ns - _MEMORY_NS:
            self._track.popleft()

    def stopped(self) -> None:
        """Forget the track after sending stopped. Fixes can no longer be compared; a loop is assumed to persist."""
        self._track.clear()
        self._fixes = 0

    def judge(self, fix: GnssFix) -> Finding:
        """Compare one fix."""
        if not self._track:
            return Finding.SUSPECT if self.is_loop else Finding.NONE
        if not self._distance(fix) <= self._tolerance():  # NaN passes on to the gate, which reports it
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
        """Horizontal distance [m] of ``fix`` from the sent track, a polyline."""
        R_M, R_N = radii(fix.lat)
        east = R_N * cos_latitude(fix.lat)
        points = [((lat - fix.lat) * R_M, (lon - fix.lon) * east) for _, lat, lon in self._track]
        if len(points) == 1:
            return math.hypot(*points[0])
        return min(_from_zero(*a, *b) for a, b in pairwise(points))


def _from_zero(ax: float, ay: float, bx: float, by: float) -> float:
    """Distance of the origin from the line segment between a and b."""
    dx, dy = bx - ax, by - ay
    length2 = dx * dx + dy * dy
    s = 0.0 if length2 == 0.0 else min(max(-(ax * dx + ay * dy) / length2, 0.0), 1.0)
    return math.hypot(ax + s * dx, ay + s * dy)
