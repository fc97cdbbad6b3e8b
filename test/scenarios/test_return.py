"""Complaints 5 to 8: the return of GNSS after an outage."""

from dataclasses import replace

import numpy as np
import pytest

from nav_pose_estimator.engine.samples import GnssFix, ImuSample, SatelliteCount
from nav_pose_estimator.engine.solutions import Level, Mode
from nav_pose_estimator.sim.faults import Creep, SetCount, Shift
from nav_pose_estimator.sim.scenarios import generate
from told import flight, silence, tell

pytestmark = pytest.mark.compiled


@pytest.mark.parametrize("seed", [0, 1, 4])
def test_pain_05_a_return_300_m_off_is_not_believed_and_the_truth_is(seed: int) -> None:
    """GIVEN 60 s without GNSS WHEN it returns 300 m off for 20 s, then true
    THEN the offset is never taken, and the truth within 2 s."""
    told = tell(generate("return_offset_300m", 230.0, seed, imu_rate=100.0))
    assert told.modes_between(184.0, 200.0) == {Mode.REACQUIRING}
    assert told.off[told.between(184.0, 200.0)].max() < 200.0  # its own drift
    assert told.count("gnss.waiting") > 50
    assert min(told.when("gnss.reacquired")) < 202.0
    assert told.off[told.between(205.0, 230.0)].max() < 5.0


def test_pain_06_a_dense_cluster_of_outliers_at_the_end_of_a_blackout_does_not_capture_the_filter() -> None:
    """GIVEN 460 s without GNSS WHEN fixes 700 m off come for 8 s, then the truth THEN the truth wins as soon."""
    recording = flight("multirotor_light", 620.0)
    cluster = Shift(GnssFix, 560.0, 8.0, (500.0, -490.0, 0.0))
    told = tell(recording, cluster, *silence(100.0, 460.0))
    assert told.off[told.between(580.0, 620.0)].max() < 5.0
    assert told.modes_between(580.0, 620.0) == {Mode.AIDED}


def test_pain_06_outliers_among_true_fixes_are_left_out() -> None:
    """GIVEN 30 s without GNSS WHEN every third fix lies in a cluster 200 m off THEN the two others are followed."""
    recording = flight()
    fixes = [i for i, timed in enumerate(recording.others) if isinstance(timed.sample, GnssFix)]
    others = list(recording.others)
    moved = recording.with_faults(Shift(GnssFix, 90.0, 30.0, (200.0, 0.0, 0.0))).others
    for i in fixes[::3]:
        others[i] = moved[i]
    told = tell(replace(recording, others=others), *silence(60.0, 30.0))
    assert told.off[told.between(93.0, 120.0)].max() < 5.0
    assert told.count("gnss.rejected.innovation") > 30


@pytest.mark.parametrize("policy", ["blend", "reset"])
def test_pain_07_the_jump_goes_into_the_map_and_odom_stays_continuous(policy: str) -> None:
    """GIVEN 60 s without GNSS WHEN it returns THEN base_link in odom moves no faster than the vehicle,
    and the reset is counted and measured."""
    told = tell(flight(), *silence(40.0, 60.0), gnss__reacquisition__policy=policy)
    odom = told.position - told.correction
    steps, dt = np.linalg.norm(np.diff(odom, axis=0), axis=1), np.diff(told.t)
    assert np.all(steps <= np.maximum(told.speed[1:], told.speed[:-1]) * dt + 0.01), steps.max()
    jump = np.linalg.norm(np.diff(told.position, axis=0), axis=1).max()
    assert jump > 10.0 * steps.max()  # the map did jump
    values, back = told.estimator.status().values, told.event("gnss.re")
    assert back.data["offset_m"] == pytest.approx(jump, rel=0.2)
    is_reset = back.name.startswith("gnss.reset")
    assert is_reset or policy == "blend"
    assert values["gnss.resets"] == told.resets[-1] == is_reset
    if is_reset:
        assert values["gnss.last_reset_m"] == pytest.approx(back.data["offset_m"], rel=0.01)


def test_pain_08_a_permanent_step_of_50_m_locks_nothing_out() -> None:
    """GIVEN an aided navigator WHEN all fixes step by 50 m for good THEN they are taken within the configured time."""
    told = tell(flight(), Shift(GnssFix, 60.0, 60.0, (50.0, 0.0, 0.0)))
    taken = min(told.when("gnss.reset", after=60.0))
    longest = told.estimator.parameters.gnss.reacquisition.implausible_time
    assert 60.0 + 5.0 < taken < 60.0 + longest + 1.0
    assert told.event("gnss.reset").level is Level.ERROR
    assert np.abs(told.off[told.between(taken + 2.0, 120.0)] - 50.0).max() < 5.0
    assert told.modes[-1] is Mode.AIDED


def test_a_slow_spoofed_drift_is_told_and_the_truth_is_taken_when_it_comes() -> None:
    """GIVEN an aided navigator WHEN positions drift at 1 m/s against their velocities, then jump back
    THEN the drift is told while it lasts, sigma covers it, and the truth is followed within the configured time."""
    told = tell(flight(), Creep(start=40.0, length=40.0))
    begin = min(told.when("gnss.drift"))
    assert 40.0 < begin < 75.0
    dragged = told.between(begin + 4.0, 80.0)
    assert np.all(told.off[dragged] < 3.0 * told.sigma[dragged])
    assert told.sigma[told.between(79.0, 80.0)].min() > 10.0
    assert told.off[-100:].max() < 5.0
    assert told.modes[-1] is Mode.AIDED


def test_counts_that_flap_do_not_flap_the_navigator() -> None:
    """GIVEN an aided navigator WHEN the count jumps between 3 and 9 with every fix for 30 s
    THEN GNSS is left alone for that time and used again after it, with few changes of mode."""
    others = [
        timed._replace(sample=replace(timed.sample, count=(3, 9)[i % 2]))
        if isinstance(timed.sample, SatelliteCount) and 60.0 < (timed.arrival_ns - flight().start_ns) * 1e-9 < 90.0
        else timed
        for i, timed in enumerate(flight().others)
    ]
    told = tell(replace(flight(), others=others))
    assert Mode.AIDED not in told.modes_between(62.0, 90.0)
    assert told.modes_between(95.0, 120.0) == {Mode.AIDED}
    assert len(told.when("mode.", after=60.0)) <= 4
    assert told.off[told.between(95.0, 120.0)].max() < 5.0


def test_counts_between_the_thresholds_keep_the_gate_as_it_is() -> None:
    told = tell(flight(), SetCount(start=60.0, length=30.0, count=5))
    assert told.modes_between(60.0, 120.0) == {Mode.AIDED}


@pytest.mark.parametrize("seed", [5, 6])
def test_an_attitude_that_is_broken_is_found_again(seed: int) -> None:
    """GIVEN a good navigator WHEN the IMU reports 20 rad/s for a tenth of a second
    THEN GNSS shows that the attitude is gone, the navigator aligns again, and is good within half a minute."""
    spike = Shift(ImuSample, 60.0, 0.1, (20.0, -15.0, 10.0, 60.0, -80.0, 50.0))
    told = tell(flight(seed=seed), spike)
    assert len(told.when("reset")) == 1
    assert "velocities differ" in told.event("reset").text
    assert told.modes[-1] is Mode.AIDED
    assert told.off[told.between(100.0, 120.0)].max() < 10.0
