"""A magnetometer that is wrong: the heading it gave is found out by motion, and in an outage it steers nothing."""

import re
from functools import cache

import numpy as np
import pytest

from nav_pose_estimator.engine.samples import MagSample
from nav_pose_estimator.engine.solutions import Mode
from nav_pose_estimator.sim.faults import Shift
from told import Told, flight, silence, tell
from wrong_compass import MIRRORED, NONE_OF_THE_EARTH, turned, with_compass

pytestmark = pytest.mark.compiled
OUTAGE = silence(60.0, 20.0)
END = 79.9
IRON = (40e-6, 0.0, 0.0)  # T: about twice the horizontal field
BODY_FIELD = (15e-6, -16e-6, -43e-6)  # T: as strong and as steep as the Earth's
WRONG = {
    "turned by 90 deg": (turned(90.0), (0.0, 0.0, 0.0)),
    "turned by 180 deg": (turned(180.0), (0.0, 0.0, 0.0)),
    "turned the other way": (turned(-90.0), (0.0, 0.0, 0.0)),
    "axes swapped": (MIRRORED, (0.0, 0.0, 0.0)),
    "hard iron": (turned(0.0), IRON),
    "hard iron and turned": (turned(90.0), IRON),
    "field that turns with the vehicle": (NONE_OF_THE_EARTH, BODY_FIELD),
}


def base():
    return flight("multirotor_outage", 90.0)


@cache
def usual() -> Told:
    return tell(base(), *OUTAGE)


@cache
def without_compass() -> Told:
    """What the data allow where the magnetometer tells nothing: the heading waits for motion."""
    return tell(base(), *OUTAGE, aids__magnetometer=False)


@cache
def flown(name: str) -> Told:
    return tell(with_compass(base(), *WRONG[name]), *OUTAGE)


def off_at_end(told: Told) -> float:
    return float(told.off[told.between(END - 0.2, END)].mean())


def first_motion() -> float:
    """When the vehicle first accelerates along the ground, where alone a heading can show [s]."""
    truth = base().truth
    return float(truth.t[np.hypot(truth.v_n[:, 0], truth.v_n[:, 1]) > 1.0][0])


def magnetic_headings_in_outage(told: Told) -> int:
    return told.count("magnetic_heading.used") + told.count("magnetic_heading.inflated")


def test_a_good_compass_is_believed_and_steers():
    told = usual()
    assert told.when("mag.heading") == []
    assert magnetic_headings_in_outage(told) > 10


def test_a_pause_of_gnss_before_the_first_motion_does_not_end_the_trial():
    # GIVEN a turned compass and a start at rest, WHEN GNSS pauses for eight seconds before the first motion
    told = tell(with_compass(base(), *WRONG["turned by 90 deg"]), *silence(10.0, 8.0))
    # THEN the second alignment begins again, and motion shows the wrong heading as ever
    (found,) = told.when("mag.heading.wrong_start")
    assert found - first_motion() < 5.0


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_heading_is_found_within_seconds_of_motion(name):
    # GIVEN a compass that misleads the start, WHEN the vehicle begins to move along the ground
    told = flown(name)
    # THEN that is found within seconds, and told with the angle and the likely cause
    (found,) = told.when("mag.heading.wrong_start")
    assert found - first_motion() < 5.0
    event = told.event("mag.heading.wrong_start")
    angle = float(re.search(r"was wrong by (\d+) deg", event.text)[1])
    assert abs(event.data["error_deg"]) == pytest.approx(angle, abs=1.0)
    assert "likely cause" in event.text


@pytest.mark.parametrize("name", WRONG)
def test_after_a_wrong_start_the_outage_is_flown_as_well_as_without_a_compass(name):
    # GIVEN a compass that misled the start, WHEN GNSS is lost later
    told = flown(name)
    # THEN the magnetometer steers nothing, the pose is as good as with none, and as good as it says
    assert magnetic_headings_in_outage(told) == 0
    assert off_at_end(told) <= 1.2 * off_at_end(without_compass())
    inside = told.between(61.0, END)
    assert (told.off[inside] < 3.0 * told.sigma[inside]).all()


@pytest.mark.parametrize(
    ("name", "cause"),
    [
        ("turned by 180 deg", "mounted 180 deg off"),
        ("turned by 90 deg", "turned by about"),
        ("axes swapped", "swapped or inverted"),
        ("hard iron", "hard iron of about"),
        ("field that turns with the vehicle", "hard iron of about"),
    ],
)
def test_turns_show_the_cause(name, cause):
    told = flown(name)
    assert any(cause in event.text for event in told.events if event.name.startswith("mag.heading"))


def test_a_rejected_compass_stays_out_when_the_heading_is_corrected_later():
    # GIVEN a compass that motion has rejected
    magnetometer = flown("turned by 90 deg").estimator.sins.run.aids[MagSample]
    assert np.isnan(magnetometer.offset)
    # WHEN IMU and GNSS correct the navigator's heading once more, and the compass agrees with that
    magnetometer.compare_anew()
    magnetometer.begin_with(0.0)
    # THEN it still steers nothing
    assert np.isnan(magnetometer.offset)


def test_the_odometry_does_not_jump_when_the_heading_is_put_right():
    # GIVEN a compass turned by 180 deg, WHEN the navigator goes on from another state
    told = flown("turned by 180 deg")
    # THEN the map takes the jump and position less correction does not
    smooth = told.position - told.correction
    steps = np.linalg.norm(np.diff(smooth, axis=0), axis=1)
    (found,) = told.when("mag.heading.wrong_start")
    near = told.between(found - 0.5, found + 0.5)[1:]
    assert steps[near].max() < 0.5 < np.abs(np.diff(told.correction, axis=0)[near]).max()


def test_iron_that_appears_in_flight_steers_nothing():
    # GIVEN a good compass, WHEN iron appears beside it in flight
    told = tell(base(), Shift(MagSample, 32.0, 1000.0, IRON), *OUTAGE)
    # THEN it is told before GNSS is lost, and the outage is flown without it
    assert 32.0 < told.when("mag.heading.disagrees")[0] < 60.0
    assert magnetic_headings_in_outage(told) == 0
    assert off_at_end(told) <= 1.2 * off_at_end(usual())


def test_a_field_in_gauss_is_not_believed_and_its_unit_is_named():
    # GIVEN a driver that publishes gauss
    told = tell(with_compass(base(), 1e4 * np.eye(3)), *OUTAGE)
    # THEN the start waits for motion, and the sentence names the unit
    assert Mode.AIDED not in told.modes_between(0.0, first_motion())
    assert "gauss" in told.event("mag.unit").text
    assert off_at_end(told) <= 1.2 * off_at_end(without_compass())


def test_a_hard_iron_in_gauss_steers_nothing():
    # GIVEN a calibration in gauss where tesla belongs
    told = tell(base(), *OUTAGE, attitude__hard_iron=(0.12, -0.05, 0.08))
    # THEN no heading comes from it, and it is told why
    assert Mode.AIDED not in told.modes_between(0.0, first_motion())
    assert magnetic_headings_in_outage(told) == 0
    assert "attitude.hard_iron of 0.153 T" in told.event("mag.unit").text


@pytest.mark.parametrize("name", ["turned by 90 deg", "hard iron", "hard iron and turned"])
def test_the_calibration_gives_the_baseline(name):
    # GIVEN a wrong compass and the calibration that mends it
    matrix, iron = WRONG[name]
    yaw = 0.5 * np.pi if "turned" in name else 0.0
    told = tell(
        with_compass(base(), matrix, iron), *OUTAGE, attitude__hard_iron=iron, aids__magnetometer_rpy=(0.0, 0.0, yaw)
    )
    # THEN nothing is told, and the flight is that with a good compass
    assert told.when("mag.heading") == []
    assert off_at_end(told) == pytest.approx(off_at_end(usual()), rel=0.01)
