"""Buffer of the most recent IMU rows in one array with spare room at its end."""

from __future__ import annotations

import numpy as np

from nav_pose_estimator.core.filter.layout import IMU_COLUMNS
from nav_pose_estimator.core.numerics.imu_checks import first_after, first_from


class ImuBuffer:
    """Rows (N, 7) of ``core.filter.layout`` in order of time; ``rows`` [``first``:``last``] are the live ones."""

    def __init__(self) -> None:
        self.rows = np.empty((0, IMU_COLUMNS))
        self.first = self.last = 0

    def live(self) -> np.ndarray:
        """View of the stored rows; read only."""
        return self.rows[self.first : self.last]

    def append(self, rows: np.ndarray) -> None:
        """Append ``rows`` (N, 7), which must be later than the stored ones."""
        need = len(rows)
        self.make_room(need)
        self.rows[self.last : self.last + need] = rows
        self.last += need

    def make_room(self, need: int) -> None:
        """Make room for ``need`` rows after the last one."""
        if self.last + need <= len(self.rows):
            return
        live = self.live()
        room = np.empty((2 * (len(live) + need) + 256, IMU_COLUMNS))
        room[: len(live)] = live
        self.rows, self.first, self.last = room, 0, len(live)

    def recent(self, since: float) -> np.ndarray:
        """View of the stored rows later than ``since`` [s]; read only."""
        rows = self.live()
        return rows[first_after(rows, since) :]

    def between(self, start: float, end: float) -> tuple[int, int]:
        """Index range in ``rows`` of those later than ``start`` [s], up to and including ``end`` [s]."""
        rows = self.live()
        return self.first + first_after(rows, start), self.first + first_after(rows, end)

    def drop_before(self, t: float) -> None:
        """Drop the rows before ``t`` [s] except the last one, which point-sampled data interpolate from."""
        self.first += max(first_from(self.live(), t) - 1, 0)
