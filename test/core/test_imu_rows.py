"""Search for IMU rows by their time."""

import numpy as np
import pytest

from nav_pose_estimator.core.filter.layout import IMU_COLUMNS
from nav_pose_estimator.core.numerics.imu_checks import first_after, first_from

TIMES = 0.1 * np.arange(7.0)


@pytest.mark.parametrize("t", [-1.0, 0.0, 0.05, TIMES[3], np.nextafter(TIMES[3], 1.0), TIMES[6], 1.0, np.inf, -np.inf])
def test_rows_are_found_as_numpy_finds_them(t: float) -> None:
    """GIVEN rows in order of time WHEN those from a time on, or after it, are sought THEN they are numpy's."""
    rows = np.zeros((len(TIMES), IMU_COLUMNS))
    rows[:, 0] = TIMES
    assert first_from(rows, t) == np.searchsorted(TIMES, t, side="left")
    assert first_after(rows, t) == np.searchsorted(TIMES, t, side="right")
    assert first_from(rows[:0], t) == 0
