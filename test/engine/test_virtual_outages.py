"""No regret: what the rehearsals see decides whether the priors are used."""

import numpy as np
import pytest

from nav_pose_estimator.engine.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.samples import GnssFix
from nav_pose_estimator.sim.recording import Recording
from nav_pose_estimator.sim.scenarios import generate


@pytest.fixture(scope="module")
def flight() -> Recording:
    return generate("multirotor_calm", duration=80.0, seed=2, imu_rate=100.0)


def test_a_good_imu_shows_that_the_priors_do_not_help(flight: Recording) -> None:
    """GIVEN an IMU that coasts within metres and a vehicle that travels WHEN rehearsed THEN the priors stay out."""
    engine = PoseEstimator()
    for sample in flight.samples():
        engine.feed(sample)
    assert engine.rehearsals.rehearsals >= 1
    assert not engine.rehearsals.priors_help


def test_without_a_rehearsal_the_priors_are_used() -> None:
    assert PoseEstimator().rehearsals.priors_help


def test_a_rehearsal_sees_no_fix(flight: Recording) -> None:
    """GIVEN a running rehearsal WHEN a fix far away is offered to it THEN its copies do not move."""
    engine = PoseEstimator()
    for sample in flight.samples():
        engine.feed(sample)
        if engine.rehearsals._helped is not None and engine.rehearsals._latest is not None:
            break
    copies = engine.rehearsals._coasting, engine.rehearsals._helped
    before = [copy.nominal_state() for copy in copies]
    stamp = int(engine.rehearsals._latest.stamps_ns[-1])
    engine.rehearsals.feed(GnssFix(stamp, 0.1, 0.1, 0.0, 0))
    for copy, state in zip(copies, before, strict=True):
        np.testing.assert_array_equal(copy.nominal_state(), state)
        assert copy.status().counters.get("gnss.used.position", 0) <= engine.status().counters["gnss.used.position"]
