"""The filters of a rehearsal: each way is what a copy of the whole navigator would be."""

from collections.abc import Iterator

import numpy as np
import pytest

from nav_pose_estimator.core.earth.ellipsoid import step_enu
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.filter.noise_identification import NoiseIdentification
from nav_pose_estimator.core.numerics.deep_copy import deep_copy
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.navigator import filter_setup
from nav_pose_estimator.engine.navigator.sins import SinsEngine
from nav_pose_estimator.engine.navigator.split_filter import SplitFilter
from nav_pose_estimator.engine.observation import GATED, Kind, Observation
from nav_pose_estimator.engine.outage.epochs import last_stamp
from nav_pose_estimator.engine.outage.filter_bank import COAST, ONE_WAY, FilterBank, OfOneWay, Way
from nav_pose_estimator.engine.outage.rehearsal import Epoch, Rehearsal
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import ImuBlock, MagSample, joined, known_stamp
from nav_pose_estimator.engine.solutions import NavBlock
from nav_pose_estimator.offline.benchmarks.speed.plain_flight import samples

AIDED_NS, HALF_NS, COUNT = 10**18 + 40 * 10**9, 500_000_000, 30


def split(flight: list, late: bool) -> tuple[list, list[Epoch]]:
    """The aided part of a flight, and half seconds after it with the magnetometer, punctual or one of them late."""
    imu = joined([sample for sample in flight if isinstance(sample, ImuBlock)])
    ends = imu.stamps_ns.searchsorted(AIDED_NS + HALF_NS * np.arange(COUNT + 1), side="right")
    before = [sample for sample in flight if not isinstance(sample, ImuBlock) and known_stamp(sample) <= AIDED_NS]
    epochs = []
    for k in range(COUNT):
        begin = AIDED_NS + HALF_NS * (k - late)
        mags = [s for s in flight if isinstance(s, MagSample) and begin < s.stamp_ns <= begin + HALF_NS]
        epochs.append(Epoch.of([*mags, imu.part(int(ends[k]), int(ends[k + 1]))], None))
    cuts = imu.stamps_ns.searchsorted([known_stamp(sample) for sample in before], side="right").tolist()
    aided: list = []
    for first, cut, sample in zip([0, *cuts], cuts, before, strict=False):
        aided += [imu.part(first, cut), sample] if cut > first else [sample]
    return [*aided, imu.part(cuts[-1], int(ends[0]))] if cuts[-1] < ends[0] else aided, epochs


def alone(rehearsal: Rehearsal, sins: SinsEngine, epochs: list[Epoch]) -> Iterator[tuple[str, SinsEngine]]:
    """Copies of the navigator that fly the epochs, each with the evidence of its own guide."""
    for name, guide in {COAST: None, **rehearsal.guides}.items():
        twin, collector = sins.snapshot(), rehearsal.copy().collectors.get(name)
        for sample in (sample for epoch in epochs for sample in (*epoch.others, epoch.imu)):
            for output in twin.feed(sample):
                if collector is not None and isinstance(output, NavBlock) and collector.feed(output) is not None:
                    for sample in guide.advise(last_stamp(output), collector.recent).samples:
                        twin.feed(sample)
        yield name, twin


def test_other_noise_is_that_of_every_way() -> None:
    """GIVEN a bank with a way WHEN the noise of the IMU changes THEN it changes for both filters, and nothing else."""
    constants = filter_setup.constants(Parameters(), NoiseIdentification())
    bank = FilterBank(SplitFilter(constants, 10, 0.05))
    bank.ways["network"] = Way(bank)
    shaken = filter_setup.constants(Parameters(), NoiseIdentification(), (0.1, 1.0))
    assert not np.array_equal(shaken, constants)
    bank.set_constants(shaken)
    shaken[at.COV_PERIOD] = 0.1
    np.testing.assert_array_equal(bank.constants, shaken)
    np.testing.assert_array_equal(bank.ways["network"].constants, shaken)


def test_a_longer_period_of_the_covariance_than_usual_stays() -> None:
    """GIVEN a period of the covariance of 0.2 s WHEN a bank begins, and when the noise changes THEN it is 0.2 s."""
    constants = filter_setup.constants(
        update(Parameters(), {"navigator.covariance_period": 0.2}), NoiseIdentification()
    )
    bank = FilterBank(SplitFilter(constants, 10, 0.05))
    assert bank.constants[at.COV_PERIOD] == 0.2
    bank.set_constants(constants)
    assert bank.constants[at.COV_PERIOD] == 0.2


def test_copies_decide_by_themselves_about_an_observation_of_one_way() -> None:
    """GIVEN a copy of an observation of one way WHEN it is decided how to use it THEN the original is undecided."""
    own = Observation(1.0, 10**9, Kind("velocity"), None)
    whole = OfOneWay(1.0, 10**9, ONE_WAY, ("network", own), arrival=4)
    twin = deep_copy(whole, {})
    assert isinstance(twin, OfOneWay)
    assert twin.key == whole.key
    twin.measured[1].decision = GATED
    assert own.decision is None


@pytest.mark.compiled
@pytest.mark.parametrize(("late", "period", "near"), [(False, 0.1, 1e-6), (True, 0.1, 1e-6), (False, 0.04, 0.01)])
def test_each_way_is_what_a_copy_of_the_navigator_would_be(late: bool, period: float, near: float) -> None:
    """GIVEN an aided flight WHEN 15 s of it are rehearsed, with a punctual or late magnetometer THEN every filter has
    the state of a copy of the navigator that is guided by itself: the same number, where that one's covariance has the
    period of rehearsals, and one ``near`` [m] it where it has the usual one."""
    aided, epochs = split(samples(60.0, 100.0), late)
    engine = PoseEstimator(update(Parameters(), {"navigator.covariance_period": period}))
    engine.feed_all(aided)
    aid = engine.outage_aid
    assert aid is not None
    ways = aid.learner.method.ways(aid._flight(20.0))
    rehearsal = Rehearsal.of(engine.sins, aid._pilot.state.collector, ways)
    expected = dict(alone(rehearsal, engine.sins, epochs))
    rehearsal.epochs = epochs
    rehearsal.fly()
    rehearsal.sins.run.timeline.settle()
    views = dict(rehearsal.bank.views())
    assert set(views) <= set(expected) == {COAST, *ways}  # a way whose guide says nothing coasts
    assert not np.array_equal(views["network"].nav, views[COAST].nav)
    for name, twin in expected.items():
        view, settled = views.get(name, views[COAST]), twin.run.settled
        apart = step_enu(settled.nav[at.LAT : at.VEL], view.nav[at.LAT : at.VEL])
        np.testing.assert_allclose(apart, 0.0, atol=near)
        np.testing.assert_allclose(view.P.diagonal(), settled.P.diagonal(), rtol=0.02)
