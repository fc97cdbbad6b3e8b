"""A vehicle on wheels in an outage: its nose tells where it goes, and nothing is said of hovering."""

import numpy as np
import pytest

from nav_pose_estimator.core.motion.air_velocity import learn_air_velocity
from nav_pose_estimator.engine.outage.methods.best import NETWORK, Best
from nav_pose_estimator.engine.outage.methods.method import Flight
from true_epochs import epochs_of

pytestmark = pytest.mark.compiled


@pytest.mark.parametrize(("scenario", "names"), [("road_vehicle", ["travel"]), ("hover", ["travel", "hover"])])
def test_a_car_is_never_taken_for_one_that_hovers(scenario: str, names: list[str]) -> None:
    """GIVEN a learned vehicle WHEN GNSS is lost THEN only what flies may hover; a car tells by its nose."""
    epochs = epochs_of(scenario, seed=1)
    guide = Best().ways(Flight(epochs, learn_air_velocity(epochs)))[NETWORK]
    advice = guide.advise(10**9, epochs[-4:])
    (evidence,) = advice.samples
    assert [hypothesis.name for hypothesis in evidence.hypotheses] == names
    assert advice.velocity_error is not None
    if scenario == "road_vehicle":
        (travel,) = evidence.hypotheses
        assert travel.velocity_var is None
        assert evidence.wind == evidence.wind_mean == (0.0, 0.0)
        assert evidence.wind_spread == 0.0
        np.testing.assert_array_equal(evidence.wind_cov, 0.0)
        slip = np.array(evidence.body_velocity)[1] - np.array(evidence.air_velocity)[1]
        assert abs(slip) < 0.3, "the true motion does not slip"
