"""Changes of the GNSS velocity that the IMU does not feel, and launches that only look like one."""

import numpy as np
import pytest

from nav_pose_estimator.core.gnss.unfelt_change import (
    APART,
    COLUMNS,
    COUNT,
    DRIFT_SD,
    HEADING_SD,
    SPANS,
    VELOCITY,
    UnfeltChange,
)


def found(launch: float, jump: float) -> bool:
    """Whether a change is found when after a minute at rest the speed changes by ``launch``, the receiver's by more.

    ``jump`` [m/s]: what the receiver reports beyond that.
    """
    rng, change = np.random.default_rng(1), UnfeltChange()
    seconds = np.zeros((90, COLUMNS))
    seconds[:, COUNT], seconds[:, HEADING_SD], seconds[:, DRIFT_SD] = 5.0, 0.02, 0.005
    seconds[:, APART : APART + 2] = rng.normal(0.0, 0.03, (90, 2))
    seconds[60:, VELOCITY] += launch
    seconds[60:, APART] += jump
    return any(change.find(seconds[max(end - SPANS, 0) : end]) is not None for end in range(1, 90))


@pytest.mark.parametrize("jump", [1.5, 4.0])
def test_a_jump_without_a_force_is_found(jump: float) -> None:
    """GIVEN a vehicle that keeps its velocity WHEN that of the receiver jumps THEN it is found."""
    assert found(0.0, jump)


def test_a_launch_is_no_pull() -> None:
    """GIVEN a vehicle that has stood WHEN it is launched and the heading turns out to be wrong THEN it is no pull."""
    assert not found(9.0, 4.0)
