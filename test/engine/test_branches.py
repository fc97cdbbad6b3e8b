"""Branches of the filter in an outage, on a time line of their own: who wins, what it is worth, and when things act."""

import copy
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest

from branched import (
    ALT,
    LAT,
    LON,
    NORTH,
    PERIOD,
    POSITION,
    RATE,
    VELOCITY,
    east,
    evidence,
    fly,
    imu_rows,
    observation,
    started,
)
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.filter import memory as filter_memory
from nav_pose_estimator.core.filter.blocks import GYRO_MATRIX
from nav_pose_estimator.engine.navigator.branches import Branches
from nav_pose_estimator.engine.navigator.split_filter import MOTION
from nav_pose_estimator.engine.navigator.timeline import Timeline
from nav_pose_estimator.engine.samples import MotionEvidence


def test_a_hovering_vehicle_is_found_to_hover_and_stays_where_it_is() -> None:
    """GIVEN a vehicle at rest whose accelerometer is 0.03 m/s^2 off WHEN 40 s go by without GNSS and nothing stirs
    THEN the hover branch wins (what may have changed since keeps some weight), and the drift stays below that of the
    IMU alone (24 m) and within three sigma."""
    timeline = started()
    weights = fly(timeline, imu_rows(40.0, error=0.03), lambda t: {"activity": -1.0})
    assert weights[-1, 1] < 0.1
    drift, sd = abs(east(timeline)), float(np.sqrt(timeline.filter.P[at.DPOS, at.DPOS]))
    assert drift < 8.0
    assert drift < 3.0 * sd < 100.0


def test_a_travelling_vehicle_is_not_stopped_by_the_hover_hypothesis() -> None:
    """GIVEN 8 m/s and a network that says so WHEN 40 s go by THEN the travel branch wins and the track is kept."""
    timeline = started(speed=8.0)
    weights = fly(timeline, imu_rows(40.0, error=0.03), lambda t: {"air": 8.0, "activity": 1.0})
    assert weights[-1, 1] > 0.95
    error, sd = abs(east(timeline) - 320.0), float(np.sqrt(timeline.filter.P[at.DPOS, at.DPOS]))
    assert error < 20.0
    assert error < 3.0 * sd


def test_a_stop_in_the_outage_is_followed() -> None:
    """GIVEN a vehicle that travels WHEN it stops at 15 s, goes on at 40 s THEN the weight changes sides, and back."""

    def speed(t: float) -> float:
        return 6.0 if t < 15.0 or t > 40.0 else 0.0

    def acceleration(t: float) -> float:
        return -6.0 if 15.0 <= t < 16.0 else 6.0 if 40.0 <= t < 41.0 else 0.0

    def told(t: float) -> dict:
        return {"air": speed(t), "activity": 1.0 if speed(t) else -1.0}

    weights = fly(started(speed=6.0), imu_rows(60.0, acceleration), told)
    t, travel = weights.T
    assert travel[t < 14.0][-1] > 0.95
    assert travel[(t > 30.0) & (t < 39.0)].max() < 0.2
    assert travel[-1] > 0.95


@pytest.mark.parametrize(("acceleration", "goes"), [(0.0, False), (0.25, False), (2.0, True)])
def test_a_velocity_that_no_hover_explains_counts_at_once(acceleration: float, goes: bool) -> None:
    """GIVEN a vehicle that has hovered for 20 s WHEN it accelerates for 2 s, calmly or not at all THEN a second later
    the filter is sure that it travels at 4 m/s, and stays sure of the hover at up to 0.5 m/s."""
    rows = imu_rows(24.0, lambda t: acceleration if 20.0 <= t < 22.0 else 0.0)
    t, travel = fly(started(), rows, lambda t: {"activity": -1.0 if t < 20.0 else 0.5}).T
    assert travel[t < 20.0][-1] < 0.1
    after = travel[t > 22.9]
    assert (after > 0.95).all() if goes else (after < 0.2).all()


def test_the_mixture_is_as_uncertain_as_the_decision() -> None:
    """GIVEN evidence for neither WHEN both branches drift apart THEN each of them lies within the mixture's sigma."""
    timeline = started(speed=2.0)
    fly(timeline, imu_rows(6.0))
    branches = timeline.filter.branches
    assert branches is not None
    sd = np.sqrt(timeline.filter.P[at.DVEL, at.DVEL])
    velocities = np.array([view.nav[at.VEL] for view in branches.views])
    spread = np.sqrt(branches.weights @ np.square(velocities - branches.weights @ velocities))
    assert sd >= spread
    assert sd**2 == pytest.approx(
        spread**2 + branches.weights @ [view.P[at.DVEL, at.DVEL] for view in branches.views], rel=1e-3
    )


def test_a_number_that_is_none_does_not_spoil_the_weights() -> None:
    """GIVEN branches WHEN a prediction is not finite THEN weights stay a distribution and the state finite."""
    timeline = started()
    fly(timeline, imu_rows(2.0))
    before = timeline.filter.branches.weights.copy()
    timeline.observe(observation(timeline.filter.time, MOTION, evidence(timeline, air=float("nan"))))
    timeline.settle()
    np.testing.assert_allclose(timeline.filter.branches.weights, before, atol=0.05)
    assert np.isfinite(timeline.filter.nav).all()
    assert np.isfinite(timeline.filter.P).all()


def test_hovering_does_not_begin_at_seven_metres_per_second() -> None:
    """GIVEN 7 m/s without a network, and motion as calm as in a hover WHEN 10 s go by THEN the vehicle still travels:
    nothing has slowed it down."""
    timeline = started(speed=7.0)
    weights = fly(timeline, imu_rows(10.0), lambda t: {"activity": -1.0, "likely": 0.98})
    assert weights[-1, 1] > 0.8
    assert east(timeline) > 55.0


def test_a_filter_that_is_better_than_it_states_splits_with_less_doubt() -> None:
    """GIVEN evidence that the drift has a tenth of the stated variance WHEN the filter splits THEN attitude and
    velocity are known better, the place as well as before; the bias noise it learned in flight is what it was."""
    sds = {}
    for part in (1.0, 0.1):
        timeline = started()
        timeline.filter.nav[at.GYRO_WANDER] = 1e-9
        before = timeline.filter.P.copy()
        one = replace(evidence(timeline), drift_variance=part)
        branches = Branches(timeline.filter.vector, 4, one)
        sds[part] = branches.views[0].P.diagonal()[:9].copy()
        branches.mix_into(timeline.filter.vector)
        assert timeline.filter.nav[at.GYRO_WANDER] == pytest.approx(1e-9)
        np.testing.assert_allclose(timeline.filter.P[at.DPOS, at.DPOS], before[at.DPOS, at.DPOS])
    np.testing.assert_allclose(sds[0.1][:6], 0.1 * sds[1.0][:6])
    np.testing.assert_allclose(sds[0.1][6:9], sds[1.0][6:9])


def test_a_single_hypothesis_needs_no_decision() -> None:
    timeline = started(speed=1.0)
    timeline.advance(imu_rows(1.0))
    only = evidence(timeline).hypotheses[1:]
    said = evidence(timeline)
    alone = MotionEvidence(
        said.stamp_ns, PERIOD, said.attitude, said.velocity, said.body_velocity, None, only, 20.0, wind_tau=40.0
    )
    timeline.observe(observation(timeline.filter.time, MOTION, alone))
    before = float(timeline.filter.nav[at.VEL])
    timeline.settle()
    assert 0.0 < timeline.filter.nav[at.VEL] < before
    assert len(timeline.filter.branches.memories) == 1


@pytest.mark.parametrize("size", [at.BASE_STATES, at.BASE_STATES + GYRO_MATRIX.size])
def test_the_mixture_has_the_size_of_the_filter(size: int) -> None:
    """GIVEN a filter with or without gyro matrix WHEN it splits THEN only the branches carry the wind."""
    timeline = started(size=size)
    fly(timeline, imu_rows(1.0))
    assert [view.P.shape for view in timeline.filter.branches.views] == [(size + 2, size + 2)] * 2
    assert timeline.filter.P.shape == (size, size)
    assert np.linalg.eigvalsh(timeline.filter.P).min() > 0.0


# --- order and time of arrival ---------------------------------------------------------------------------------------


def told_late(delays: Iterable[float], observations: list[tuple], block: int = 5, sampling: str = "mean") -> Timeline:
    """7 s with branches from 0.5 s on; each observation arrives its delay after its time."""
    timeline, rows = started(speed=2.0, sampling=sampling), imu_rows(7.0)
    waiting = sorted(zip(delays, observations, strict=True), key=lambda w: w[0] + w[1][0])
    for chunk in np.split(rows, range(block, len(rows), block)):
        while waiting and waiting[0][0] + waiting[0][1][0] <= timeline.filter.time + 1e-9:
            assert timeline.observe(observation(*waiting.pop(0)[1]))
        timeline.advance(chunk)
        half = round(timeline.filter.time / PERIOD, 6)
        if half == int(half) and timeline.filter.time < 4.7:
            # the same evidence whatever has arrived by then: what is compared is the time line
            timeline.observe(observation(timeline.filter.time, MOTION, evidence(started(speed=2.0), air=2.0)))
    timeline.settle()
    return timeline


def assert_equal(one: Timeline, other: Timeline, exact: bool = False) -> None:
    tolerance = {"rtol": 0.0, "atol": 0.0} if exact else {"rtol": 1e-9, "atol": 1e-12}
    np.testing.assert_allclose(one.filter.nav, other.filter.nav, **tolerance)
    np.testing.assert_allclose(one.filter.P, other.filter.P, **tolerance)
    assert (one.filter.branches is None) == (other.filter.branches is None)
    if one.filter.branches is not None and other.filter.branches is not None:
        np.testing.assert_allclose(one.filter.branches.weights, other.filter.branches.weights, **tolerance)


@pytest.mark.parametrize("sampling", ["mean", "point"])
@pytest.mark.parametrize("delay", [0.1, 0.32, 0.9])
def test_a_late_aid_on_branches_equals_a_punctual_one(sampling: str, delay: float) -> None:
    """GIVEN branches WHEN velocities North come late, decisions in between THEN nothing differs, weights included."""
    aids = [(t, NORTH, (0.3,)) for t in (1.03, 1.57, 2.5, 3.11)]
    punctual = told_late([0.0] * 4, aids, sampling=sampling)
    assert_equal(told_late([delay] * 4, aids, sampling=sampling), punctual)
    without = told_late([], [], sampling=sampling)
    assert abs(punctual.filter.nav[at.VEL + 1] - without.filter.nav[at.VEL + 1]) > 1e-3


@pytest.mark.parametrize("delay", [0.1, 0.32, 0.9])
def test_late_gnss_unites_the_branches_as_punctual_gnss_does(delay: float) -> None:
    """GIVEN branches WHEN position and velocity return late THEN one filter goes on, the same as with punctual ones."""
    back = [(t, kind, what) for t in (4.83, 5.03) for kind, what in
            ((POSITION, (LAT, LON + 1e-6, ALT)), (VELOCITY, (2.0, 0.5, 0.0)))]  # fmt: skip
    punctual = told_late([0.0] * 4, back)
    assert punctual.filter.branches is None
    assert punctual.filter.P.shape == (15, 15)
    assert_equal(told_late([delay] * 4, back), punctual)


@pytest.mark.parametrize("late", [0.04, 0.13, 0.19])
def test_what_acted_at_the_time_of_the_union_is_not_lost_in_a_replay(late: float) -> None:
    """GIVEN position and velocity of one time that united the branches WHEN something late, from just after them, makes
    the filter go back THEN the velocity still counts."""
    back = [(5.0, POSITION, (LAT, LON + 1e-6, ALT)), (5.0, VELOCITY, (2.0, 0.9, 0.0))]
    after = (5.0 + late, NORTH, (0.3,))
    assert_equal(told_late([0.1, 0.1, 0.5], [*back, after]), told_late([0.0, 0.0, 0.0], [*back, after]))


@pytest.mark.parametrize("late", [0.04, 0.13, 0.19])
def test_the_first_decision_is_not_lost_in_a_replay(late: float) -> None:
    """GIVEN evidence that was known before its time and split the filter WHEN something late, from just after that,
    makes the filter go back THEN the first decision still counts."""

    def run(delay: float) -> Timeline:
        timeline, rows = started(speed=2.0), imu_rows(2.0)
        timeline.observe(observation(0.5, MOTION, evidence(timeline, air=1.0, likely=0.9)))
        aid = (0.5 + late, NORTH, (0.3,))
        if delay == 0.0:
            assert timeline.observe(observation(*aid))
        arrival = round((0.5 + late + delay) * RATE)
        timeline.advance(rows[:arrival])
        if delay:
            assert timeline.observe(observation(*aid))
        timeline.advance(rows[arrival:])
        timeline.settle()
        return timeline

    assert_equal(run(0.3), run(0.0))


def test_evidence_from_before_the_return_was_known_does_not_split_again() -> None:
    """GIVEN evidence that was made of a drifting solution WHEN a fix valid before it arrives after it
    THEN the filter goes on whole, as with that fix alone."""
    rows = imu_rows(3.0)
    timeline, plain = started(speed=2.0), started(speed=2.0)
    fly(timeline, rows[:100], lambda t: {"air": 9.0})
    assert timeline.observe(observation(1.9, POSITION, (LAT, LON + 1e-6, ALT)))
    timeline.advance(rows[100:])
    assert timeline.filter.branches is None
    fly(plain, rows[:75], lambda t: {"air": 9.0})  # the last decision before the fix
    assert plain.observe(observation(1.9, POSITION, (LAT, LON + 1e-6, ALT)))
    plain.advance(rows[75:])
    # the evidence that is skipped still ends a step of the covariance: sums and P differ by a split step
    np.testing.assert_allclose(
        timeline.filter.nav[: at.SUM_TIME], plain.filter.nav[: at.SUM_TIME], rtol=1e-9, atol=1e-12
    )
    np.testing.assert_allclose(np.diag(timeline.filter.P), np.diag(plain.filter.P), rtol=1e-2)
    assert timeline.filter.branches is None
    assert plain.filter.branches is None


def test_what_lies_before_the_split_is_refused() -> None:
    """GIVEN a filter that has split WHEN an observation from before comes THEN it is refused and changes nothing."""
    timeline, rows = started(speed=2.0), imu_rows(2.0)
    fly(timeline, rows[:30])
    timeline.advance(rows[30:])
    nav = timeline.filter.nav.copy()
    assert not timeline.observe(observation(0.3, NORTH, (5.0,)))
    timeline.settle()
    np.testing.assert_array_equal(timeline.filter.nav, nav)


@pytest.mark.parametrize("block", [1, 25])
def test_blocks_and_single_rows_are_equal_on_branches(block: int) -> None:
    aids = [(t, NORTH, (0.3,)) for t in (1.03, 1.57, 2.5)]
    # in steps of the filter, so that late and early arrive alike
    assert_equal(told_late([0.0] * 3, aids, block), told_late([0.0] * 3, aids, 5))


def test_the_past_is_known_across_a_split_for_blocks_and_single_rows() -> None:
    """GIVEN a split WHEN rows come one by one or in long blocks THEN all rows of the last second and a half are known,
    which a look back at a whole second needs."""

    def past(block: int) -> np.ndarray:
        timeline, parts = started(speed=2.0), np.split(imu_rows(0.66), [RATE // 2])
        for rows in parts:
            for chunk in np.split(rows, range(block, len(rows), block)):
                timeline.advance(chunk)
            if rows is parts[0]:
                timeline.observe(observation(timeline.filter.time, MOTION, evidence(timeline, air=2.0)))
        assert timeline.filter.branches is not None
        return timeline.rows_since(0.0)

    for block in (1, RATE):
        np.testing.assert_array_equal(past(block), imu_rows(0.66))


def test_a_refused_position_keeps_the_branches() -> None:
    """GIVEN branches WHEN a position acts that the filter does not take THEN the hypotheses go on."""
    timeline = started(speed=2.0)
    timeline._apply = lambda o, f: None  # what the gate does to a fix of 500 m
    rows = imu_rows(3.0)
    fly(timeline, rows[:50])
    timeline.observe(observation(1.2, POSITION, (LAT, LON, ALT)))
    timeline.advance(rows[50:])
    assert timeline.filter.branches is not None


def test_a_copy_of_a_branched_time_line_lives_its_own_life() -> None:
    """GIVEN branches WHEN a copy takes other evidence THEN the original goes on as if there were no copy."""
    timeline, alone = started(speed=2.0), started(speed=2.0)
    rows = imu_rows(5.0)
    for one in (timeline, alone):
        fly(one, rows[:100])
    twin = copy.deepcopy(timeline)
    fly(twin, rows[100:], lambda t: {"air": 8.0, "activity": 3.0})
    twin.observe(observation(twin.filter.time, POSITION, (LAT, LON, ALT)))
    twin.settle()
    assert twin.filter.branches is None
    for one in (timeline, alone):
        fly(one, rows[100:])
    assert_equal(timeline, alone, exact=True)
    assert abs(twin.filter.nav[at.VEL] - alone.filter.nav[at.VEL]) > 0.1


def test_the_memory_of_branches_stays_bounded() -> None:
    timeline = started()
    fly(timeline, imu_rows(60.0))
    branches = timeline.filter.branches
    assert branches is not None
    assert len(branches._decisions) < 25
    kept = [m[filter_memory.NEWEST] - m[filter_memory.OLDEST] for m in branches.memories]
    assert max(kept) < 35
    assert len(timeline.queue) < 8


def test_what_a_hypothesis_has_made_certain_is_no_evidence_for_it() -> None:
    """GIVEN a vehicle at a velocity that is hardly known WHEN only the hovering branch is certain that it stands, as
    its hypothesis says again and again THEN hovering is no more probable than if it were not."""
    timeline = started(accel_error=0.3)
    fly(timeline, imu_rows(20.0))
    weights = []
    for certain in (1.0, 0.1):
        branches = copy.deepcopy(timeline.filter.branches)
        branches.weights[:] = 0.5
        for (nav, P, _), part in zip(branches.views, (3.0, certain), strict=True):
            nav[at.VEL : at.VEL + 3] = 0.0
            P[at.DVEL : at.DPOS] *= part
            P[:, at.DVEL : at.DPOS] *= part
        branches.decide(evidence(timeline))
        weights.append(branches.probability("hover"))
    assert weights[1] == pytest.approx(weights[0], abs=1e-6)
