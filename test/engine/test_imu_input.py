"""The door for IMU samples: what is refused, what is only told, and that blocks and single samples agree."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nav_pose_estimator.engine.imu.input import ImuInput
from nav_pose_estimator.engine.imu.mounting import axes_matrix
from nav_pose_estimator.engine.imu.rules import CLOCK_JUMP, GAP, STUCK, STUCK_END
from nav_pose_estimator.engine.parameters.imu import ImuParameters
from nav_pose_estimator.engine.samples import ImuBlock, ImuSample
from nav_pose_estimator.engine.solutions import Event
from pieces import one_by_one

STEP = 5_000_000
START = 1_000_000_000
MOUNTINGS = [
    (0, 0, 0),
    (math.pi, 0, 0),
    (0, math.pi / 2, 0),
    (0, 0, math.pi / 2),
    (-math.pi / 2, 0, 0),
    (0.1, -0.2, 0.3),
]


def sample(k, gyro=None, accel=None, stamp=None):
    wiggle = 1e-3 * math.sin(1.0 + k)
    gyro = gyro or (wiggle, -wiggle, 2 * wiggle)
    return ImuSample(START + k * STEP if stamp is None else stamp, gyro, accel or (wiggle, 0.1, 9.8 + wiggle))


def names(items):
    return [item.name for item in items if isinstance(item, Event)]


def feed(samples, parameters=None):
    door = ImuInput(parameters or ImuParameters())
    return [item for s in samples for item in door.accept(s)]


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (sample(2, gyro=(math.nan, 0, 0)), "imu.rejected.nan"),
        (sample(2, accel=(0, 0, math.inf)), "imu.rejected.nan"),
        (sample(2, gyro=(0, 1e3, 0)), "imu.rejected.rate"),
        (sample(2, accel=(0, 1e4, 0)), "imu.rejected.force"),
        (sample(2, stamp=0), "imu.rejected.zero_stamp"),
        (sample(2, stamp=START + STEP), "imu.rejected.duplicate"),
        (sample(2, stamp=START + STEP - 1), "imu.rejected.backward"),
        (sample(2, stamp=START + 10**12), "imu.rejected.forward"),
    ],
)
def test_a_bad_sample_is_refused_by_name_and_the_next_one_is_used(bad, reason):
    items = feed([sample(0), sample(1), bad, sample(3)])
    assert names(items) == [reason]
    assert [i.stamp_ns for i in items if isinstance(i, ImuSample)] == [sample(k).stamp_ns for k in (0, 1, 3)]
    assert all(i.text.endswith((".", "used", "agrees")) for i in items if isinstance(i, Event))


def test_a_gap_is_announced_ahead_of_the_sample_that_ends_it():
    items = feed([sample(0), sample(1000), sample(1001)])
    assert names(items) == ["imu.rejected.forward", GAP]
    assert isinstance(items[-1], ImuSample)
    assert items[-2].data["gap_s"] == pytest.approx(5.005)


def test_a_clock_set_back_starts_again_and_the_second_lap_passes():
    lap = [sample(k) for k in range(1000)]
    items = feed(lap + lap)
    assert names(items) == ["imu.rejected.backward", "imu.rejected.backward", CLOCK_JUMP]
    assert sum(isinstance(i, ImuSample) for i in items) == 1998


def test_the_motion_lost_by_a_clock_set_back_a_little_is_a_gap():
    """GIVEN a clock set back by 0.5 s, less than imu.max_gap WHEN its stamps pass the old ones THEN half a second
    of motion is lost, which is a gap; a few samples out of order and jitter are none."""
    lap = [sample(k) for k in range(300)]
    set_back = [sample(k, stamp=START + (k - 100) * STEP) for k in range(300, 600)]
    items = feed([*lap, *set_back])
    assert set(names(items)) == {"imu.rejected.backward", "imu.rejected.duplicate", GAP}
    gap = next(i for i in items if isinstance(i, Event) and i.name == GAP)
    assert gap.data["gap_s"] == pytest.approx(0.5, abs=0.006)
    assert gap.stamp_ns == START + 300 * STEP
    late = [sample(k) for k in (*range(100), *range(120, 140), *range(105, 114), *range(140, 200))]
    rng = np.random.default_rng(1)
    jitter = [sample(k, stamp=START + k * STEP + round(3e7 * rng.standard_normal())) for k in range(20_000)]
    assert GAP not in names(feed(late) + feed(jitter))


def test_a_stuck_sensor_is_told_once_and_its_recovery_too():
    frozen = [sample(k, accel=(0.1, 0.2, 9.7)) for k in range(300)]
    items = feed([*frozen, *(sample(k) for k in range(300, 310))])
    assert names(items) == [STUCK, STUCK_END]
    told = next(i for i in items if isinstance(i, Event))
    assert "accelerometer" in told.text
    assert told.stamp_ns == START + round(0.5e9)


def test_a_clipped_axis_is_told_but_a_repeated_slow_sensor_is_not():
    clipped = [sample(k, gyro=(0.01 * math.sin(k), 8.7, 0.0)) for k in range(5)]
    assert names(feed(clipped)) == ["imu.saturated.gyroscope"]
    assert names(feed([*clipped, sample(5)])) == ["imu.saturated.gyroscope", "imu.saturated.ended"]
    repeated = [sample(k, gyro=(0.01 * math.sin(k // 4), 8.0 + k // 4, 0.0)) for k in range(40)]
    assert names(feed(repeated)) == []


@pytest.mark.parametrize("mounting", MOUNTINGS)
@pytest.mark.parametrize("convention", ["flu", "frd"])
def test_axes_turn_a_known_body_vector_back(mounting, convention):
    parameters = ImuParameters(mounting_rpy=mounting, convention=convention)
    C_bs = axes_matrix(parameters)
    assert np.linalg.det(C_bs) == pytest.approx(1.0)
    body = np.array([0.3, -0.2, 9.7])
    out = ImuInput(parameters).accept(sample(0, accel=tuple(C_bs.T @ body)))[0]
    np.testing.assert_allclose(out.accel, body, atol=1e-12)


def test_frd_is_a_half_turn_about_x():
    np.testing.assert_array_equal(axes_matrix(ImuParameters(convention="frd")), np.diag([1.0, -1.0, -1.0]))


FAULTS = st.sampled_from(["good", "good", "good", "nan", "repeat", "clip", "back", "far", "zero", "same"])


@settings(max_examples=150, deadline=None)
@given(st.lists(FAULTS, min_size=1, max_size=150), st.integers(1, 150))
def test_blocks_and_single_samples_tell_the_same_story(faults, size):
    samples, stamp = [], START
    for k, fault in enumerate(faults):
        stamp += STEP
        made = {
            "nan": sample(k, gyro=(math.nan, 0, 0), stamp=stamp),
            "repeat": sample(0, stamp=stamp),
            "clip": sample(k, gyro=(20.0, 1e-3 * math.cos(k), 0.0), stamp=stamp),
            "back": sample(k, stamp=stamp - 10**10 if stamp > 2 * 10**10 else stamp - 2 * STEP),
            "far": sample(k, stamp=stamp + 10**11),
            "zero": sample(k, stamp=0),
            "same": sample(k, stamp=stamp - STEP),
        }
        samples.append(made.get(fault, sample(k, stamp=stamp)))
    parameters = ImuParameters(mounting_rpy=(0.1, 0.2, 0.3), stuck_time=0.05)
    one, many = ImuInput(parameters), ImuInput(parameters)
    expected = [item for s in samples for item in one.accept(s)]
    got = []
    for i in range(0, len(samples), size):
        part = samples[i : i + size]
        stamps = np.array([s.stamp_ns for s in part])
        got += many.accept_block(ImuBlock(stamps, np.array([s.gyro for s in part]), np.array([s.accel for s in part])))
    assert one_by_one(got) == expected


def test_restore_brings_back_the_memory():
    door = ImuInput(ImuParameters())
    door.accept(sample(0))
    saved = door.snapshot()
    door.accept(sample(1))
    door.restore(saved)
    assert isinstance(door.accept(sample(1))[0], ImuSample)


def test_what_has_been_said_is_not_said_again_after_a_reset_or_by_a_copy():
    """GIVEN an IMU one sample of which is NaN, in a sentence, WHEN the memory is reset or restored in another input
    THEN a further such sample is only counted."""
    door, other = ImuInput(ImuParameters()), ImuInput(ImuParameters())
    first = door.accept(sample(1, gyro=(math.nan, 0, 0)))[0]
    assert first.text
    door.reset()
    other.restore(door.snapshot())
    for one in (door, other):
        again = one.accept(sample(2, gyro=(math.nan, 0, 0)))[0]
        assert again.name == first.name
        assert not again.text
