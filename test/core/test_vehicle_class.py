"""What kind of vehicle it is, told by how it moves: never wrong where it is certain, and certain in the end."""

import numpy as np
import pytest

from flown import Flight, drive
from nav_pose_estimator.core.motion import epochs as me
from nav_pose_estimator.core.motion.airframe import Beforehand
from nav_pose_estimator.core.motion.vehicle_class import (
    BOAT,
    FIXED_WING,
    MULTIROTOR,
    UNKNOWN,
    WHEELS,
    class_probabilities,
    classify,
)
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
    epochs = epochs_of(scenario, seed, 220.0)
    told = [classify(epochs[:count]) for count in range(2, len(epochs), 4)]
    assert set(told) <= {UNKNOWN, vehicle_class}
    assert told[-1] == vehicle_class


def test_what_has_not_moved_is_not_told() -> None:
    """GIVEN no flight, or one at the pace of a walk WHEN asked THEN no class is certain."""
    assert classify(np.empty((0, me.COLUMNS))) == UNKNOWN
    carried = Flight(speed=1.0, wind=(0.0, 0.0)).epochs()
    assert classify(carried) == UNKNOWN
    assert sum(class_probabilities(carried).values()) == pytest.approx(1.0)


def test_what_is_known_beforehand_yields_to_what_flies() -> None:
    """GIVEN a class from before the flight WHEN the flight shows another one that flies THEN that one holds; what rolls
    may be a wing that taxies."""
    flight = Flight().epochs()
    assert Beforehand(MULTIROTOR).by_flight(flight) == Beforehand(MULTIROTOR)
    assert Beforehand(FIXED_WING).by_flight(flight) == Beforehand(MULTIROTOR)
    assert Beforehand(FIXED_WING).by_flight(drive()) == Beforehand(FIXED_WING)
    assert Beforehand().by_flight(drive()) == Beforehand(WHEELS)


def test_what_moves_unlike_a_multirotor_is_never_said_to_hover() -> None:
    """GIVEN four seconds under way, or a flight WHEN asked who may hover THEN no wing, car or boat, told or not yet; a
    multirotor may before it has done so, and later its flight has to show it."""
    for scenario in ("fixed_wing", "road_vehicle", "boat_lanes"):
        epochs = epochs_of(scenario, 71, 220.0)
        moves = int(np.argmax(np.hypot(epochs[:, me.VELOCITY], epochs[:, me.VELOCITY + 1]) > 2.0))
        assert classify(epochs[: moves + 8]) == UNKNOWN
        assert Beforehand().can_hover(epochs[: moves + 8]) is False
        assert Beforehand().can_hover(epochs) is False
    flight = Flight().epochs()
    assert Beforehand().can_hover(flight[:60]) is True
    assert Beforehand().can_hover(flight) is None
    assert Beforehand().can_hover(flight[:0]) is None


def test_a_few_strange_seconds_decide_nothing() -> None:
    """GIVEN a drive WHEN it jumps for two seconds as no wheels do THEN it is still a drive."""
    epochs = drive()
    epochs[200:204, me.BODY_VELOCITY + 1 : me.BODY_VELOCITY + 3] = 20.0
    assert classify(epochs) == WHEELS
