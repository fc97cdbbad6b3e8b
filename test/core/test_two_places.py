"""Fixes that come from two places in turn."""

import numpy as np
import pytest

from nav_pose_estimator.core.gnss.two_places import TwoPlaces


def offered(apart: float, noise: float, count: int = 60, wander: float = 0.0) -> list[float]:
    """How far apart two places are found after every fix; every other one lies ``apart`` [m] to the East."""
    rng, places, found = np.random.default_rng(3), TwoPlaces(), []
    slow = np.cumsum(rng.normal(0.0, wander, (count, 2)), axis=0)
    for k in range(count):
        east, north = slow[k] + rng.normal(0.0, noise, 2)
        places.note(east + apart * (k % 2), north)
        found.append(places.apart)
    return found


@pytest.mark.parametrize("apart", [3.0, 40.0])
def test_two_places_in_turn_are_found_after_two_looks(apart: float) -> None:
    found = offered(apart, noise=0.4)
    assert found[22] == 0.0
    assert found[-1] == pytest.approx(apart, abs=0.6)


@pytest.mark.parametrize(("noise", "wander"), [(0.4, 0.0), (5.0, 0.0), (0.3, 1.0)], ids=["white", "noisy", "wandering"])
def test_one_receiver_is_in_one_place(noise: float, wander: float) -> None:
    assert not any(offered(0.0, noise, count=2000, wander=wander))


def test_it_ends() -> None:
    places = TwoPlaces()
    for k in range(24):
        places.note(10.0 * (k % 2), 0.0)
    assert places.least_sd == pytest.approx(5.0)
    assert "10.0 m off: two receivers" in places.reason
    for _ in range(12):
        places.note(0.1, 0.0)
    assert places.reason == ""
