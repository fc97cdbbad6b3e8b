"""Seconds of the IMU that are told to be usual at once: no check of its plausibility has anything to say of them."""

import math

import numpy as np

from nav_pose_estimator.engine.imu.plausibility import ALWAYS, find, two_imus
from nav_pose_estimator.engine.imu.seconds import ImuSecond

SECONDS = 8


def second(random: np.random.Generator) -> ImuSecond:
    """One whose values lie around the limits of the checks."""
    gravity = random.choice([0.0, 1.0, 2.0, 3.0, 8.0, 9.0, 9.8, 11.5, 60.0])
    turn = random.choice([0.0, 0.04, 0.06, 5.0, 9.0])
    spread = random.choice([0.0, 0.5], 6, p=[0.1, 0.9])
    vibration = random.choice([0.1, 0.5])
    rate, force = (turn, 0.0, 0.0), (0.0, 0.0, gravity)
    norm = max(gravity, random.choice([0.0, 1.0, 9.8]))
    return ImuSecond(0.0, 200, rate, force, norm, vibration, 0.0, tuple(spread.tolist()), False, gravity, turn)


def test_a_usual_second_has_no_finding_and_any_other_is_checked_in_full() -> None:
    """GIVEN seconds on both sides of all limits THEN the first finding is that of the checks one after the other."""
    random, found = np.random.default_rng(4), 0
    for _ in range(3000):
        seconds = [second(random)] * SECONDS if random.random() < 0.7 else [second(random) for _ in range(SECONDS)]
        first = next((finding for check in ALWAYS if (finding := check(seconds, 4)) is not None), None)
        assert find(seconds, in_flight=True) == first
        found += first is not None
    assert 300 < found < 2700


def test_two_imus_show_in_seconds_before_a_usual_one() -> None:
    usual = ImuSecond(0.0, 200, (0.0,) * 3, (0.0, 0.0, 9.8), 9.8, 0.5, 0.01, (0.5,) * 6, False, 9.8, 0.0)
    seconds = [usual._replace(interleaved=True)] * 2 + [usual] * 6
    assert find(seconds, in_flight=True) == two_imus(seconds, 4) is not None
    assert find([usual._replace(gravity=math.nan)] * 8, in_flight=True) is None
