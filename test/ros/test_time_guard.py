"""Time that goes back: proof before a reset, nothing lost, nothing reset for a damaged stamp."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nav_pose_estimator.engine.samples import GnssFix, ImuSample, SatelliteCount
from nav_pose_estimator.ros.pace import Pace
from nav_pose_estimator.ros.time_guard import TimeGuard

SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND


def imu(stamp: int) -> ImuSample:
    return ImuSample(stamp, (0.0, 0.0, 0.0), (0.0, 0.0, 9.8))


def lap(seconds: float = 20.0, rate: int = 20) -> list:
    """IMU with a fix each second, stamped 0.2 s in the past, and its count."""
    samples = []
    for i in range(int(seconds * rate)):
        stamp = START + i * SECOND // rate
        if i % rate == 0:
            samples += [GnssFix(stamp - SECOND // 5, 0.8, 0.1, 0.0), SatelliteCount(None, 12)]
        samples.append(imu(stamp))
    return samples


def play(guard: TimeGuard, samples: list) -> tuple[list, list[float]]:
    admissions = [guard.admit(sample) for sample in samples]
    return [s for a in admissions for s in a.samples], [a.back_s for a in admissions if a.back_s]


def test_a_first_run_passes_untouched():
    assert play(TimeGuard(SECOND), lap()) == (lap(), [])


@pytest.mark.parametrize("expected", [False, True], ids=["stamps_alone", "with_clock_jump"])
def test_a_second_lap_gives_one_reset_and_every_sample_in_order(expected):
    guard = TimeGuard(SECOND)
    play(guard, lap())
    if expected:
        guard.expect_restart()
    passed, resets = play(guard, lap())
    assert len(resets) == 1
    assert resets[0] == pytest.approx(20.15, abs=0.11)
    assert passed == lap()


def test_one_damaged_stamp_does_not_reset():
    guard = TimeGuard(SECOND)
    samples = lap()
    samples.insert(100, imu(5 * SECOND))
    samples.insert(200, imu(START + 10**6 * SECOND))
    samples.insert(300, imu(0))
    passed, resets = play(guard, samples)
    assert resets == []
    assert sorted(map(repr, passed)) == sorted(map(repr, samples))


def test_gnss_stamps_far_in_the_past_do_not_reset_and_are_handed_on():
    guard = TimeGuard(SECOND)
    samples = [s if isinstance(s, ImuSample) else GnssFix(77 * SECOND, 0.8, 0.1, 0.0) for s in lap()]
    passed, resets = play(guard, samples)
    assert resets == []
    assert len(passed) == len(samples)


def test_silence_of_the_imu_does_not_turn_late_fixes_into_a_new_run():
    guard = TimeGuard(SECOND)
    play(guard, lap())
    late = [GnssFix(START, 0.8, 0.1, 0.0)] * 200
    passed, resets = play(guard, [*late, imu(START + 25 * SECOND)])
    assert resets == []
    assert len(passed) == 201


def test_a_gap_of_five_seconds_is_no_restart():
    guard = TimeGuard(SECOND)
    samples = lap(5.0) + [imu(START + 10 * SECOND + i * SECOND // 20) for i in range(40)]
    assert play(guard, samples) == (samples, [])


@given(st.lists(st.integers(-2 * SECOND, 100 * SECOND), max_size=200))
def test_whatever_the_stamps_no_sample_is_lost_or_doubled(offsets):
    guard = TimeGuard(SECOND)
    samples = [imu(START + offset) for offset in offsets]
    passed, _ = play(guard, samples)
    held = guard._held
    assert passed + held == samples


def test_pace_keeps_the_mean_rate_and_starts_again():
    pace = Pace(100.0)
    stamps = [START + i * SECOND // 333 for i in range(3330)]
    assert sum(map(pace.is_due, stamps)) == pytest.approx(1000, abs=2)
    assert pace.is_due(START)
    assert all(map(Pace(0.0).is_due, stamps))
