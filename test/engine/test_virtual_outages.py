"""No regret: what the rehearsals see decides whether the priors are used."""

import numpy as np
import pytest

from nav_pose_estimator.engine.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.samples import GnssFix
from nav_pose_estimator.engine.virtual_outages import VirtualOutages
from nav_pose_estimator.sim.recording import Recording
from nav_pose_estimator.sim.scenarios import generate


@pytest.fixture(scope="module")
def flight() -> Recording:
    return generate("multirotor_calm", duration=80.0, seed=2, imu_rate=100.0)


def test_rehearsals_finish_in_flight(flight: Recording) -> None:
    engine = PoseEstimator()
    for sample in flight.samples():
        engine.feed(sample)
    assert engine.rehearsals.rehearsals >= 1
    assert np.isfinite(engine.rehearsals._squares).all()


@pytest.mark.parametrize(
    ("coasting", "helped", "use"),
    [([], [], True), ([9.0, 4.0], [400.0, 100.0], False), ([900.0], [100.0], True), ([10.0], [10.0], True)],
)
def test_only_clearly_better_coasting_keeps_the_priors_out(coasting: list, helped: list, use: bool) -> None:
    rehearsals = VirtualOutages()
    rehearsals._squares.extend(zip(coasting, helped, strict=True))
    assert rehearsals.priors_help is use


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
