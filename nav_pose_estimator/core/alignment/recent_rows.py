"""Buffer of the recent IMU rows that an alignment may still need."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.filter.layout import IMU_COLUMNS, IMU_GYRO, IMU_T

Row = tuple[float, ...]
_MIN_ROWS = 64  # rows that are kept whatever their age, so that the list is not rebuilt at every sample


@dataclass(slots=True)
class RecentRows:
    """Rows [t, gyro (3), accel (3)] of ``core.filter.layout`` in order of time."""

    rows: list[Row] = field(default_factory=list)

    def forget_before(self, t: float) -> None:
        """Drop the rows before ``t`` [s], once they are half of the buffer."""
        if len(self.rows) > _MIN_ROWS and self.rows[len(self.rows) // 2][0] < t:
            self.rows = [row for row in self.rows if row[0] >= t]

    def at(self, t: float) -> Row:
        """The last row up to ``t`` [s]; the first row where all are later."""
        return next((row for row in reversed(self.rows) if row[IMU_T] <= t), self.rows[0])

    def between(self, start: float, end: float) -> NDArray[np.float64]:
        """IMU rows (N, 7) after ``start`` up to ``end`` [s]; the first row beyond ``end`` is cut off at ``end``."""
        rows = [row for row in self.rows if start < row[IMU_T] < end]
        after = next((row for row in self.rows if row[IMU_T] >= end), None)
        if after is not None:
            rows.append((end, *after[IMU_GYRO:]))
        return np.array(rows, dtype=float).reshape(-1, IMU_COLUMNS)
