"""Time of an engine: seconds since its first IMU sample, from the stamps of samples and never from a clock."""

from __future__ import annotations

import numpy as np

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.samples import ImuBlock, ImuSample
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
            journal.count(f"{family}.before_imu")
            return None
        if stamp_ns <= 0:
            journal.say(stamp_ns, f"{family}.zero_stamp", Level.WARN, "a message came without a time stamp")
            return None
        return self.seconds(stamp_ns)

    def imu_rows(self, samples: ImuSample | ImuBlock) -> tuple[np.ndarray, np.ndarray]:
        """Stamps (N,) and IMU rows (N, 7) of ``core.filter.layout``; the first ones start the clock."""
        if isinstance(samples, ImuSample):
            self._start(samples.stamp_ns)
            row = [self.seconds(samples.stamp_ns), *samples.gyro, *samples.accel]
            return np.array([samples.stamp_ns]), np.array([row])
        self._start(int(samples.stamps_ns[0]))
        rows = np.empty((len(samples), at.IMU_COLUMNS))
        rows[:, at.IMU_T] = (samples.stamps_ns - self.zero_ns) * NS
        rows[:, at.IMU_GYRO : at.IMU_ACCEL] = samples.gyro
        rows[:, at.IMU_ACCEL :] = samples.accel
        return samples.stamps_ns, rows

    def _start(self, stamp_ns: int) -> None:
        if not self.running:
            self.zero_ns, self.running = stamp_ns, True
