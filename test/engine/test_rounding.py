"""Positions that have lost digits."""

import math
from collections.abc import Iterable

import numpy as np
import pytest

from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.sensors.gnss.digits import Rounding

HOME = (47.3977419, 8.5455937)  # deg


def offered(places: Iterable[tuple[float, float]], moves: bool = False) -> tuple[Rounding, Journal]:
    journal = Journal()
    rounding = Rounding(journal)
    for lat, lon in places:
        rounding.fix(math.radians(lat), math.radians(lon), moves, 0)
    return rounding, journal


def wandering(count: int, speed: float = 5e-6) -> np.ndarray:
    """(N, 2) deg, of a receiver with seven decimals."""
    rng = np.random.default_rng(7)
    return np.round(np.array(HOME) + np.cumsum(rng.normal(0.0, speed, (count, 2)), axis=0), 7)


@pytest.mark.parametrize("step", [1e-3, 1e-4, 1e-2 / 60.0, 1e-3 / 60.0, 1.0 / 3600.0])
def test_the_grid_is_found_and_its_error_known(step: float) -> None:
    rounding, journal = offered(np.round(wandering(12) / step) * step)
    assert journal.counters["gnss.rounded"] == 1
    assert rounding.sd[1] == pytest.approx(step * 111e3 / math.sqrt(12.0), rel=0.01)
    assert rounding.sd[0] == pytest.approx(rounding.sd[1] * math.cos(math.radians(HOME[0])), rel=0.01)


def test_a_receiver_with_all_digits_is_not_rounded() -> None:
    assert not offered(wandering(2000))[1].counters


def test_single_precision_and_five_decimals_cost_nothing() -> None:
    places = wandering(200)
    for lossy in (places.astype(np.float32).astype(float), np.round(places, 5)):
        assert not offered(lossy)[1].counters


def test_a_simulator_that_stands_at_a_round_place_is_not_rounded_until_it_moves_there() -> None:
    """GIVEN no noise and 47.4 N 8.55 E THEN nothing is said; WHEN velocities tell of motion meanwhile THEN it is."""
    there = [(47.4, 8.55)] * 50
    assert not offered(there)[1].counters
    assert offered(there, moves=True)[0].step > 1e3


def test_it_ends_with_the_first_fix_off_the_grid() -> None:
    rounding, journal = offered([*np.round(wandering(20), 3), HOME])
    assert not rounding.is_on
    assert rounding.reason == ""
    assert journal.counters["gnss.rounded.ended"] == 1
