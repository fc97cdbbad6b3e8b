"""Segments of a log: armed intervals, and intervals between gaps in the IMU data."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

Array = np.ndarray
SHORTEST_US = 10_000_000  # shortest segment in a log without arming


@dataclass(frozen=True)
class Segment:
    """A segment of a log, in times [µs] of its clock; ``armed``: armed time in it [s]."""

    begin_us: int
    end_us: int
    armed: float

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return (self.end_us - self.begin_us) * 1e-6


def find_segments(imu_us: Array, armed: list[tuple[int, int]] | None, max_gap: float) -> list[Segment]:
    """Segments in order of time.

    The IMU data are divided at gaps of more than ``max_gap`` [s], after which an estimator restarts, and in the middle
    between two armed intervals. Segments that are never armed are left out if others are; in logs without arming, those
    shorter than ``SHORTEST_US`` are.
    """
    if len(imu_us) < 2:
        return []
    cuts = set((np.flatnonzero(np.diff(imu_us) > max_gap * 1e6) + 1).tolist())
    spans = armed or []
    for (_, before), (after, _) in pairwise(spans):
        cuts.add(int(np.searchsorted(imu_us, (before + after) // 2)))
    edges = sorted({0, len(imu_us), *cuts})
    pieces = [
        Segment(int(imu_us[a]), int(imu_us[b - 1]), _overlap(int(imu_us[a]), int(imu_us[b - 1]), spans))
        for a, b in pairwise(edges)
    ]
    flown = [piece for piece in pieces if piece.armed > 0.0] if armed else []
    lasting = [piece for piece in pieces if piece.end_us - piece.begin_us >= SHORTEST_US]
    return flown or lasting or pieces


def _overlap(begin: int, end: int, spans: list[tuple[int, int]]) -> float:
    return sum(max(min(end, b) - max(begin, a), 0) for a, b in spans) * 1e-6
