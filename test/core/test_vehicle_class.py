"""What kind of vehicle it is, told by how it moves: never wrong where it is certain, and certain in the end."""

import numpy as np
import pytest

from flown import Flight, drive
from nav_pose_estimator.core.motion import epochs as me
from nav_pose_estimator.core.motion.airframe import BOAT, FIXED_WING, MULTIROTOR, UNKNOWN, WHEELS
from nav_pose_estimator.core.motion.vehicle_class import tell_class
from true_epochs import epochs_of

SCENARIOS = {
    "multirotor_light": MULTIROTOR,
    "multirotor_moderate": MULTIROTOR,
    "laps": MULTIROTOR,
    "stop_and_go": MULTIROTOR,
    "drone_over_water": MULTIROTOR,
    "fixed_wing": FIXED_WING,
    "road_vehicle": WHEELS,
    "boat_lanes": BOAT,
}


@pytest.mark.parametrize(("scenario", "vehicle_class"), SCENARIOS.items())
@pytest.mark.parametrize("seed", [71, 72])
def test_simulated_vehicles_are_told_and_never_mistaken(scenario: str, vehicle_class: str, seed: int) -> None:
    """GIVEN a vehicle under way WHEN asked again and again THEN no other class is ever certain, and its own is at
    last."""
    epochs = epochs_of(scenario, seed)
    told = [tell_class(epochs[:count]).vehicle_class for count in range(2, len(epochs), 4)]
    assert set(told) <= {UNKNOWN, vehicle_class}
    assert told[-1] == vehicle_class


def test_what_has_not_moved_is_not_told() -> None:
    """GIVEN no flight, or one at the pace of a walk WHEN asked THEN no class is certain."""
    assert tell_class(np.empty((0, me.COLUMNS))).vehicle_class == UNKNOWN
    carried = Flight(speed=1.0, wind=(0.0, 0.0)).epochs()
    told = tell_class(carried)
    assert told.vehicle_class == UNKNOWN
    assert sum(told.probability.values()) == pytest.approx(1.0)
    assert told.can_hover is None


def test_a_class_says_whether_it_hovers() -> None:
    assert tell_class(Flight().epochs()).can_hover is True
    assert tell_class(drive()).vehicle_class == WHEELS
    assert tell_class(drive()).can_hover is None


def test_a_few_strange_seconds_decide_nothing() -> None:
    """GIVEN a drive WHEN it jumps for two seconds as no wheels do THEN it is still a drive."""
    epochs = drive()
    epochs[200:204, me.BODY_VELOCITY + 1 : me.BODY_VELOCITY + 3] = 20.0
    assert tell_class(epochs).vehicle_class == WHEELS
