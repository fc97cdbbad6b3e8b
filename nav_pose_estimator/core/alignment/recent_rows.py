"""The IMU rows that an alignment may still need."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.filter.layout import IMU_COLUMNS, IMU_GYRO, IMU_T

Row = tuple[float, ...]
_LEAST = 64  # rows that are kept whatever their age


@dataclass(slots=True)
class RecentRows:
    """Rows [t, gyro (3), accel (3)] of ``core.filter.layout`` in order of time."""

    rows: list[Row] = field(default_factory=list)

    def forget_before(self, t: float) -> None:
        """Now and then drop the rows before ``t`` [s]."""
        if len(self.rows) > _LEAST and self.rows[len(self.rows) // 2][0] < t:
            self.rows = [row for row in self.rows if row[0] >= t]

    def at(self, t: float) -> Row:
        """The last row up to ``t``, else the first one."""
        return next((row for row in reversed(self.rows) if row[IMU_T] <= t), self.rows[0])

    def between(self, start: float, end: float) -> NDArray[np.float64]:
        """IMU rows (N, 7) after ``start`` up to ``end``; the row across ``end`` counts up to it."""
        rows = [row for row in self.rows if start < row[IMU_T] < end]
        after = next((row for row in self.rows if row[IMU_T] >= end), None)
        if after is not None:
            rows.append((end, *after[IMU_GYRO:]))
        return np.array(rows, dtype=float).reshape(-1, IMU_COLUMNS)
