"""The class of recorded flights by what the navigator makes of them."""

import numpy as np
import pytest

from nav_pose_estimator.core.motion.vehicle_class import FIXED_WING, MULTIROTOR, UNKNOWN, classify
from nav_pose_estimator.offline.training.flights import Reading, Recorded, fly

FLIGHTS = {
    "px4_search": (FIXED_WING, 20),
    "px4_flow": (FIXED_WING, 60),
    "quad_log171": (MULTIROTOR, 20),
    "quad106": (MULTIROTOR, 20),
}
"""Class, and seconds after which it has to be told."""


@pytest.mark.compiled
@pytest.mark.parametrize("name", FLIGHTS)
def test_recorded_flights_are_told_and_never_mistaken(shared_data, name: str) -> None:
    """GIVEN a recorded flight WHEN asked again and again THEN no other class is ever certain, and its own is soon."""
    vehicle_class, soon = FLIGHTS[name]
    epochs = fly(Recorded(shared_data / "flights" / f"{name}_bag", "", Reading())).epochs
    told = np.array([classify(epochs[:count]) for count in range(2, len(epochs), 2)])
    assert set(told) <= {UNKNOWN, vehicle_class}
    assert set(told[soon:]) == {vehicle_class}
