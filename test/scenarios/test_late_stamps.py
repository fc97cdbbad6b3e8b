"""GNSS whose stamps are late, while nobody has set gnss.delay: the pose is where the vehicle was."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from nav_pose_estimator.engine.samples import GnssFix, GnssVelocity, Sample
from nav_pose_estimator.sim.recording import Recording
from told import Told, flight, tell

pytestmark = pytest.mark.compiled
SECONDS = 75.0


def stamped_late(recording: Recording, seconds: float) -> Iterator[Sample]:
    for sample in recording.samples():
        if isinstance(sample, GnssFix | GnssVelocity):
            yield replace(sample, stamp_ns=sample.stamp_ns + round(seconds * 1e9))
        else:
            yield sample


def fly(late: float, **settings: float) -> Told:
    recording = flight("stop_and_go", SECONDS)
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


@pytest.mark.parametrize("late", [0.0, 0.4])
def test_what_is_set_is_not_told(late: float) -> None:
    """GIVEN the right ``gnss.delay`` THEN nothing is said of it."""
    assert fly(late, gnss__delay=late).count("gnss.delayed") == 0
