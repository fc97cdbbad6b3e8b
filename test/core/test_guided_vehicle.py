"""On wheels the network learns that there is no side slip; in the air it learns the wind. Epochs of the true motion."""

import numpy as np
import pytest

from nav_pose_estimator.core.motion.air_velocity import AirVelocityModel, learn_air_velocity
from true_epochs import epochs_of

pytestmark = pytest.mark.compiled


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_car_does_not_slip(seed: int) -> None:
    """GIVEN a drive WHEN learned THEN no wind, and the sideways velocity is known to centimetres per second."""
    model = learn_air_velocity(epochs_of("road_vehicle", seed))
    assert model.is_guided
    np.testing.assert_array_equal(model.wind_mean, 0.0)
    np.testing.assert_array_equal(model.wind, 0.0)
    assert model.noise[1] < 0.3**2 < model.noise[0], "sideways is known, ahead is not"


@pytest.mark.parametrize("scenario", ["multirotor_light", "laps", "hover", "fixed_wing"])
def test_what_flies_has_a_wind(scenario: str) -> None:
    """GIVEN a vehicle in the air, even one that flies nose first WHEN learned THEN the wind is part of the model."""
    model = learn_air_velocity(epochs_of(scenario, seed=1))
    assert not model.is_guided
    assert model.wind_spread > 0.0


def test_a_car_stays_one_through_aided_epochs_and_a_file() -> None:
    """GIVEN a model on wheels WHEN it follows new epochs, is saved and loaded THEN it still knows no wind."""
    epochs = epochs_of("road_vehicle", seed=4)
    model = learn_air_velocity(epochs[:-20])
    for one in epochs[-20:]:
        model = model.follow(one)
    again = AirVelocityModel.from_state(model.state())
    assert again.is_guided
    np.testing.assert_array_equal(again.wind, 0.0)
    np.testing.assert_array_equal(again.predict(epochs[-1])[0], model.predict(epochs[-1])[0])
