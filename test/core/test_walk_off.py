"""Positions that leave their own velocities."""

import numpy as np
import pytest

from nav_pose_estimator.core.gnss.spoof_drift import WalkOff

PERIOD, SCATTER = 0.2, 8.0


def fly(watch, seconds, drift=0.0, bias=0.0, start=0.0, seed=1):
    """Largest speed reported on a circle, with a wandering receiver, velocities wrong by ``bias``."""
    rng, wander, worst = np.random.default_rng(seed), np.zeros(2), 0.0
    for i in range(round(seconds / PERIOD)):
        t = start + i * PERIOD
        wander = wander * (1.0 - PERIOD / 60.0) + rng.normal(0.0, 1.5 * np.sqrt(2 * PERIOD / 60.0), 2)
        place = 80.0 * np.array([np.cos(0.1 * t), np.sin(0.1 * t)]) + wander + rng.normal(0.0, 0.5, 2)
        speed = 8.0 * np.array([-np.sin(0.1 * t), np.cos(0.1 * t)]) + rng.normal(0.0, 0.1, 2)
        velocity = (speed[0] + bias, speed[1], np.nan)
        worst = max(worst, watch.update(t, (place[0] + drift * i * PERIOD, place[1], 30.0), velocity, SCATTER))
    return worst


@pytest.mark.parametrize("seed", range(5))
def test_an_honest_receiver_is_left_alone(seed):
    assert fly(WalkOff(), 600.0, bias=0.2, seed=seed) == 0.0


@pytest.mark.parametrize("drift", [1.0, 2.0])
def test_a_drift_is_found_with_its_speed(drift):
    assert fly(WalkOff(), 40.0, drift) == pytest.approx(drift, abs=0.4)


def test_a_drift_that_is_slower_than_velocities_may_be_wrong_is_not_found():
    """The limit: half a metre per second."""
    assert fly(WalkOff(), 120.0, drift=0.3) == 0.0


def test_a_pause_begins_anew_and_so_does_a_receiver_without_velocity():
    watch = WalkOff()
    fly(watch, 20.0)
    assert watch.update(100.0, (5000.0, 0.0, 0.0), (0.0, 0.0, 0.0), SCATTER) == 0.0
    assert watch.update(100.2, (9000.0, 0.0, 0.0), None, SCATTER) == 0.0
    watch.reset()
    assert watch.update(100.4, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), SCATTER) == 0.0
