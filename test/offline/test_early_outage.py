"""GNSS is lost after one minute of flight: little has been learned, and the estimator has to say so."""

import numpy as np
import pytest

from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.offline.benchmarks.outage.trials import FlightResult, run_outages
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


def test_the_usual_drag_guides_before_the_flight_has_taught_one() -> None:
    """GIVEN a minute of flight in a fresh wind WHEN GNSS is lost for another minute THEN the drag of other multirotors
    keeps error and sigma at half of what the usual speed alone leaves (69 m with sigma 42)."""
    made = in_memory(generate("multirotor_moderate", 125.0, 702, "icm42688"))
    result = FlightResult("multirotor_moderate", 0.0, (0.0, 120.0))
    run_outages(made, methods.apply(Parameters(), "best"), {60.0: [Outage(60.0, 60.0)]}, ("best",), result)
    (errors,) = result.errors["best", 60.0]
    assert errors.end_error_m < 35.0
    assert errors.end_sigma_m < 35.0
    assert errors.end_error_m < 3.0 * errors.end_sigma_m
