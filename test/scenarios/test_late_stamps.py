"""GNSS whose stamps are late, while nobody has set gnss.delay: the pose is where the vehicle was."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.engine.navigator.filter_run import state_of
from nav_pose_estimator.engine.samples import GnssFix, GnssVelocity, Sample
from nav_pose_estimator.sim.recording import Recording
from told import Told, flight, silence, tell

pytestmark = pytest.mark.compiled
SECONDS = 75.0


def stamped_late(recording: Recording, seconds: float) -> Iterator[Sample]:
    for sample in recording.samples():
        if isinstance(sample, GnssFix | GnssVelocity):
            yield replace(sample, stamp_ns=sample.stamp_ns + round(seconds * 1e9))
        else:
            yield sample


def fly(late: float, vehicle: str = "stop_and_go", **settings: float) -> Told:
    recording = flight(vehicle, SECONDS)
    return tell(recording, samples=stamped_late(recording, late), learner__enabled=False, **settings)


@pytest.mark.parametrize("late", [0.4, -0.4], ids=["late", "early"])
def test_stamps_that_are_late_are_told_with_the_amount_and_covered(late: float) -> None:
    """GIVEN stamps wrong by 0.4 s WHEN the vehicle has manoeuvred THEN that is said, and sigma covers the way."""
    told = fly(late)
    event = told.event("gnss.delayed")
    assert event.data["delay"] == pytest.approx(late, abs=0.1)
    assert ("lags" if late > 0.0 else "leads") in told.estimator.status().doubt
    after = told.t > told.when("gnss.delayed")[0] + 1.0
    assert np.mean(told.off[after] < 3.0 * told.sigma[after]) > 0.99
    assert told.off[after].max() > 2.0


def test_a_latency_beyond_those_that_are_tried_is_told_as_a_least_one() -> None:
    """GIVEN stamps late by 1 s, more than is tried THEN the advice does not end at 0.6 s, and sigma covers it."""
    told = fly(1.0)
    assert "0.6 s or more: set gnss.delay to 0.6 and fly again" in told.event("gnss.delayed").text
    assert "or more" not in fly(0.4).event("gnss.delayed").text
    after = told.t > told.when("gnss.delayed")[0] + 1.0
    assert np.mean(told.off[after] < 2.0 * told.sigma[after]) > 0.97


@pytest.mark.parametrize("late", [0.0, 0.4])
def test_what_is_set_is_not_told(late: float) -> None:
    """GIVEN the right ``gnss.delay`` THEN nothing is said of it."""
    assert fly(late, gnss__delay=late).count("gnss.delayed") == 0


def share_beyond(told: Told, sigmas: float) -> float:
    """Share of the time before the latency is told in which the position is off by more than ``sigmas``, and 3 m."""
    before = told.t < min(told.when("gnss.delayed"), default=SECONDS)
    return float(np.mean((told.off > sigmas * told.sigma)[before] & (told.off > 3.0)[before]))


@pytest.mark.parametrize("vehicle", ["laps", "fixed_wing", "road_vehicle"])
def test_the_uncertain_latency_is_covered_from_the_start(vehicle: str) -> None:
    """GIVEN stamps late by 0.4 s WHEN that is not known yet, as in steady turns for long THEN three sigma cover the
    way, which they do not where the stamps are said to be right."""
    assert share_beyond(fly(0.4, vehicle), 3.0) == 0.0
    assert share_beyond(fly(0.4, vehicle, gnss__delay_sd=0.0), 3.0) > 0.05


def test_the_uncertain_latency_is_saved_for_a_restart() -> None:
    """GIVEN a fast vehicle in an outage WHEN its state is saved THEN with the variances that are published, which a
    restart would else forget; with a known latency nothing is added."""
    lost = silence(70.0, SECONDS)
    for delay_sd, is_larger in ((0.2, True), (0.0, False)):
        told = tell(flight("fixed_wing", SECONDS), *lost, learner__enabled=False, gnss__delay_sd=delay_sd)
        run = told.estimator.sins.run
        saved = state_of(run)
        assert saved is not None
        variances, own = saved.cov.diagonal()[at.DPOS : at.DPOS + 3], run.settled.P.diagonal()[at.DPOS : at.DPOS + 3]
        assert variances == pytest.approx(told.variances[-1], rel=0.02)
        assert (variances[:2].sum() > 1.2 * own[:2].sum()) == is_larger


def test_an_uncertain_latency_moves_nothing() -> None:
    """GIVEN sound stamps WHEN their latency is uncertain THEN the pose is the same to the bit, and so is sigma where
    ``gnss.delay`` is set; sigma grows with the speed, and stays larger in an outage."""
    recording, lost = flight("laps", SECONDS), silence(60.0, SECONDS)
    unsure, sure = (tell(recording, *lost, learner__enabled=False, gnss__delay_sd=sd) for sd in (0.2, 0.0))
    np.testing.assert_array_equal(unsure.position, sure.position)
    extra = np.sqrt(unsure.sigma**2 - sure.sigma**2)
    flies = sure.between(40.0, 60.0)
    assert np.all(extra[flies] > 0.05 * sure.speed[flies])
    assert np.all(extra[flies] < 0.25 * sure.speed[flies] + 0.1)
    assert extra[-1] > 0.3
    fixed = [tell(recording, learner__enabled=False, gnss__delay=0.01, gnss__delay_sd=sd) for sd in (0.2, 0.0)]
    np.testing.assert_array_equal(fixed[0].sigma, fixed[1].sigma)
