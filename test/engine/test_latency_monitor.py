"""Latency of GNSS from its velocity against the IMU: one that is no longer established remains probable for a while."""

import numpy as np

from nav_pose_estimator.engine.imu.latency_monitor import SHIFTS, LatencyMonitor


def windows(monitor: LatencyMonitor, right: int, count: int, seed: int) -> None:
    """Windows of motion in which the velocities fit the IMU at the shift with index ``right``."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        impulses = rng.normal(size=(6, 3)) + np.array([0.0, 0.0, 9.8])
        away = np.abs(np.arange(len(SHIFTS)) - right)[:, None, None]
        monitor.compare(impulses, impulses + 0.5 * away * rng.normal(size=(len(SHIFTS), 6, 3)))


def test_a_latency_remains_probable_for_some_windows() -> None:
    """GIVEN an established latency WHEN later windows hide it THEN it is probable for ten windows, and not longer."""
    monitor = LatencyMonitor()
    assert not monitor.is_probable
    windows(monitor, right=4, count=4, seed=1)
    assert monitor.delay > 0.1
    while monitor.delay:
        windows(monitor, right=3, count=1, seed=2)
    assert monitor.is_probable
    windows(monitor, right=3, count=10, seed=3)
    assert not monitor.is_probable
