"""A simulated flight in memory is the flight that a bag of it would give, and outages on it are judged."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nav_pose_estimator.engine.outage.methods.hold import Hold
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import ImuBlock
from nav_pose_estimator.offline.benchmarks.outage.trials import FlightResult, run_outages
from nav_pose_estimator.offline.flights import methods
from nav_pose_estimator.offline.flights.outages import periodic
from nav_pose_estimator.offline.flights.recording import Recording, load
from nav_pose_estimator.offline.flights.simulated_flight import in_memory
from nav_pose_estimator.offline.flights.tracks import displacement_enu
from nav_pose_estimator.offline.simulated_bag import write_recording
from nav_pose_estimator.sim.scenarios import generate


def kinds(recording: Recording) -> list[str]:
    return [type(sample).__name__ for sample in recording.samples if not isinstance(sample, ImuBlock)]


def test_it_is_what_the_bag_would_give(tmp_path: Path) -> None:
    """GIVEN a simulated flight WHEN taken from memory and from its bag THEN clock, samples and truth agree."""
    simulated = generate("multirotor_light", 20.0, seed=1, imu_rate=100.0)
    write_recording(tmp_path / "bag", simulated)
    ours, read = in_memory(simulated), load(tmp_path / "bag")
    assert (ours.epoch_ns, ours.duration, ours.imu_count) == (read.epoch_ns, read.duration, read.imu_count)
    assert kinds(ours) == kinds(read)
    np.testing.assert_array_equal(ours.fix_times(0.0), read.fix_times(0.0))
    times = ours.fix_times(0.0)
    apart = displacement_enu(ours.reference(0.0).at(times), read.reference(0.0).at(times))
    # the bag holds the truth at 50 Hz, straight lines between: up to a dt^2 / 8
    assert np.abs(apart).max() < 1e-3


@pytest.mark.compiled
def test_outages_run_on_it() -> None:
    """GIVEN two planned outages WHEN coasting runs through them THEN each is filed at each length."""
    simulated = in_memory(generate("multirotor_light", 80.0, seed=1, imu_rate=100.0))
    planned = {5.0: periodic(15.0, 5.0, 50.0, 70.0), 10.0: periodic(15.0, 10.0, 50.0, 75.0)}
    result = FlightResult(simulated.name, 0.0, (0.0, 80.0))
    run_outages(simulated, methods.apply(Parameters(), methods.COAST), planned, ("here", Hold.name), result)
    assert set(result.errors) == {(name, length) for name in ("here", Hold.name) for length in (5.0, 10.0)}
    for outages in result.errors.values():
        assert [one.start_s for one in outages] == [50.0, 65.0]
        assert {one.status for one in outages} == {"ok"}
    assert max(one.end_error_m for one in result.errors["here", 10.0]) < 15.0


@pytest.mark.compiled
def test_no_outage_is_judged_that_begins_while_the_navigator_doubts_itself() -> None:
    """GIVEN an IMU that shakes heavily, which the aided navigator says of itself, WHEN an outage begins THEN it is not
    judged, and the reason stands in its row."""
    simulated = in_memory(generate("multirotor_light", 60.0, seed=1, imu_rate=100.0))
    random = np.random.default_rng(1)
    for i, sample in enumerate(simulated.samples):
        if isinstance(sample, ImuBlock):
            simulated.samples[i] = replace(sample, accel=sample.accel + random.normal(0.0, 9.0, sample.accel.shape))
    result = FlightResult(simulated.name, 0.0, (0.0, 60.0))
    planned = {5.0: periodic(10.0, 5.0, 50.0, 55.0)}
    run_outages(simulated, methods.apply(Parameters(), methods.COAST), planned, ("coast",), result)
    (errors,) = result.errors["coast", 5.0]
    assert errors.status == "not_aided"
    assert "vibrates" in errors.why
