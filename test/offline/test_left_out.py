"""What the table of ``train`` and the noise of an archive are made of."""

import numpy as np
import pytest

from flown import Flight
from nav_pose_estimator.core.motion import epochs as me
from nav_pose_estimator.core.motion.air_velocity import learn_air_velocity, with_law
from nav_pose_estimator.core.motion.wind import WIND_TIME
from nav_pose_estimator.offline.training.left_out import lasting_noise

LAW = learn_air_velocity(Flight(seed=2).epochs()).network


def test_an_error_that_lasts_counts_in_full() -> None:
    """GIVEN a law that errs by half a metre per second upwards, one way for a minute and then the other, WHEN judged on
    the whole flight THEN its noise is what makes such errors of means over WIND_TIME."""
    epochs = Flight(seconds=480.0).epochs()
    slow = 0.5 * np.sign(np.sin(2.0 * np.pi * epochs[:, me.TIME] / (6.0 * WIND_TIME)))
    epochs[:, me.BODY_VELOCITY + 2] += slow
    model = with_law(epochs, LAW)
    noise = lasting_noise(epochs, model)
    assert noise[2] == pytest.approx(WIND_TIME * 0.5**2, rel=0.1)
    assert noise[2] > 2.0 * model.noise[2]


def test_noise_of_seconds_is_what_the_model_says_already() -> None:
    """GIVEN a law that errs by nothing that lasts WHEN judged THEN its noise is the model's own, or little more."""
    epochs = Flight(seconds=480.0, seed=5).epochs()
    model = with_law(epochs, LAW)
    np.testing.assert_array_less(lasting_noise(epochs, model), 2.0 * model.noise)
    assert (lasting_noise(epochs, model) >= model.noise).all()
