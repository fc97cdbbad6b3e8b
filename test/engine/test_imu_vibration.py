"""Vibration that begins without GNSS, and a speed that the vehicle never had."""

import math

import numpy as np
import pytest

from nav_pose_estimator.engine.imu.seconds import ImuSecond, second_of
from nav_pose_estimator.engine.imu.speed_doubt import SpeedDoubt
from nav_pose_estimator.engine.imu.vibration import Vibration
from nav_pose_estimator.engine.journal import Journal


def shaken(force: float, rate: float = 0.0) -> ImuSecond:
    """A second of 100 samples with so much white noise on every axis."""
    rows = np.zeros((100, 7))
    rows[:, 0] = np.arange(100) / 100.0
    rows[:, 1:4] = rate * np.random.default_rng(1).standard_normal((100, 3))
    rows[:, 4:] = [0.0, 0.0, 9.8] + force * np.random.default_rng(2).standard_normal((100, 3))
    second = second_of(rows, 1.0)
    assert second is not None
    return second


def told(*seconds: tuple[ImuSecond, bool]) -> tuple[Vibration, Journal]:
    vibration, journal = Vibration(), Journal()
    for second, is_aided in seconds:
        vibration.second(second, is_aided, journal, 0)
    return vibration, journal


def test_what_begins_in_an_outage_counts_as_the_noise_that_it_may_be() -> None:
    """GIVEN white noise of 6 m/s^2 and 0.3 rad/s on each axis that GNSS has not seen THEN its density is known."""
    vibration, journal = told((shaken(0.3, 0.01), True), (shaken(6.0, 0.3), False))
    assert vibration.force_noise == pytest.approx(6.0 / math.sqrt(100.0), rel=0.2)
    assert vibration.rate_noise == pytest.approx(0.3 / math.sqrt(100.0), rel=0.2)
    assert journal.counters["imu.vibration.risen"] == 1
    assert "10" in vibration.reason


def test_what_was_there_before_is_nothing_new() -> None:
    vibration, journal = told((shaken(6.0, 0.3), True), (shaken(7.0, 0.35), False))
    assert vibration.force_noise < 0.15
    assert vibration.rate_noise == 0.0
    assert not journal.counters
    assert vibration.reason == ""


def test_the_whole_vibration_of_a_doubted_gyroscope_counts_in_an_outage() -> None:
    """GIVEN a gyroscope with 0.3 rad/s of noise that GNSS has contradicted WHEN GNSS is lost
    THEN each second widens the attitude by the random walk of that noise; with GNSS, or without doubt, none does."""
    vibration, journal, second = Vibration(), Journal(), shaken(0.3, 0.3)
    assert vibration.second(second, True, journal, 0, gyroscope_is_doubted=True) is None
    assert vibration.second(second, False, journal, 0) is None
    doubts = [vibration.second(second, False, journal, 0, gyroscope_is_doubted=True) for _ in range(2)]
    assert [doubt and doubt.tilt for doubt in doubts] == pytest.approx([0.3 / math.sqrt(100.0)] * 2, rel=0.2)


def test_its_rectification_is_told_once() -> None:
    vibration, journal = Vibration(), Journal()
    doubts = [vibration.second(shaken(6.0), False, journal, 0) for _ in range(5)]
    assert doubts[0] is not None
    assert doubts[0].accel_bias > 0.05
    assert doubts[1:] == [None] * 4


def test_a_speed_beyond_all_that_was_casts_doubt_in_proportion() -> None:
    """GIVEN a vehicle of 6 m/s at most WHEN the navigator reads 30 m/s without GNSS THEN sigma covers the excess."""
    speed = SpeedDoubt()
    speed.aided(6.0)
    assert speed.unaided(8.5, 1.0, 5.0) is None, "a little faster"
    doubt = speed.unaided(30.0, 1.0, 20.0)
    assert doubt is not None
    assert doubt.speed == pytest.approx(21.0)
    assert doubt.position == pytest.approx(140.0)
    assert "30 m/s" in speed.reason
    assert speed.unaided(31.0, 25.0, 21.0) is None, "it is covered now"
    speed.aided(6.0)
    assert speed.reason == ""


def test_a_vague_speed_is_no_surprise() -> None:
    assert SpeedDoubt().unaided(30.0, 15.0, 60.0) is None
