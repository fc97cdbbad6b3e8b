"""A navigator that GNSS keeps contradicting is not to be believed as usual: its sigma grows, and it comes back."""

import math

import numpy as np
import pytest

from nav_pose_estimator.core.gnss.doubt import Doubt
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.samples import ImuSample
from nav_pose_estimator.engine.sensors.gnss.velocity_report import DoubtReport
from nav_pose_estimator.engine.solutions import Mode
from nav_pose_estimator.ros.wording import level_of, sentence
from nav_pose_estimator.sim.faults import Shift
from told import flight, tell

pytestmark = pytest.mark.compiled
NORTH, SOUTH = (0.0, 5.0), (0.0, -5.0)


def test_an_honest_flight_is_never_in_doubt() -> None:
    """GIVEN a flight without a fault THEN there is no doubt."""
    assert tell(flight()).count("doubt") == 0


def test_a_filter_that_refuses_velocities_widens_and_comes_back() -> None:
    """GIVEN a flight WHEN the accelerometer is wrong by 4 m/s^2 for 6 s and velocities are refused
    THEN the doubt is told, the error stays within its sigma, and GNSS and navigator agree within 10 s of the fault."""
    told = tell(flight(), Shift(ImuSample, 60.0, 6.0, (0.0, 0.0, 0.0, 4.0, 2.0, 0.0)))
    begun = told.when("doubt.begun")
    assert begun
    assert 60.0 < begun[0] < 66.0
    assert told.when("doubt.ended")[-1] < 76.0
    assert np.mean(told.off < 3.0 * told.sigma) > 0.97
    assert told.modes_between(76.0, 120.0) == {Mode.AIDED}
    assert told.off[told.t > 80.0].max() < 3.0


def test_a_doubt_that_comes_back_is_no_news() -> None:
    """GIVEN doubts WHEN one follows less than a minute after the last THEN it is counted, and one event told of all;
    the cause is said where it is known."""
    journal = Journal()
    report = DoubtReport(journal)
    for begin in (10.0, 20.0, 75.0, 200.0):
        report.note(begin, 0, "", "it refuses velocities", "GNSS lags" if begin == 10.0 else "")
        report.note(begin + 1.0, 0, "it refuses velocities", "it refuses all velocities", "")
        report.note(begin + 5.0, 0, "it refuses all velocities", "", "")
    told = journal.drain()
    assert [event.name for event in told] == ["doubt.begun", "doubt.ended"] * 2
    assert [("likely cause: GNSS lags" in event.text) for event in told] == [True, False, False, False]
    assert journal.counters["doubt.begun"] == journal.counters["doubt.ended"] == 4


def test_the_status_says_why() -> None:
    """GIVEN an IMU that is off WHEN half of the velocities are refused THEN the status is a warning that names it."""
    told = tell(flight(duration=62.6), Shift(ImuSample, 60.0, 6.0, (0.0, 0.0, 0.0, 4.0, 2.0, 0.0)))
    status = told.estimator.status()
    assert "refuses" in status.doubt
    assert level_of(status) != 0
    assert "in doubt" in sentence(status)


def test_one_refused_velocity_is_the_receivers_fault() -> None:
    doubt = Doubt()
    for k in range(20):
        doubt.velocity(0.2 * k, 1.0 if k == 10 else 0.0, 20.0 if k == 10 else 1.0, NORTH)
        assert doubt.position(0.2 * k, 1.0, NORTH) == 1.0
    assert doubt.reason == ""


def test_half_of_them_are_the_filters_and_widen_once_a_second() -> None:
    doubt = Doubt()
    factors = []
    for k in range(20):
        doubt.velocity(0.2 * k, float(k % 2), 10.0, NORTH)
        factors.append(doubt.position(0.2 * k, 1.0, NORTH))
    assert [factor for factor in factors if factor != 1.0] == [9.0, 9.0, 9.0]
    assert "50 %" in doubt.reason


def test_positions_far_off_for_seconds_are_a_doubt() -> None:
    doubt = Doubt()
    factors = [doubt.position(0.5 * k, 6.0, NORTH) for k in range(6)]
    assert factors[:4] == [1.0] * 4
    assert math.isclose(factors[4], 9.0)
    assert doubt.position(3.0, 1.0, NORTH) == 1.0
    assert doubt.reason == ""


def test_errors_in_all_directions_are_the_receivers() -> None:
    """GIVEN a burst of noise WHEN positions and velocities are far off to all sides THEN the filter is not doubted."""
    doubt = Doubt()
    for k in range(100):
        way = (NORTH, (5.0, 0.0), SOUTH, (-5.0, 0.0))[k % 4]
        doubt.velocity(0.2 * k, 1.0, 30.0, way)
        assert doubt.position(0.2 * k, 8.0, way) == 1.0
    assert doubt.reason == ""
    assert not doubt.is_hopeless(20.0)


def test_an_error_that_turns_slowly_is_the_filters() -> None:
    """GIVEN a filter with a wrong heading on a circle WHEN the innovations turn with it THEN it is in doubt."""
    doubt = Doubt()
    for k in range(50):
        way = (math.cos(0.2 * k), math.sin(0.2 * k))
        doubt.velocity(0.2 * k, 1.0, 30.0, way)
        doubt.position(0.2 * k, 8.0, way)
    assert doubt.reason
    assert doubt.is_hopeless(10.0)


def test_three_slow_fixes_are_too_few_for_a_doubt() -> None:
    """GIVEN one fix a second WHEN three are off the same way THEN that may be chance; with five it is a doubt."""
    doubt = Doubt()
    assert [doubt.position(float(k), 6.0, NORTH) for k in range(4)] == [1.0] * 4
    assert doubt.position(4.0, 6.0, NORTH) > 1.0


def test_a_doubt_that_has_just_ended_is_still_named() -> None:
    """A filter that has been widened agrees with GNSS, whichever of them is right."""
    doubt = Doubt()
    for k in range(6):
        doubt.position(0.5 * k, 6.0, NORTH)
    doubt.position(3.0, 1.0, NORTH)
    assert doubt.lately(6.5) == "until 4 s ago GNSS positions have been 6 sigma off for 2 s"
    assert doubt.lately(20.0) == ""
