"""From solutions to epochs: when one ends, which are worth learning from, and how much of them is remembered."""

from collections import deque
from itertools import pairwise

import numpy as np
import pytest

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.motion import epochs as me
from nav_pose_estimator.core.numerics.snapshot import snapshot
from nav_pose_estimator.engine.outage.epochs import EpochCollector, FlightMemory
from nav_pose_estimator.engine.solutions import Mode, NavBlock, NavSolution

RATE, START = 50, 1_700_000_000_000_000_000
STEP = 10**9 // RATE


def rows(count: int, first: int = 0, heading_var: float = 1e-4) -> np.ndarray:
    """Output rows that tell their number in the East velocity."""
    out = np.zeros((count, at.OUT_COLUMNS))
    out[:, at.OUT_VEL], out[:, at.OUT_QUAT] = np.arange(first, first + count), 1.0
    out[:, at.OUT_VAR + 2] = heading_var
    return out


def block(first: int, count: int, mode: Mode = Mode.AIDED, **kind) -> NavBlock:
    stamps = START + STEP * np.arange(first, first + count)
    return NavBlock(stamps, rows(count, first, **kind), mode, 0, np.zeros(3))


def collect(collector: EpochCollector, blocks: list[NavBlock]) -> list[tuple[np.ndarray, bool]]:
    return [found for one in blocks if (found := collector.feed(one)) is not None]


def quarter_seconds(first: int, last: int, **kind) -> list[NavBlock]:
    """Blocks that end as the pose estimator cuts them: behind the first sample of a period."""
    cuts = [first, *range(-(-first // 25) * 25 + 1, last, 25), last]
    return [block(a, b - a, **kind) for a, b in pairwise(cuts) if b > a]


def test_an_epoch_ends_with_the_first_sample_of_the_next_half_second() -> None:
    """GIVEN four seconds of solutions WHEN collected THEN there is an epoch every half second after the first, with all
    samples since the last, and ``recent`` holds the last four."""
    collector = EpochCollector()
    found = collect(collector, quarter_seconds(0, 201))
    assert [one[me.TIME] - START * 1e-9 for one, _ in found] == pytest.approx(np.arange(1, 9) * 0.5, abs=1e-6)
    assert [one[me.VELOCITY] for one, _ in found] == pytest.approx([25 * k - 12.0 for k in range(1, 9)])
    np.testing.assert_array_equal(np.array(collector.recent), [one for one, _ in found[-4:]])
    assert all(good for _, good in found)


@pytest.mark.parametrize("first", [0, 13])
def test_single_solutions_give_the_epochs_of_blocks(first: int) -> None:
    """Also where the first block begins within a half second and ends it."""

    def single(n: int) -> NavSolution:
        values = np.zeros(at.SOLUTION_SIZE)
        values[: at.OUT_COLUMNS] = rows(1, n)[0]
        return NavSolution(START + STEP * n, Mode.AIDED, values, np.zeros(3), 0)

    alone = collect(EpochCollector(), [single(n) for n in range(first, 201)])
    together = collect(EpochCollector(), quarter_seconds(first, 201))
    assert len(alone) == len(together) == 8
    for (one, good), (other, also) in zip(alone, together, strict=True):
        np.testing.assert_array_equal(one, other)
        assert good == also


def test_nothing_is_learned_from_what_is_not_aided_not_even_in_part() -> None:
    """GIVEN a loss in the middle of an epoch WHEN collected THEN that epoch and those without GNSS are not good, the
    first wholly aided one is."""
    collector = EpochCollector()
    parts = [*quarter_seconds(0, 101), block(101, 20), block(121, 5, Mode.COASTING)]
    parts += [*quarter_seconds(126, 176, mode=Mode.COASTING), block(176, 10, Mode.REACQUIRING), block(186, 15)]
    goods = [good for _, good in collect(collector, [*parts, *quarter_seconds(201, 251)])]
    assert goods == [True] * 4 + [False] * 4 + [True] * 2


def test_an_epoch_with_a_gap_is_not_good() -> None:
    """GIVEN samples that are missing for 0.3 s, then for 2 s WHEN collected THEN the thin epoch is no good, and the
    long gap gives none that spans it."""
    collector = EpochCollector()
    thin = collect(collector, [*quarter_seconds(0, 101), block(101, 5), *quarter_seconds(121, 201)])
    assert [good for _, good in thin] == [True] * 4 + [False] + [True] * 3
    after = collect(collector, quarter_seconds(301, 402))
    assert max(one[me.TIME] - before[me.TIME] for (before, _), (one, _) in pairwise(after)) < 0.51
    assert after[0][0][me.VELOCITY] > 301.0


def test_without_a_heading_nothing_is_learned_of_directions() -> None:
    goods = [good for _, good in collect(EpochCollector(), quarter_seconds(0, 101, heading_var=0.3**2))]
    assert goods == [False] * 4


def test_a_copy_of_a_collector_lives_its_own_life() -> None:
    collector = EpochCollector()
    collect(collector, quarter_seconds(0, 60))
    twin = snapshot(collector)
    collect(twin, [block(60, 10, Mode.COASTING)])
    (one, good), *_ = collect(collector, [block(60, 16)])
    assert good
    assert one[me.VELOCITY] == pytest.approx(63.0)


def test_the_memory_ends_after_ten_minutes_and_its_window_is_one_of_time() -> None:
    """GIVEN a flight with a break WHEN the last seconds are asked for THEN nothing older comes, however few it is."""
    memory = FlightMemory(deque(maxlen=120))
    assert memory.last(10.0).shape == (0, me.COLUMNS)
    for n in range(200):
        one = np.zeros(me.COLUMNS)
        one[me.TIME] = 100.0 + me.PERIOD * n + (50.0 if n >= 190 else 0.0)
        memory.add(one)
    assert len(memory) == 120
    assert memory.seconds == 60.0
    assert len(memory.last(3.0)) == 6
    assert len(memory.last(30.0)) == 10
    assert len(memory.last(1000.0)) == 120
    twin = snapshot(memory)
    twin.add(np.zeros(me.COLUMNS))
    assert memory.last(1.0)[-1][me.TIME] > 100.0
