"""The estimator through an outage with the learner on: causality, return, and the same bits however it is fed."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import groupby
from typing import Any

import numpy as np
import pytest

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.outage.aid import OutageAid
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import (
    GnssFix,
    GnssVelocity,
    ImuBlock,
    ImuSample,
    Sample,
    SatelliteCount,
    VelocityError,
)
from nav_pose_estimator.engine.solutions import Mode, NavBlock, NavSolution, PredictedDrift
from nav_pose_estimator.offline.replay.replay import as_block
from told import flight

pytestmark = pytest.mark.compiled
GNSS = (GnssFix, GnssVelocity, SatelliteCount)
LOST, BACK, END = 80.0, 105.0, 115.0  # s
PARAMETERS = update(Parameters(), {"learner.rules": 1})


def between(start: float, end: float, blocks: bool = True) -> list[Sample]:
    """What arrived in [start, end) seconds of the flight, the IMU one by one or in blocks."""
    recording = flight()
    first, last = (recording.start_ns + round(t * 1e9) for t in (start, end))
    timed = [t.sample for t in recording.arrivals() if first <= t.arrival_ns < last]
    return in_blocks(timed) if blocks else timed


def in_blocks(samples: Iterable[Sample]) -> list[Sample]:
    """Consecutive IMU samples together."""
    out: list[Sample] = []
    for is_imu, group in groupby(samples, lambda sample: isinstance(sample, ImuSample)):
        some = list(group)
        if is_imu:
            some = [
                ImuBlock(
                    np.array([s.stamp_ns for s in some]),
                    *(np.array([getattr(s, n) for s in some]) for n in ("gyro", "accel")),
                )
            ]
        out += some
    return out


def without_gnss(samples: Iterable[Sample]) -> Iterator[Sample]:
    return (sample for sample in samples if not isinstance(sample, GNSS))


@pytest.fixture(scope="module")
def at_loss() -> Any:
    """The estimator after 80 s of flight, with a model and a rehearsal behind it."""
    estimator = PoseEstimator(PARAMETERS, attitude=False)
    for sample in between(0.0, LOST):
        estimator.feed(sample)
    assert estimator.mode is Mode.AIDED
    assert estimator.outage_aid.learner.state.model is not None
    assert estimator.outage_aid.rehearsals.count == 1
    return estimator.snapshot()


def going_on(at_loss: Any) -> PoseEstimator:
    estimator = PoseEstimator(PARAMETERS, attitude=False)
    estimator.restore(at_loss)
    return estimator


class Flown:
    """Solutions, modes and velocity errors of a stretch of flight, and how it ended."""

    def __init__(self, estimator: PoseEstimator, samples: Iterable[Sample]) -> None:
        blocks, self.errors = [], []
        for sample in samples:
            for output in estimator.feed(sample):
                if isinstance(output, NavBlock | NavSolution):
                    blocks.append(output if isinstance(output, NavBlock) else as_block(output))
                elif isinstance(output, PredictedDrift):
                    self.errors.append(output)
        self.stamps = np.concatenate([b.stamps_ns for b in blocks])
        self.rows = np.concatenate([b.rows for b in blocks])
        self.modes = [b.mode for b in blocks for _ in b.stamps_ns]
        self.counters, self.state = estimator.status().counters, estimator.sins.run.settled.nav.copy()

    @property
    def off(self) -> np.ndarray:
        """Horizontal error (N,) [m]."""
        t = (self.stamps - flight().start_ns) * 1e-9
        return np.linalg.norm(flight().error_enu(t, self.rows[:, at.OUT_POS : at.OUT_VEL])[:, :2], axis=1)

    @property
    def sigma(self) -> np.ndarray:
        first = at.OUT_VAR + at.DPOS
        return np.sqrt(self.rows[:, first : first + 2].sum(axis=1))


def assert_same(one: Flown, other: Flown) -> None:
    np.testing.assert_array_equal(one.stamps, other.stamps)
    np.testing.assert_array_equal(one.rows, other.rows)
    np.testing.assert_array_equal(one.state, other.state)
    assert one.modes == other.modes
    assert [e.dv_n for e in one.errors] == [e.dv_n for e in other.errors]
    assert [e.dp_n for e in one.errors] == [e.dp_n for e in other.errors]


def outage_and_return(blocks: bool) -> list[Sample]:
    samples = [*without_gnss(between(LOST, BACK, False)), *between(BACK, END, False)]
    return in_blocks(samples) if blocks else samples


def test_blocks_and_single_samples_give_the_same_bits_through_an_outage(at_loss) -> None:
    """GIVEN an estimator that has learned WHEN GNSS goes and comes back, fed in blocks or one by one THEN every bit of
    solution, velocity error and final state is the same."""
    blocks = Flown(going_on(at_loss), outage_and_return(True))
    singles = Flown(going_on(at_loss), outage_and_return(False))
    assert blocks.counters["outage.evidence"] > 40
    assert len(blocks.errors) == blocks.counters["outage.evidence"]
    assert Mode.COASTING in blocks.modes
    assert blocks.modes[-1] is Mode.AIDED
    assert_same(blocks, singles)


def test_sigma_covers_the_error_and_the_return_unites_the_branches(at_loss) -> None:
    """GIVEN an outage of 25 s WHEN GNSS returns THEN the error stayed within three sigma all along, branches were there
    and are gone, and the position is good again."""
    estimator = going_on(at_loss)
    lost = Flown(estimator, without_gnss(between(LOST, BACK)))
    assert estimator.sins.run.timeline.filter.branches is not None
    assert np.mean(lost.off < 3.0 * lost.sigma) > 0.99
    assert 0.3 < lost.sigma[-1] < 50.0
    back = Flown(estimator, between(BACK, END))
    assert estimator.sins.run.timeline.filter.branches is None
    assert back.modes[-1] is Mode.AIDED
    assert back.off[-1] < 2.5
    assert np.isfinite(back.rows).all()


# --- causality -------------------------------------------------------------------------------------------------------


def elsewhere(sample: Sample) -> Sample:
    """The same fix a kilometre off, the same velocity with 9 m/s more."""
    if isinstance(sample, GnssFix):
        return replace(sample, lat=sample.lat + 1.6e-4)
    if isinstance(sample, GnssVelocity):
        return replace(sample, vel_enu=tuple(v + 9.0 for v in sample.vel_enu))
    return sample


@pytest.mark.parametrize("how", ["drill", "gate"])
def test_gnss_that_is_refused_changes_nothing(at_loss, how: str) -> None:
    """GIVEN GNSS that is switched off, or closed by a gate of 3 satellites WHEN fixes of another place come in the
    outage, or none THEN every bit is the same and the learner has seen the same."""

    def lost(fixes: bool) -> tuple[Flown, PoseEstimator]:
        estimator, samples = going_on(at_loss), []
        if how == "drill":
            estimator.set_use_gnss(False)
        else:
            samples = [SatelliteCount(flight().start_ns + round(LOST * 1e9), 3)]
        for sample in between(LOST, BACK):
            if isinstance(sample, SatelliteCount):
                samples.append(replace(sample, count=3))
            elif fixes or not isinstance(sample, GNSS):
                samples.append(elsewhere(sample))
        return Flown(estimator, samples), estimator

    (told, one), (untold, other) = lost(True), lost(False)
    assert told.counters.keys() != untold.counters.keys()  # the fixes did come, and were counted
    assert_same(told, untold)
    assert one.outage_aid.learner.state.memory.seconds == other.outage_aid.learner.state.memory.seconds
    np.testing.assert_array_equal(one.outage_aid.learner.state.model.wind, other.outage_aid.learner.state.model.wind)
    assert one.outage_aid.learner.state.model.network is other.outage_aid.learner.state.model.network


def test_nothing_is_learned_in_an_outage(at_loss) -> None:
    """GIVEN the loss of GNSS WHEN 25 s go by THEN memory and model are as at the loss, the guide that was made then
    is the one that is used, and a training that ends in the outage has to wait."""
    estimator = going_on(at_loss)
    aid = estimator.outage_aid
    Flown(estimator, without_gnss(between(LOST, LOST + 5.0)))
    learned, guide, rehearsals = aid.learner.state, aid.guide, aid.rehearsals
    seconds, model = learned.memory.seconds, learned.model
    assert guide is not None
    aid.accept(aid.learner.job().run())
    Flown(estimator, without_gnss(between(LOST + 5.0, BACK)))
    assert learned.memory.seconds == seconds
    assert learned.model is model
    assert aid.guide is guide
    assert rehearsals.count == 1
    assert rehearsals.running is None
    Flown(estimator, between(BACK, END))
    assert learned.memory.seconds > seconds
    assert aid.guide is None


def test_the_learning_stops_within_a_second_of_the_last_fix(at_loss) -> None:
    """GIVEN the last fix WHEN half-second epochs go on THEN what is remembered ends before GNSS counts as lost."""
    estimator = going_on(at_loss)
    before = estimator.outage_aid.learner.state.memory.seconds
    Flown(estimator, without_gnss(between(LOST, BACK)))
    lost_after = PARAMETERS.navigator.lost_after
    assert estimator.outage_aid.learner.state.memory.seconds - before <= lost_after + 0.5


def test_the_model_of_the_outage_is_that_of_the_past_only(at_loss) -> None:
    """GIVEN two futures of one flight WHEN GNSS is lost THEN evidence in the first seconds is the same."""
    early = Flown(going_on(at_loss), without_gnss(between(LOST, LOST + 8.0)))
    longer = Flown(going_on(at_loss), without_gnss(between(LOST, LOST + 12.0)))
    np.testing.assert_array_equal(early.rows, longer.rows[: len(early.rows)])
    assert [e.dv_n for e in early.errors] == [e.dv_n for e in longer.errors][: len(early.errors)]


# --- what comes out, and copies --------------------------------------------------------------------------------------


def test_the_position_error_is_the_sum_of_the_velocity_errors(at_loss) -> None:
    lost = Flown(going_on(at_loss), without_gnss(between(LOST, LOST + 15.0)))
    summed = 0.5 * np.cumsum([e.dv_n for e in lost.errors], axis=0)
    np.testing.assert_allclose([e.dp_n for e in lost.errors], summed, atol=1e-9)
    assert len(lost.errors) > 20


def test_a_snapshot_in_an_outage_is_independent(at_loss) -> None:
    """GIVEN a snapshot in the middle of an outage WHEN the original flies on, elsewhere THEN the copy is untouched."""
    estimator = going_on(at_loss)
    Flown(estimator, without_gnss(between(LOST, LOST + 6.0)))
    snapshot = estimator.snapshot()
    first = Flown(estimator, without_gnss(between(LOST + 6.0, LOST + 12.0)))
    Flown(estimator, map(elsewhere, between(LOST + 12.0, END)))
    again = Flown(going_on(snapshot), without_gnss(between(LOST + 6.0, LOST + 12.0)))
    assert_same(first, again)


def test_a_restored_estimator_still_has_its_trainings_done_elsewhere(at_loss) -> None:
    """GIVEN an aid whose trainings another process does WHEN it is copied THEN that process does the copy's as well."""
    jobs: list = []
    elsewhere = OutageAid(PARAMETERS.learner, jobs.append)
    for aid in (elsewhere, elsewhere.copy()):
        estimator = going_on(at_loss)
        learner = estimator.outage_aid.learner
        aid._pilot.learner = learner.copy()
        estimator.outage_aid = aid
        estimator.restore(estimator.snapshot())
        jobs.clear()
        Flown(estimator, between(LOST, END))
        assert len(jobs) >= 1


@pytest.mark.parametrize("bad", [float("nan"), 1e4])
def test_a_prediction_from_outside_that_is_no_number_is_not_used(at_loss, bad: float) -> None:
    """GIVEN an outage WHEN a network elsewhere says nonsense THEN nothing differs."""
    nonsense = VelocityError(flight().start_ns + round(LOST * 1e9), (bad, 0.0, 0.0), np.eye(3))
    told = Flown(going_on(at_loss), [nonsense, *without_gnss(between(LOST, LOST + 5.0))])
    assert_same(told, Flown(going_on(at_loss), without_gnss(between(LOST, LOST + 5.0))))


def test_coast_has_no_aid_at_all() -> None:
    for change in ({"learner.enabled": False}, {"learner.method": "coast"}):
        assert PoseEstimator(update(Parameters(), change), attitude=False).outage_aid is None
