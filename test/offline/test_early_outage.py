"""GNSS is lost after one minute of flight: little has been learned, and the estimator has to say so."""

import numpy as np
import pytest

from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.offline.benchmarks.outage.benchmark import FlightResult, run_outages
from nav_pose_estimator.offline.flights import methods
from nav_pose_estimator.offline.flights.outages import Outage
from nav_pose_estimator.offline.flights.simulated_flight import in_memory
from nav_pose_estimator.sim.scenarios import generate

pytestmark = pytest.mark.compiled
START, LENGTH = 60.0, 30.0


@pytest.mark.parametrize(
    ("scenario", "grade", "seed"),
    [("laps", "icm42688", 4), ("multirotor_light", "icm42688", 7), ("fixed_wing", "mpu6000", 4)],
)
def test_what_a_minute_has_taught_is_not_overrated(scenario: str, grade: str, seed: int) -> None:
    """GIVEN a minute of flight WHEN GNSS is lost for half a minute THEN no error exceeds three sigma on the way or at
    the end, and the vehicle is not lost."""
    made = in_memory(generate(scenario, START + LENGTH + 5.0, seed, grade))
    result = FlightResult(scenario, 0.0, (0.0, START + LENGTH))
    run_outages(made, methods.apply(Parameters(), "best"), {LENGTH: [Outage(START, LENGTH)]}, ("best",), result)
    (errors,) = result.errors["best", LENGTH]
    assert len(errors.growth) > 20
    assert (errors.growth < 3.0 * np.maximum(errors.sigma, 1.0)).all()
    assert errors.end_error_m < 50.0
