"""Complaints 1 to 4: the gate by satellites, and what the navigator does without GNSS."""

from dataclasses import replace

import numpy as np
import pytest

from nav_pose_estimator.engine.samples import GnssFix, ImuSample, SatelliteCount
from nav_pose_estimator.engine.solutions import Level, Mode
from nav_pose_estimator.sim.faults import SetCount, Shift, Stop
from told import flight, silence, tell

pytestmark = pytest.mark.compiled


def test_pain_01_a_count_that_is_unknown_keeps_an_open_gate_open_and_says_so() -> None:
    """GIVEN an open gate WHEN the receiver says that it does not know the count (255) THEN GNSS goes on, loudly."""
    told = tell(flight(), SetCount(start=60.0, length=60.0, count=None))
    assert told.modes_between(60.0, 120.0) == {Mode.AIDED}
    assert told.event("gnss.count.unknown").level is Level.WARN
    assert told.event("gnss.gate.inactive").level is Level.ERROR


def test_pain_01_a_count_that_is_unknown_opens_no_closed_gate_silently() -> None:
    """GIVEN a gate closed by 3 satellites WHEN the count becomes unknown THEN it stays closed until that is told."""
    told = tell(flight(), SetCount(start=0.0, length=20.0, count=3), SetCount(start=20.0, length=100.0, count=None))
    inactive = min(told.when("gnss.gate.inactive"))
    assert 24.0 < inactive < 26.0
    assert told.t[0] >= inactive - 0.5  # no solution before
    assert told.count("gnss.rejected.satellites") > 50


def test_pain_01_a_count_that_goes_stale_is_neither_good_nor_bad() -> None:
    """GIVEN an open gate WHEN counts stop coming while fixes go on THEN stale is told, then that nobody counts."""
    told = tell(flight(), Stop(SatelliteCount, 60.0, 60.0))
    assert told.modes_between(60.0, 120.0) == {Mode.AIDED}
    assert told.event("gnss.count.stale").level is Level.WARN
    assert 64.0 < min(told.when("gnss.gate.inactive")) < 66.5


def test_pain_01_in_a_drill_or_an_outage_the_count_is_no_error() -> None:
    """GIVEN an open gate WHEN the whole receiver is silent for 30 s THEN nothing about counts is an error."""
    told = tell(flight(), *silence(60.0, 30.0))
    assert told.when("gnss.gate.inactive") == []
    assert [event.name for event in told.events if event.level is Level.ERROR] == []
    assert told.modes[-1] is Mode.AIDED


def test_pain_02_a_receiver_without_counts_is_told_within_5_s_and_used() -> None:
    """GIVEN a gate that wants 6 satellites WHEN only NavSatFix comes THEN an error says so within 5 s, and it flies."""
    told = tell(flight(), Stop(SatelliteCount))
    first_fix = min(t.arrival_ns for t in flight().others if isinstance(t.sample, GnssFix)) - flight().start_ns
    inactive = told.event("gnss.gate.inactive")
    assert inactive.level is Level.ERROR
    assert "no satellite count" in inactive.text
    assert min(told.when("gnss.gate.inactive")) < first_fix * 1e-9 + 5.5
    assert told.modes[-1] is Mode.AIDED


def test_pain_03_half_a_degree_per_second_of_bias_is_found() -> None:
    """GIVEN a standing vehicle WHEN its gyroscope has 0.5 deg/s of bias THEN it is found within 3 sigma,
    and the vehicle does not turn."""
    recording = flight("at_rest", 60.0)
    bias = np.radians([0.5, -0.5, 0.5])
    told = tell(recording, Shift(ImuSample, 0.0, 1e9, (*bias, 0.0, 0.0, 0.0)))
    assert told.last is not None
    sd = np.sqrt(np.diag(told.last.cov)[9:12])
    error = told.last.gyro_bias - (recording.imu_data.gyro_bias[-1] + bias)
    assert np.all(np.abs(error) < 3.0 * sd), (error, sd)
    assert np.all(sd < 0.2 * np.abs(bias))
    assert np.degrees(np.linalg.norm(told.last.rate_b)) < 0.5  # noise


def test_pain_04_coasting_is_honest() -> None:
    """GIVEN a flight WHEN GNSS is gone for 40 s and 30 are allowed
    THEN sigma grows and covers the error, the outlook is larger still, and the mode says when it has expired."""
    told = tell(flight(), *silence(60.0, 60.0), navigator__expire_after=30.0, learner__enabled=False)
    gone = told.between(62.0, 120.0)
    assert np.all(np.diff(told.sigma[gone][::500]) > 0.0)
    assert np.mean(told.off[gone] < 3.0 * told.sigma[gone]) > 0.99
    status = told.estimator.status()
    assert status.seconds_coasting == pytest.approx(60.0, abs=1.0)
    assert status.horizontal_sd_in_30_s > 1.5 * status.horizontal_sd > 20.0
    assert told.modes_between(63.0, 89.0) == {Mode.DEAD_RECKONING}
    assert told.modes_between(91.0, 120.0) == {Mode.EXPIRED}


def test_pain_04_what_bounds_the_drift_is_named() -> None:
    """GIVEN an outage WHEN the habits of the flight bound the drift THEN the mode is another than with nothing."""
    recording = replace(flight("hover"), scenario="hover")
    bounded, alone = (tell(recording, *silence(80.0, 40.0), learner__enabled=on) for on in (True, False))
    assert Mode.COASTING in bounded.modes_between(85.0, 120.0)
    assert alone.modes_between(85.0, 120.0) == {Mode.DEAD_RECKONING}
    assert bounded.sigma[-1] < alone.sigma[-1]
