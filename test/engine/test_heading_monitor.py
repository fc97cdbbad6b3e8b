"""The heading by IMU and GNSS alone: wrong ones are found, corrections count, and a quiet flight says nothing."""

import math

import numpy as np
import pytest

from nav_pose_estimator.core.numerics.rotation import euler_from_quat, quat_from_euler, quat_to_matrix
from nav_pose_estimator.engine.imu.heading_monitor import HeadingMonitor

STILL = np.zeros((25, 3))


def look(
    monitor: HeadingMonitor, windows: int, yaw: float, believed: float, size: float = 1.0, tilt: float = 0.0
) -> HeadingMonitor:
    """Windows of six seconds of a level body at ``yaw``; the navigator believes it ``believed``, with a ``tilt``."""
    random = np.random.default_rng(1)
    C = quat_to_matrix(quat_from_euler(0.0, 0.0, yaw))
    for k in range(6 * windows + 1):
        monitor.attitude(k, quat_from_euler(tilt, 0.0, believed))
        monitor.add_rotation(k, STILL, np.zeros(3))
        if k and k % 6 == 0:
            forces = np.column_stack([random.normal(0.0, size, (6, 2)), np.full(6, 9.8)])
            monitor.compare(k - 6, forces @ C + random.normal(0.0, 0.05, (6, 3)), forces)
    return monitor


@pytest.mark.parametrize("off", [-170.0, -100.0, -50.0, 50.0, 100.0, 180.0])
@pytest.mark.parametrize("tilt", [0.0, 0.2])
def test_a_wrong_heading_is_found_whatever_the_tilt(off: float, tilt: float) -> None:
    """GIVEN a heading that is wrong WHEN the vehicle accelerates in two windows THEN the angle is known, and level."""
    monitor = look(HeadingMonitor(), 2, yaw=0.3, believed=0.3 + math.radians(off), tilt=tilt)
    assert abs(math.remainder(monitor.error + math.radians(off), 2.0 * math.pi)) < math.radians(8.0)
    assert monitor.level is not None
    assert np.abs(euler_from_quat(monitor.level)[:2]).max() < 0.05


@pytest.mark.parametrize("off", [0.0, 20.0, -20.0])
def test_a_heading_that_is_about_right_is_left_alone(off: float) -> None:
    assert look(HeadingMonitor(), 4, yaw=0.3, believed=0.3 + math.radians(off)).error == 0.0


def test_a_quiet_flight_says_nothing() -> None:
    assert look(HeadingMonitor(), 4, yaw=0.3, believed=2.5, size=0.05).error == 0.0


def test_one_window_proves_nothing() -> None:
    assert look(HeadingMonitor(), 1, yaw=0.3, believed=2.5).error == 0.0


def test_what_corrections_have_turned_since_is_taken_off() -> None:
    """GIVEN a heading found wrong by 90 deg WHEN the filter itself turns it back THEN nothing is left to turn."""
    monitor = look(HeadingMonitor(), 2, yaw=0.3, believed=0.3 + 0.5 * math.pi)
    assert monitor.error != 0.0
    for k in range(13, 19):
        monitor.attitude(k, quat_from_euler(0.0, 0.0, 0.3))
        monitor.add_rotation(k, STILL, np.zeros(3))
    forces = np.column_stack([np.random.default_rng(2).normal(0.0, 1.0, (6, 2)), np.full(6, 9.8)])
    monitor.compare(12, forces @ quat_to_matrix(quat_from_euler(0.0, 0.0, 0.3)), forces)
    assert monitor.error == 0.0
