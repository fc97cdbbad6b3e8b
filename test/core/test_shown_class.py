"""What a vehicle is by how it moves, and when that contradicts what is known beforehand."""

import numpy as np
import pytest

from flown import Flight, drive
from nav_pose_estimator.core.motion import epochs as me
from nav_pose_estimator.core.motion.airframe import FIXED_WING, MULTIROTOR, UNKNOWN, WHEELS
from nav_pose_estimator.core.motion.shown_class import contradiction


def wing(seconds: float = 200.0) -> np.ndarray:
    """What never goes slower than 14 m/s, and slips."""
    epochs = Flight(seconds).epochs()
    epochs[:, me.VELOCITY] += 20.0
    return epochs


@pytest.mark.parametrize(
    ("epochs", "known", "shown"),
    [
        (drive(), MULTIROTOR, WHEELS),
        (drive(), WHEELS, ""),
        (drive(), UNKNOWN, ""),
        (wing(), MULTIROTOR, FIXED_WING),
        (wing(), FIXED_WING, ""),
        (wing(40.0), MULTIROTOR, ""),
        (Flight(hover=0.5).epochs(), FIXED_WING, MULTIROTOR),
        (Flight(hover=0.5).epochs(), MULTIROTOR, ""),
    ],
)
def test_a_minute_under_way_shows_the_class(epochs: np.ndarray, known: str, shown: str) -> None:
    """GIVEN a class known beforehand WHEN a minute under way looks like another one THEN that is the contradiction."""
    assert contradiction(epochs, known) == shown


def test_a_wing_that_stands_on_the_ground_is_none_that_hovers() -> None:
    """GIVEN a wing that stood before the flight and stands after it THEN nothing is contradicted."""
    stands = wing()[:100].copy()
    stands[:, me.VELOCITY : me.VELOCITY + 2] = 0.0
    assert contradiction(np.concatenate([stands, wing(), stands]), FIXED_WING) == ""
