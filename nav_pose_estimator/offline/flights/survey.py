"""A pass over the samples of a recording: its epoch, its GNSS and its number of IMU samples, with little memory."""

from array import array
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import islice

import numpy as np

from nav_pose_estimator.engine.samples import GnssFix, GnssVelocity, ImuBlock, Sample
from nav_pose_estimator.offline.bags.reader import SampleBatch

_EARLY = 1000  # number of first samples among which one with a stamp before the IMU's is searched
_NEAR_NS = 1_000_000_000  # largest time by which its stamp may be earlier
_LAST_NS = (1 << 63) - 1
"""Latest valid stamp, in the year 2262."""


@dataclass(frozen=True)
class GnssColumns:
    """All fixes and velocities of a receiver in the order of arrival.

    ``fix_ns`` (N,), ``fixes`` (N, 4): latitude, longitude [rad], height [m], status; ``velocity_ns`` (M,),
    ``velocities`` (M, 3) ENU [m/s].
    """

    fix_ns: np.ndarray
    fixes: np.ndarray
    velocity_ns: np.ndarray
    velocities: np.ndarray

    @classmethod
    def of(cls, samples: Iterable[Sample]) -> "GnssColumns":
        """Collect those among ``samples``."""
        collector = _GnssCollector()
        collector.take(samples)
        return collector.columns()


class _GnssCollector:
    def __init__(self) -> None:
        self._fix_ns, self._velocity_ns = array("q"), array("q")
        self._fixes, self._velocities = array("d"), array("d")

    def take(self, samples: Iterable[Sample]) -> None:
        for sample in samples:
            if isinstance(sample, (GnssFix, GnssVelocity)) and abs(sample.stamp_ns) > _LAST_NS:
                continue
            if isinstance(sample, GnssFix):
                self._fix_ns.append(sample.stamp_ns)
                self._fixes.extend((sample.lat, sample.lon, sample.alt, sample.status))
            elif isinstance(sample, GnssVelocity):
                self._velocity_ns.append(sample.stamp_ns)
                self._velocities.extend(sample.vel_enu)

    def columns(self) -> GnssColumns:
        return GnssColumns(
            np.array(self._fix_ns, np.int64),
            np.array(self._fixes, float).reshape(-1, 4),
            np.array(self._velocity_ns, np.int64),
            np.array(self._velocities, float).reshape(-1, 3),
        )


@dataclass(frozen=True)
class Contents:
    """Number of IMU samples of a recording, and its GNSS."""

    imu_count: int
    gnss: GnssColumns

    @classmethod
    def of(cls, samples: Iterable[Sample]) -> "Contents":
        """Collect the contents of samples in memory."""
        count = sum(len(sample) for sample in samples if isinstance(sample, ImuBlock))
        return cls(count, GnssColumns.of(samples))


class Survey:
    """A pass over a bag, batch by batch.

    ``epoch_ns``: its first stamp, None while no IMU sample has one; ``last_ns``: the IMU's last one.
    """

    def __init__(self) -> None:
        self._gnss = _GnssCollector()
        self._early: list[int] = []  # stamps among the first samples, of sensors other than the IMU
        self._seen = 0
        self._first_ns = 0
        self._newest_ns: int | None = None
        self._repeated = 0
        self.imu_count = 0
        self.last_ns = 0

    def take(self, batch: SampleBatch) -> None:
        """Evaluate the next batch."""
        if self._seen < _EARLY:
            early = list(islice(batch.samples(), _EARLY - self._seen))
            self._seen += len(early)
            self._early += [s.stamp_ns for s in early if not isinstance(s, ImuBlock) and s.stamp_ns]
        self._gnss.take(sample for samples in batch.others for sample in samples)
        if len(batch.imu):
            self._take_imu(batch.imu.stamps_ns, *batch.pieces())

    def _take_imu(self, stamps: np.ndarray, starts: np.ndarray, ends: np.ndarray) -> None:
        firsts, last = stamps[starts], int(stamps[ends - 1].max())
        if self._first_ns <= 0:
            self._first_ns = int(firsts[np.argmax(firsts > 0)])
        self.last_ns = last if self._newest_ns is None else max(self.last_ns, last)
        self._repeated += int(np.count_nonzero(np.diff(stamps) == 0)) + (stamps[0] == self._newest_ns)
        self._newest_ns = int(stamps[-1])
        self.imu_count += len(stamps)

    @property
    def epoch_ns(self) -> int | None:
        # a fix may have a stamp shortly before the first IMU message; one far before it is damaged
        near = [stamp for stamp in self._early if 0 <= self._first_ns - stamp < _NEAR_NS]
        return min([self._first_ns, *near]) if self._first_ns > 0 else None

    @property
    def repeated(self) -> float:
        """Fraction of the IMU samples with the same stamp as the previous one."""
        return self._repeated / max(self.imu_count, 1)

    def contents(self) -> Contents:
        """Contents found so far."""
        return Contents(self.imu_count, self._gnss.columns())
