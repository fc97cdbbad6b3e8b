"""Latency of GNSS from its velocity against the IMU: one that is no longer established remains probable for a while."""

import numpy as np
import pytest

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


def test_motion_reduces_the_uncertainty_of_the_latency() -> None:
    """GIVEN a receiver without latency WHEN it moves THEN the uncertainty falls from the prior one to a tenth of a
    second, which it keeps, and does not exceed the prior one on the way."""
    monitor = LatencyMonitor()
    assert monitor.rms(0.2) == 0.2
    rms = []
    for seed in range(20):
        windows(monitor, right=3, count=1, seed=seed)
        rms.append(monitor.rms(0.2))
    assert max(rms) <= 0.2
    assert 0.05 < rms[-1] < 0.11


@pytest.mark.parametrize("right", [1, 5, 6])
def test_a_latency_that_motion_shows_is_in_its_uncertainty(right: int) -> None:
    """GIVEN a latency of 0.4 s or more WHEN the vehicle moves THEN the root mean square is most of it."""
    monitor = LatencyMonitor()
    windows(monitor, right, count=20, seed=1)
    late = abs(float(SHIFTS[right]))
    assert 0.7 * late < monitor.rms(0.2) < 1.1 * late


def test_motion_that_shows_no_latency_leaves_the_prior() -> None:
    """GIVEN a steady turn, where every shift fits THEN the uncertainty stays; 0 stays 0 in any motion."""
    monitor = LatencyMonitor()
    impulses = np.tile([0.0, 0.0, 9.8], (6, 1))
    monitor.compare(impulses, np.tile(impulses, (len(SHIFTS), 1, 1)))
    assert monitor.rms(0.2) == 0.2
    windows(monitor, right=5, count=20, seed=1)
    assert monitor.rms(0.0) == 0.0


def test_a_new_start_forgets_windows_and_keeps_a_latency() -> None:
    """GIVEN windows of motion WHEN the navigator starts again THEN the prior is back, unless a latency was known."""
    monitor, late = LatencyMonitor(), LatencyMonitor()
    windows(monitor, right=3, count=10, seed=1)
    windows(late, right=5, count=10, seed=1)
    known = late.rms(0.2)
    for each in (monitor, late):
        each.forget_time()
    assert monitor.rms(0.2) == 0.2
    assert late.rms(0.2) == known
    assert late.delay > 0.3
