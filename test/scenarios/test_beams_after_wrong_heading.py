"""Beams that were compared with a navigator whose heading was wrong are compared anew when that is found out."""

import pytest

from beam_flight import END, LOST, Flown
from beamed import with_beams
from nav_pose_estimator.engine.navigator.sins import SinsEngine
from nav_pose_estimator.engine.samples import BeamVelocitySample
from nav_pose_estimator.engine.sensors.magnetometer import WRONG_START
from nav_pose_estimator.sim.scenarios import generate
from told import silence
from wrong_compass import turned, with_compass

pytestmark = pytest.mark.compiled


def fly(degrees: float, own: bool = False) -> tuple[Flown, int]:
    """The flight, and the stamp at which the compass was found to be turned by ``degrees``."""
    recording = generate("laps", LOST + 11.0, seed=5, imu_rate=50.0)
    spoiled = with_compass(recording, turned(degrees)).with_faults(*silence(LOST, END - LOST))
    flown = Flown(recording, with_beams(spoiled, own=own), until=LOST + 10.0)
    return flown, next(event.stamp_ns for event in flown.events if event.name == WRONG_START)


def test_what_a_wrong_heading_has_made_of_beams_accuses_nobody() -> None:
    """GIVEN a compass turned by 180 deg WHEN the heading is corrected THEN messages from before do not refuse the
    geometry; it is verified with those after, and the beams bound the outage."""
    flown, corrected = fly(180.0)
    assert not flown.said("geometry.refused")
    (verified,) = [event for event in flown.events if event.name == "beam_velocity.geometry"]
    assert verified.stamp_ns > corrected
    assert flown.error < 5.0


@pytest.mark.parametrize("own", [False, True], ids=["by the navigator", "by the sensor's own velocity"])
def test_a_geometry_that_rests_on_a_wrong_heading_is_verified_anew(own: bool) -> None:
    """GIVEN a compass turned by 90 deg and a geometry verified meanwhile WHEN the heading is corrected THEN it is
    verified again, unless the sensor's own 3-D velocity has shown it, and the beams bound the outage."""
    flown, corrected = fly(90.0, own)
    verified = [event.stamp_ns for event in flown.events if event.name == "beam_velocity.geometry"]
    assert verified[0] < corrected
    assert len([stamp for stamp in verified if stamp > corrected]) == (0 if own else 1)
    assert flown.error < 5.0


def test_judge_and_agreement_forget() -> None:
    """GIVEN beams that are out and contradict the navigator WHEN its heading was wrong THEN neither is remembered."""
    sensor = SinsEngine().run.aids[BeamVelocitySample]
    sensor.judge.memory[:] = 1.0
    for _ in range(50):
        sensor._agreement.add(4, 4, True)
    assert sensor.judge.out.all()
    assert sensor._agreement.contradicts
    sensor.compare_anew()
    assert not sensor.judge.out.any()
    assert not sensor._agreement.contradicts
