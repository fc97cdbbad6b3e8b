"""What a sensor's record of its innovations tells: how large they are beside what was stated, and whether they last."""

import math

import numpy as np
import pytest

from nav_pose_estimator.engine.sensors.gnss.innovation_record import InnovationRecord


def record_of(innovations: np.ndarray) -> InnovationRecord:
    record = InnovationRecord()
    for z in innovations:
        record.add(float(z @ z), z, 0.2)
    return record


@pytest.mark.parametrize("correlation", [0.0, 0.6, 0.95])
def test_it_finds_how_alike_consecutive_innovations_are(correlation: float) -> None:
    """GIVEN innovations of a first-order process THEN their autocorrelation at lag one is the process's own."""
    random = np.random.default_rng(5)
    z = np.zeros((300, 3))
    for i in range(1, len(z)):
        z[i] = correlation * z[i - 1] + math.sqrt(1.0 - correlation**2) * random.normal(size=3)
    assert record_of(z).lag_one == pytest.approx(correlation, abs=0.08)


def test_the_vertical_does_not_count() -> None:
    z = np.random.default_rng(6).normal(size=(200, 3))
    z[:, 2] = 100.0
    assert abs(record_of(z).lag_one) < 0.1


def test_nothing_is_known_of_one_innovation_or_of_none() -> None:
    assert math.isnan(record_of(np.ones((1, 2))).lag_one)
    assert math.isnan(InnovationRecord().lag_one)
    assert math.isnan(record_of(np.zeros((5, 2))).lag_one)


def test_an_innovation_that_is_no_number_is_left_out() -> None:
    record = record_of(np.ones((3, 2)))
    record.add(math.nan, np.full(2, math.nan), 0.2)
    assert record.lag_one == pytest.approx(2.0 / 3.0)


def test_the_offset_is_what_the_last_ten_seconds_have_in_common() -> None:
    """GIVEN fixes five times a second that are 1 m West for ten seconds, one refused among them THEN that is it."""
    record = record_of(np.tile([3.0, 0.0], (50, 1)))
    for z in np.tile([1.0, 0.0], (49, 1)):
        record.add(0.5, z, 0.2)
    record.add(90.0, np.array([80.0, 0.0]), 0.2, accepted=False)
    record.add(0.5, np.array([1.0, 0.0]), 0.2)
    np.testing.assert_allclose(record.offset, [1.0, 0.0])
    np.testing.assert_array_equal(InnovationRecord().offset, [0.0, 0.0])


@pytest.mark.parametrize("count", [20, 25])
def test_a_lasting_innovation_is_the_median_less_what_may_be_chance(count: int) -> None:
    """GIVEN scattered innovations 5 m East THEN the size that lasts is that of numpy's medians."""
    z = np.random.default_rng(8).normal([5.0, 0.0], 1.0, (60, 2))
    last = z[-count:]
    middle = np.median(last, axis=0)
    chance = 3.0 * np.median(np.hypot(*(last - middle).T)) / math.sqrt(count)
    assert record_of(z).lasting(0.2 * count) == pytest.approx(np.hypot(*middle) - chance, abs=1e-12)
    assert record_of(z[:7]).lasting(1.4) == 0.0
