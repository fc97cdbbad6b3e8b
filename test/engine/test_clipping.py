"""Axes that repeat the largest value of the flight."""

import numpy as np
import pytest

from nav_pose_estimator.engine.imu.clipping import Clipped, ClipWatch

RATE = 100.0  # Hz


def flown(values: np.ndarray, column: int, resolution: float = 1e-3) -> list[Clipped]:
    """What a watch tells of an IMU whose ``column`` has ``values`` (N,); the others move a little."""
    rng, rows = np.random.default_rng(2), np.zeros((len(values), 7))
    rows[:, 0] = np.arange(len(values)) / RATE
    rows[:, 1:] = np.round(rng.normal(0.0, 0.05, (len(values), 6)) / resolution) * resolution
    rows[:, column] = values
    watch, told = ClipWatch(), []
    for k in range(int(len(values) / RATE)):
        told.append(watch.second(rows[max(int(k * RATE) - 1, 0) : int((k + 1) * RATE)]))
    return [one for one in told if one is not None]


def turning(largest: float, frequency: float, resolution: float = 1e-3, noise: float = 2e-3) -> np.ndarray:
    """Twenty seconds of a rate that swings."""
    t, rng = np.arange(20.0 * RATE) / RATE, np.random.default_rng(1)
    values = largest * np.sin(2.0 * np.pi * frequency * t) + rng.normal(0.0, noise, len(t))
    return np.round(values / resolution) * resolution


@pytest.mark.parametrize("bound", [1.0, 2.18, 4.36])
@pytest.mark.parametrize(("beyond", "frequency"), [(1.1, 0.5), (1.8, 1.0), (1.3, 0.1)])
def test_a_gyroscope_of_any_range_clips(bound: float, beyond: float, frequency: float) -> None:
    """GIVEN a rate beyond the range THEN that is seen, and what was lost is known to a factor of two."""
    true = turning(beyond * bound, frequency)
    clipped = np.clip(true, -bound, bound)
    told = flown(clipped, 3)
    assert "gyroscope clips" in told[-1].words
    lost = float(np.abs(true - clipped).sum()) / RATE
    assert 0.5 * lost < sum(one.angle for one in told) < 3.0 * lost


def test_an_accelerometer_clips() -> None:
    told = flown(np.clip(turning(30.0, 2.0, 0.01, 0.3), -19.6, 19.6), 6)
    assert "accelerometer clips at 19.6 m/s^2" in told[-1].words
    assert told[-1].velocity > 0.1


@pytest.mark.parametrize("resolution", [1e-3, 1e-2, 0.05])
@pytest.mark.parametrize("frequency", [0.1, 0.5, 2.0])
def test_a_smooth_peak_of_a_coarse_sensor_does_not(resolution: float, frequency: float) -> None:
    assert flown(turning(2.0, frequency, resolution), 2, resolution) == []


def test_a_steady_turn_does_not() -> None:
    """GIVEN a spin at constant rate that a coarse sensor reads as few values THEN it is none."""
    values = np.minimum(np.arange(20.0 * RATE) / RATE, 1.5) + np.random.default_rng(3).normal(0.0, 2e-3, int(20 * RATE))
    assert flown(np.round(values / 1e-2) * 1e-2, 1, 1e-2) == []


def test_a_range_that_is_exceeded_was_none() -> None:
    """GIVEN plateaus at 2 rad/s WHEN 3 rad/s follow THEN the plateaus count no more."""
    told = flown(np.r_[np.clip(turning(2.5, 0.5), -2.0, 2.0), turning(3.0, 0.5)], 1)
    assert len(told) < 21
