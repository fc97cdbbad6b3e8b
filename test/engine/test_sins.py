"""Scenarios of the navigator on simulated flights: modes, accuracy, honesty, and that nothing breaks it."""

import math
from collections.abc import Iterable, Iterator

import numpy as np
import pytest

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.navigator.sins import SinsEngine
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import (
    GnssFix,
    GnssVelocity,
    ImuBlock,
    ImuSample,
    Sample,
    SatelliteCount,
)
from nav_pose_estimator.engine.solutions import Event, Mode, NavBlock, NavSolution
from nav_pose_estimator.sim.recording import Recording
from nav_pose_estimator.sim.scenarios import generate
from pieces import one_by_one

GNSS = (GnssFix, GnssVelocity, SatelliteCount)


@pytest.fixture(scope="module")
def flight() -> Recording:
    return generate("multirotor_outage", duration=120.0, seed=5, imu_rate=100.0)


def seconds(recording: Recording, sample: Sample) -> float:
    stamp = sample.stamps_ns[-1] if isinstance(sample, ImuBlock) else sample.stamp_ns
    return math.nan if stamp is None else (int(stamp) - recording.start_ns) * 1e-9


def without_gnss(recording: Recording, start: float, length: float) -> Iterator[Sample]:
    last = 0.0
    for sample in recording.samples():
        last = last if math.isnan(seconds(recording, sample)) else seconds(recording, sample)
        if not (isinstance(sample, GNSS) and start <= last < start + length):
            yield sample


def play(samples: Iterable[Sample], **overrides: object) -> tuple[PoseEstimator, list]:
    engine = PoseEstimator(update(Parameters(), {k.replace("__", "."): v for k, v in overrides.items()}))
    return engine, [output for sample in samples for output in engine.feed(sample)]


def track(outputs: list) -> tuple[np.ndarray, np.ndarray, list[Mode]]:
    """Stamps (N,), rows (N, OUT_COLUMNS) and the mode of every row."""
    blocks = [o for o in outputs if isinstance(o, NavBlock)]
    modes = [b.mode for b in blocks for _ in range(len(b.stamps_ns))]
    return np.concatenate([b.stamps_ns for b in blocks]), np.concatenate([b.rows for b in blocks]), modes


def errors(recording: Recording, stamps: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Horizontal position error (N,) [m] against the truth."""
    t = (stamps - recording.start_ns) * 1e-9
    return np.hypot(*recording.error_enu(t, rows[:, at.OUT_POS : at.OUT_VEL])[:, :2].T)


def test_an_outage_and_back(flight: Recording) -> None:
    """GIVEN a flight WHEN GNSS is gone for 30 s THEN the modes tell, the drift is small and sigma covers it."""
    _, outputs = play(without_gnss(flight, 60.0, 30.0))
    stamps, rows, modes = track(outputs)
    t = (stamps - flight.start_ns) * 1e-9
    error = errors(flight, stamps, rows)
    sigma = np.sqrt(rows[:, at.OUT_VAR + at.DPOS] + rows[:, at.OUT_VAR + at.DPOS + 1])
    order = list(dict.fromkeys(modes))
    assert order[0] is Mode.AIDED
    assert Mode.REACQUIRING in order
    assert modes[-1] is Mode.AIDED
    assert {m for m, s in zip(modes, t, strict=True) if 62.0 < s < 88.0} <= {Mode.COASTING, Mode.DEAD_RECKONING}
    assert error[(t > 40) & (t < 60)].max() < 5.0
    assert error[(t > 85) & (t < 90)].max() < 60.0
    assert np.mean(error[t > 40] < 3.0 * sigma[t > 40]) > 0.97
    assert error[t > 105].max() < 5.0


def test_blocks_and_single_samples_are_equal_bit_for_bit(flight: Recording) -> None:
    _, blocks = play(without_gnss(flight, 30.0, 10.0))
    _, rows, modes = track(blocks)
    singles = one_by_one(without_gnss(flight, 30.0, 10.0))
    _, outputs = play(singles)
    solutions = [o for o in outputs if isinstance(o, NavSolution)]
    assert [s.mode for s in solutions] == modes
    np.testing.assert_array_equal([[s.lat, s.lon, s.alt] for s in solutions], rows[:, at.OUT_POS : at.OUT_VEL])
    np.testing.assert_array_equal([s.q_nb for s in solutions], rows[:, at.OUT_QUAT : at.OUT_RATE])


def test_a_start_in_the_air_is_the_same_for_blocks_and_single_samples() -> None:
    """GIVEN a recording that begins in flight WHEN the attitude filter helps to level
    THEN the start is that of single samples, bit for bit, and not that without the help."""
    recording = generate("start_in_air", duration=40.0, seed=6, imu_rate=100.0)
    samples = list(recording.samples())
    blocks, singles = PoseEstimator(), PoseEstimator()
    alone = PoseEstimator(attitude=False)
    for sample in samples:
        blocks.feed(sample)
        alone.feed(sample)
        for single in one_by_one([sample]):
            singles.feed(single)
    assert blocks.mode is Mode.AIDED
    np.testing.assert_array_equal(blocks.sins.run.settled.nav.copy(), singles.sins.run.settled.nav.copy())
    assert not np.array_equal(blocks.sins.run.settled.nav.copy(), alone.sins.run.settled.nav.copy())


def test_a_snapshot_lives_its_own_life(flight: Recording) -> None:
    samples = list(flight.samples())
    half = len(samples) // 2
    engine, _ = play(samples[:half])
    kept = engine.snapshot()
    first = [o for s in samples[half:] for o in engine.feed(s)]
    engine.restore(kept)
    second = [o for s in samples[half:] for o in engine.feed(s)]
    np.testing.assert_array_equal(track(first)[1], track(second)[1])


def test_the_operator_can_take_gnss_away(flight: Recording) -> None:
    engine = PoseEstimator()
    seen = set()
    for sample in flight.samples():
        if seconds(flight, sample) > 50.0:
            engine.set_use_gnss(False)
        engine.feed(sample)
        seen.add(engine.mode)
    assert engine.mode in (Mode.COASTING, Mode.DEAD_RECKONING)
    assert engine.status().counters["gnss.rejected.disabled"] > 5


@pytest.mark.parametrize("size", [1, 100])
def test_a_failure_while_aligning_starts_the_alignment_again(flight: Recording, size: int) -> None:
    """GIVEN a navigator that aligns WHEN it should start again THEN it does, losing no row, in blocks as by samples."""
    engine, block = SinsEngine(), flight.imu
    engine.feed(block.part(0, 500))
    engine.run.imu_failure = "no IMU"
    outputs = [o for i in range(500, 4000, size) for o in engine.feed(block.part(i, i + size))]
    assert [o.text for o in outputs if isinstance(o, Event) and o.name == "reset"] == [
        "the navigator starts again: no IMU"
    ]
    assert engine.run.now == pytest.approx(39.99, abs=0.005)


@pytest.mark.parametrize(
    ("spoil", "counter"),
    [
        (lambda s: ImuSample(s.stamp_ns, (math.nan, 0.0, 0.0), s.accel), "imu.rejected.nan"),
        (lambda s: ImuSample(s.stamp_ns, s.gyro, (math.inf, 0.0, 0.0)), "imu.rejected.nan"),
        (lambda s: ImuSample(0, s.gyro, s.accel), "imu.rejected.zero_stamp"),
        (lambda s: ImuSample(s.stamp_ns - 30_000_000, s.gyro, s.accel), "imu.rejected.backward"),
    ],
)
def test_damaged_imu_samples_are_counted_and_harm_nothing(flight: Recording, spoil, counter: str) -> None:
    samples = one_by_one(without_gnss(flight, 500.0, 1.0))[:4000]
    spoiled = [spoil(s) if isinstance(s, ImuSample) and i % 97 == 96 else s for i, s in enumerate(samples)]
    engine, outputs = play(spoiled)
    assert engine.status().counters[counter] > 10
    assert all(np.isfinite([o.lat, *o.vel_n, *o.q_nb]).all() for o in outputs if isinstance(o, NavSolution))
    assert engine.mode is Mode.AIDED


@pytest.mark.parametrize(("length", "event"), [(5.0, "resume.begun"), (61.0, "reset")])
def test_after_a_gap_it_goes_on_and_after_a_minute_it_starts_again(flight: Recording, length: float, event) -> None:
    """GIVEN an aided navigator WHEN the IMU is silent for 5 s or for a minute THEN it says what it does about it."""
    cut = [s for s in flight.samples() if not 30.0 < seconds(flight, s) < 30.0 + length]
    engine, outputs = play(cut)
    names = [o.name for o in outputs if isinstance(o, Event)]
    assert names.count("imu.gap") == 1
    assert [name for name in names if name in ("resume.begun", "reset")] == [event]
    assert engine.mode is Mode.AIDED


def test_the_last_solution_of_a_failed_filter_has_its_own_covariance(flight: Recording) -> None:
    """GIVEN single samples WHEN the filter fails THEN its last solution does not have the next filter's covariance."""
    engine = SinsEngine()
    solutions: list[NavSolution] = []
    for sample in one_by_one(flight.samples()):
        if len(solutions) == 3000:
            engine.run.imu_failure = "no IMU"
            engine.run.quiet_until = -math.inf
        solutions += [one for one in engine.feed(sample) if isinstance(one, NavSolution)]
        if len(solutions) > 3000:
            break
    before, last = (np.sqrt(np.diag(one.cov)) for one in solutions[-2:])
    np.testing.assert_allclose(last, before, rtol=0.1)


@pytest.mark.parametrize("harm", ["speed", "variance"])
def test_a_filter_that_diverges_while_aided_starts_again(flight: Recording, harm: str) -> None:
    """GIVEN fixes that are used WHEN the filter's speed is beyond all receivers', or its covariance impossible
    THEN within a second it starts again, and says why."""
    engine, outputs = PoseEstimator(Parameters()), []
    for sample in flight.samples():
        if isinstance(sample, ImuBlock) and seconds(flight, sample) >= 60.0 and harm:
            whole = engine.sins.run.timeline.filter
            if harm == "speed":
                whole.nav[at.VEL] = 2000.0
            else:
                whole.P[at.BASE_STATES - 1, at.BASE_STATES - 1] = -1e-3
            harm = ""
        outputs += engine.feed(sample)
        if seconds(flight, sample) > 62.0:
            break
    text = next(o.text for o in outputs if isinstance(o, Event) and o.name == "reset")
    assert "diverged" in text
    assert not any(np.isnan(block.rows).any() for block in outputs if isinstance(block, NavBlock))


def test_a_second_lap_equals_the_first(flight: Recording) -> None:
    """GIVEN a recording WHEN it is played twice in a row THEN the time jump resets all and lap two equals lap one."""
    samples = [s for s in flight.samples() if not seconds(flight, s) > 60.0]
    engine = PoseEstimator()
    laps = []
    for _ in range(2):
        laps.append(track([o for s in samples for o in engine.feed(s)]))
        engine.reset(samples[0].stamps_ns[0], "the recording starts again")
    np.testing.assert_array_equal(laps[0][1], laps[1][1])
