"""GNSS whose height says nothing, while its latitude and longitude are right."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from nav_pose_estimator.engine.samples import GnssFix, GnssVelocity, Sample
from nav_pose_estimator.sim.faults import Creep, Shift
from told import flight, tell

pytestmark = pytest.mark.compiled
END = 60.0  # s


def with_height(after: float, height: float | None) -> Iterator[Sample]:
    """The flight with this ``height`` [m] from ``after`` [s] on; None: that of the last fix before."""
    recording, held = flight("multirotor_outage", END), height
    for sample in recording.samples():
        if not isinstance(sample, GnssFix):
            yield sample
        elif (sample.stamp_ns - recording.start_ns) * 1e-9 < after:
            held = sample.alt if height is None else height
            yield sample
        else:
            yield replace(sample, alt=held)


@pytest.mark.parametrize(
    ("after", "height", "words"),
    [(0.0, 0.0, "exactly zero"), (15.0, None, "repeats to the last digit")],
    ids=["never filled", "frozen"],
)
def test_a_height_that_says_nothing_is_not_used(after: float, height: float | None, words: str) -> None:
    """GIVEN heights that are never filled, or freeze before a climb THEN the barometer's is used, within three sigma,
    the sentence names the cause, and latitude and longitude go on."""
    told = tell(flight("multirotor_outage", END), samples=with_height(after, height))
    assert words in told.event("gnss.height.stuck").text
    assert (np.abs(told.error[:, 2]) < 3.0 * np.sqrt(told.variances[:, 2]) + 1.0).all()
    assert told.off.max() < 3.0


def test_a_height_that_changes_again_is_used() -> None:
    """GIVEN heights that were zero WHEN the driver fills them THEN that is told, and they are used."""
    recording = flight("multirotor_outage", END)
    late = (
        replace(s, alt=0.0) if isinstance(s, GnssFix) and (s.stamp_ns - recording.start_ns) * 1e-9 < 8.0 else s
        for s in recording.samples()
    )
    told = tell(recording, samples=late)
    assert told.when("gnss.height.stuck.ended") == pytest.approx([8.0], abs=0.5)
    assert np.abs(told.error[told.t > 50.0, 2]).max() < 4.0


def test_a_height_that_is_dragged_away_from_the_barometers_is_in_doubt() -> None:
    """GIVEN a vehicle on the road WHEN fixes and their velocities rise by 1.5 m/s THEN the status says that barometer
    and GNSS have come apart, for nobody knows which is right."""
    dragged = (
        Creep(start=15.0, step=(0.0, 0.0, 0.3)),
        Shift(GnssVelocity, start=15.0, offset=(0.0, 0.0, 1.5)),
    )
    recording = flight("road_vehicle", END)
    assert "one of them is wrong" in tell(recording, *dragged).estimator.status().doubt
    assert not tell(recording).estimator.status().doubt
