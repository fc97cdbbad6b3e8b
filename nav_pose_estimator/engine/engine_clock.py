"""Time of an engine: seconds since its first IMU sample, from the stamps of samples and never from a clock."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.samples import ImuBlock, ImuSample, joined
from nav_pose_estimator.engine.solutions import Level

NS = 1e-9


class EngineClock:
    """Conversion of stamps and engine time; ``running`` from the first IMU sample on, whose stamp is ``zero_ns``."""

    def __init__(self) -> None:
        self.zero_ns = 0
        self.running = False

    def seconds(self, stamp_ns: int) -> float:
        """Engine time [s] of a stamp."""
        return (stamp_ns - self.zero_ns) * NS

    def stamp(self, t: float) -> int:
        """Stamp of an engine time [s]."""
        return self.zero_ns + round(t * 1e9)

    def time_of(self, stamp_ns: int, family: str, journal: Journal) -> float | None:
        """Engine time of a stamp; None (and counted) before the first IMU sample or without a stamp."""
        if not self.running:
            journal.count(f"{family}.rejected.before_imu")
            return None
        if stamp_ns <= 0:
            journal.say(stamp_ns, f"{family}.rejected.zero_stamp", Level.WARN, "a message came without a time stamp")
            return None
        return (stamp_ns - self.zero_ns) * NS

    def imu_rows(self, samples: ImuSample | ImuBlock) -> tuple[np.ndarray, np.ndarray]:
        """Stamps (N,) and IMU rows (N, 7) of ``core.filter.layout``; the first ones start the clock."""
        if isinstance(samples, ImuSample):
            self._start(samples.stamp_ns)
            row = [self.seconds(samples.stamp_ns), *samples.gyro, *samples.accel]
            return np.array([samples.stamp_ns]), np.array([row])
        return self.rows_of([samples])

    def rows_of(self, blocks: Sequence[ImuBlock]) -> tuple[np.ndarray, np.ndarray]:
        """``imu_rows`` of consecutive blocks, one at least."""
        whole = joined(blocks)
        self._start(int(whole.stamps_ns[0]))
        times = (whole.stamps_ns - self.zero_ns) * NS
        return whole.stamps_ns, np.concatenate((times[:, None], whole.gyro, whole.accel), axis=1)

    def _start(self, stamp_ns: int) -> None:
        if not self.running:
            self.zero_ns, self.running = stamp_ns, True
