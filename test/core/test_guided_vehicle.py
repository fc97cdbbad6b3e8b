"""On wheels the network learns that there is no side slip; in the air it learns the wind. Epochs of the true motion."""

import numpy as np
import pytest

from nav_pose_estimator.core import layout as at
from nav_pose_estimator.core import motion_epochs as me
from nav_pose_estimator.core.outage_learning import AirVelocityModel, learn_air_velocity
from nav_pose_estimator.sim.scenarios import generate

pytestmark = pytest.mark.compiled
SECONDS = 150.0


def epochs_of(scenario: str, seed: int) -> np.ndarray:
    """Half-second epochs (N, COLUMNS) of a vehicle under way, its velocity known to 3 cm/s."""
    truth = generate(scenario, SECONDS, seed, "perfect", imu_rate=50.0).truth
    rows = np.zeros((len(truth), at.OUT_COLUMNS))
    rows[:, at.OUT_QUAT : at.OUT_QUAT + 4] = truth.q_nb
    rows[:, at.OUT_VEL : at.OUT_VEL + 3] = truth.v_n
    rows[:, at.OUT_FORCE : at.OUT_FORCE + 3] = truth.accel
    rows[:, at.OUT_RATE : at.OUT_RATE + 3] = truth.gyro
    epochs = np.array([me.epoch(truth.t[i + 24], rows[i : i + 25]) for i in range(25 * 40, len(rows) - 25, 25)])
    noise = 0.03 * np.random.default_rng(seed).standard_normal((len(epochs), 3))
    epochs[:, me.BODY_VELOCITY : me.VELOCITY] += noise
    return epochs


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
