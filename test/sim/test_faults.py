"""Failures change what they should and nothing else."""

import math

import numpy as np
import pytest

from nav_pose_estimator.engine.samples import (
    GnssFix,
    GnssVelocity,
    ImuSample,
    MagSample,
    PressureSample,
    SatelliteCount,
)
from nav_pose_estimator.sim.faults import Creep, Delay, Freeze, NotANumber, Redate, SetCount, Shift, Stop, Thin
from nav_pose_estimator.sim.recording import Recording
from nav_pose_estimator.sim.scenarios import HOME, START_NS, generate


@pytest.fixture(scope="module")
def healthy() -> Recording:
    """Ten seconds on the ground."""
    return generate("at_rest", 10.0, seed=1, imu_rate=50.0)


def seconds(timed) -> float:
    return (timed.arrival_ns - START_NS) * 1e-9


def of(recording: Recording, kind: type, start: float = 0.0, end: float = 99.0) -> list:
    return [timed for timed in recording.arrivals() if type(timed.sample) is kind and start <= seconds(timed) < end]


def test_stop(healthy: Recording) -> None:
    broken = healthy.with_faults(Stop(MagSample, 3.0, 2.0))
    assert not of(broken, MagSample, 3.0, 5.0)
    assert of(broken, MagSample, 5.0)
    assert len(of(broken, PressureSample)) == len(of(healthy, PressureSample))
    assert broken.imu is healthy.imu


def test_a_failure_lasts_for_ever_unless_told_otherwise(healthy: Recording) -> None:
    assert not of(healthy.with_faults(Stop(PressureSample, 3.0)), PressureSample, 3.0)


@pytest.mark.parametrize("kind", [ImuSample, MagSample, PressureSample, GnssFix, GnssVelocity])
def test_freeze_repeats_the_last_good_values_with_fresh_stamps(healthy: Recording, kind: type) -> None:
    broken = of(healthy.with_faults(Freeze(kind, 3.0, 2.0)), kind, 2.0, 7.0)
    original = of(healthy, kind, 2.0, 7.0)
    assert [timed.arrival_ns for timed in broken] == [timed.arrival_ns for timed in original]
    assert [timed.sample.stamp_ns for timed in broken] == [timed.sample.stamp_ns for timed in original]
    last_good = [timed for timed in original if seconds(timed) < 3.0][-1].sample
    name = {ImuSample: "accel", MagSample: "field", PressureSample: "pressure", GnssFix: "lat"}.get(kind, "vel_enu")
    frozen = [getattr(timed.sample, name) for timed in broken if 3.0 <= seconds(timed) < 5.0]
    assert frozen
    assert set(frozen) == {getattr(last_good, name)}
    assert broken[-1] == original[-1] or kind in (GnssFix, GnssVelocity)  # arrays in it do not compare


def test_not_a_number(healthy: Recording) -> None:
    broken = healthy.with_faults(*(NotANumber(kind, 3.0, 1.0) for kind in (ImuSample, GnssFix, SatelliteCount)))
    assert all(np.isnan(timed.sample.gyro).all() for timed in of(broken, ImuSample, 3.0, 4.0))
    assert all(math.isnan(timed.sample.alt) for timed in of(broken, GnssFix, 3.0, 4.0))
    assert all(timed.sample.count is None for timed in of(broken, SatelliteCount, 3.0, 4.0))
    assert np.isfinite(broken.imu.accel).sum() == healthy.imu.accel.size - 3 * 50


def test_shift(healthy: Recording) -> None:
    broken = healthy.with_faults(
        Shift(GnssFix, 3.0, 1.0, (30.0, -40.0, 5.0)),
        Shift(ImuSample, 3.0, 1.0, (0.1, 0.2, 0.3, 1.0, 2.0, 3.0)),
        Shift(SatelliteCount, 3.0, 1.0, (-4.0,)),
    )
    before, after = (of(one, GnssFix, 3.0, 4.0)[0].sample for one in (healthy, broken))
    metres = 6.378e6 * np.array([(after.lon - before.lon) * math.cos(HOME.lat), after.lat - before.lat])
    np.testing.assert_allclose(metres, (30.0, -40.0), rtol=0.01)
    assert after.alt - before.alt == pytest.approx(5.0)
    before, after = (of(one, ImuSample, 3.0, 4.0)[0].sample for one in (healthy, broken))
    np.testing.assert_allclose(np.subtract(after.gyro, before.gyro), (0.1, 0.2, 0.3))
    np.testing.assert_allclose(np.subtract(after.accel, before.accel), (1.0, 2.0, 3.0))
    before, after = (of(one, SatelliteCount, 3.0, 4.0)[0].sample for one in (healthy, broken))
    assert after.count == before.count - 4


def test_creep_moves_a_little_more_with_every_fix(healthy: Recording) -> None:
    broken = healthy.with_faults(Creep(start=3.0, length=2.0, step=(0.0, 0.5, 0.0)))
    pairs = zip(of(healthy, GnssFix, 3.0, 5.0), of(broken, GnssFix, 3.0, 5.0), strict=True)
    metres = [6.37e6 * (b.sample.lat - a.sample.lat) for a, b in pairs]
    np.testing.assert_allclose(metres, 0.5 * np.arange(len(metres)), rtol=0.01, atol=1e-6)
    assert of(broken, GnssFix, 5.0)[0].sample.lat == of(healthy, GnssFix, 5.0)[0].sample.lat


@pytest.mark.parametrize("kind", [ImuSample, GnssFix, SatelliteCount])
def test_redate_changes_stamps_and_not_arrivals(healthy: Recording, kind: type) -> None:
    broken = healthy.with_faults(Redate(kind, 3.0, 2.0, seconds=-7.5))
    pairs = list(zip(of(healthy, kind), of(broken, kind), strict=True))
    assert all(a.arrival_ns == b.arrival_ns for a, b in pairs)
    moved = {b.sample.stamp_ns - a.sample.stamp_ns for a, b in pairs if a.sample.stamp_ns is not None}
    assert moved == (set() if kind is SatelliteCount else {0, -7_500_000_000})


def test_count_can_be_forced_while_fixes_go_on(healthy: Recording) -> None:
    broken = healthy.with_faults(SetCount(start=3.0, length=1.0, count=3))
    assert {timed.sample.count for timed in of(broken, SatelliteCount, 3.0, 4.0)} == {3}
    assert [timed.sample.lat for timed in of(broken, GnssFix)] == [timed.sample.lat for timed in of(healthy, GnssFix)]


def test_delayed_samples_keep_their_stamps_and_come_out_of_order(healthy: Recording) -> None:
    broken = healthy.with_faults(Delay(GnssFix, 3.0, 0.5, delay=0.7))
    arrivals = [timed.arrival_ns for timed in broken.arrivals()]
    assert arrivals == sorted(arrivals)
    stamps = [timed.sample.stamp_ns for timed in of(broken, GnssFix)]
    assert sorted(stamps) == [timed.sample.stamp_ns for timed in of(healthy, GnssFix)]
    assert stamps != sorted(stamps)


def test_thin_lowers_the_rate(healthy: Recording) -> None:
    broken = healthy.with_faults(Thin(ImuSample, 2.0, 4.0, keep_every=5))
    assert len(of(broken, ImuSample, 2.0, 6.0)) == 40
    assert len(broken.imu) == len(healthy.imu) - 160
    assert (np.diff(broken.imu.stamps_ns).max()) == 100_000_000


def test_failures_compose(healthy: Recording) -> None:
    broken = healthy.with_faults(Thin(MagSample, keep_every=2), NotANumber(MagSample, 3.0, 1.0))
    assert len(of(broken, MagSample)) == -(-len(of(healthy, MagSample)) // 2)
    assert all(math.isnan(timed.sample.field[0]) for timed in of(broken, MagSample, 3.0, 4.0))


def test_truth_does_not_change(healthy: Recording) -> None:
    broken = healthy.with_faults(Stop(ImuSample, 1.0), Stop(GnssFix))
    assert broken.truth is healthy.truth
    assert len(broken.imu) == 50
    assert len(broken.imu_data.block) == 501
