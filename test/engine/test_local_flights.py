"""What keeps a position in bounds in an outage, and what widens it: flights are local, and a decision may be wrong."""

from dataclasses import replace

import numpy as np
import pytest

from branched import RATE, east, evidence, imu_rows, observation, started
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.engine.navigator.split_filter import MOTION
from nav_pose_estimator.engine.navigator.timeline import Timeline
from nav_pose_estimator.engine.samples import Hypothesis, MotionEvidence


def only(timeline: Timeline, hypothesis: Hypothesis) -> MotionEvidence:
    """Evidence with a single hypothesis and no prediction."""
    return replace(evidence(timeline), hypotheses=(hypothesis,))


def drifted(hypothesis: Hypothesis, speed: float = 0.0, error: float = 0.3) -> Timeline:
    """A filter at ``speed`` whose accelerometer is ``error`` off, and which knows it to 0.3 m/s^2, after 30 s."""
    timeline = started(speed=speed, accel_error=0.3)
    for chunk in np.split(imu_rows(30.0, error=error), range(RATE // 2, 30 * RATE, RATE // 2)):
        timeline.advance(chunk)
        timeline.observe(observation(timeline.filter.time, MOTION, only(timeline, hypothesis)))
        timeline.settle()
    return timeline


NOTHING = Hypothesis("travel", 1.0, None, None)


def test_a_local_flight_bounds_the_drift() -> None:
    """GIVEN a drift of 135 m in 30 s WHEN the place is known to vary by 20 m, one draw in half a minute THEN the
    position comes back to a third, so does sigma, and the error lies within 3 sigma."""
    free, local = drifted(NOTHING), drifted(replace(NOTHING, place_var=400.0, place_time=30.0))
    assert abs(east(free)) > 100.0
    assert abs(east(local)) < 40.0
    sd, before = (float(np.sqrt(one.filter.P[at.DPOS, at.DPOS])) for one in (local, free))
    assert 8.0 < sd < before / 3.0
    assert abs(east(local)) < 3.0 * sd


def test_a_vehicle_that_clearly_left_is_not_pulled_back() -> None:
    """GIVEN 15 m/s, known well WHEN the flight so far was local THEN the vehicle is where it flies to."""
    place = replace(NOTHING, place_var=25.0, place_time=30.0)
    timeline = started(speed=15.0, accel_error=0.003)
    for chunk in np.split(imu_rows(30.0), range(RATE // 2, 30 * RATE, RATE // 2)):
        timeline.advance(chunk)
        timeline.observe(observation(timeline.filter.time, MOTION, only(timeline, place)))
        timeline.settle()
    error, sd = abs(east(timeline) - 450.0), float(np.sqrt(timeline.filter.P[at.DPOS, at.DPOS]))
    assert error < 15.0
    assert error < 3.0 * sd


def test_doubt_widens_the_position_and_nothing_else() -> None:
    """GIVEN a hypothesis with a doubt of 2 m^2/s WHEN 30 s go by THEN the variance of the position is 60 m^2 larger."""
    sure, doubtful = drifted(NOTHING, error=0.0), drifted(replace(NOTHING, doubt_psd=2.0), error=0.0)
    more = np.diag(doubtful.filter.P) - np.diag(sure.filter.P)
    np.testing.assert_allclose(more[at.DPOS : at.DPOS + 2], 60.0, rtol=0.05)
    np.testing.assert_allclose(more[at.DVEL : at.DVEL + 2], 0.0, atol=1e-6)
    assert east(doubtful) == pytest.approx(east(sure), abs=1e-6)


STAYS = replace(NOTHING, name="hover", lasting=replace(NOTHING, name="hover", place_var=1.0))


def test_a_hover_that_goes_on_keeps_its_place() -> None:
    """GIVEN a drift of 135 m in 30 s WHEN the vehicle has hovered ever since, within a metre THEN so does the position
    nearly."""
    assert abs(east(drifted(STAYS))) < 0.1 * abs(east(drifted(NOTHING)))


def test_a_hover_that_begins_later_may_be_anywhere() -> None:
    """GIVEN that hypothesis WHEN the vehicle is likely to travel at first THEN nothing pulls it back later."""
    free, late = drifted(NOTHING), started(accel_error=0.3)
    for number, chunk in enumerate(np.split(imu_rows(30.0, error=0.3), range(RATE // 2, 30 * RATE, RATE // 2))):
        told = replace(evidence(late), hypotheses=(replace(NOTHING, probability=0.9), replace(STAYS, probability=0.1)))
        if number > 4:
            told = replace(told, hypotheses=(told.hypotheses[0], replace(told.hypotheses[1], log_likelihood=50.0)))
        late.advance(chunk)
        late.observe(observation(late.filter.time, MOTION, told))
        late.settle()
    assert late.filter.branches.probability("hover") > 0.9
    assert east(late) == pytest.approx(east(free), rel=0.05)


def test_a_prediction_that_only_tells_hypotheses_apart_leaves_the_velocity_alone() -> None:
    """GIVEN a network that says 5 m/s at rest WHEN it may correct THEN the velocity follows it; else it does not."""
    speeds = []
    for corrects in (True, False):
        timeline = started()
        told = replace(NOTHING, air_noise=(0.1, 0.1, 0.1), air_corrects=corrects)
        for chunk in np.split(imu_rows(10.0), range(RATE // 2, 10 * RATE, RATE // 2)):
            timeline.advance(chunk)
            said = replace(evidence(timeline, air=5.0), hypotheses=(told,), wind_cov=np.zeros((2, 2)))
            timeline.observe(observation(timeline.filter.time, MOTION, said))
            timeline.settle()
        speeds.append(float(timeline.filter.nav[at.VEL]))
    assert speeds[0] > 0.5
    assert abs(speeds[1]) < 0.1
