"""Joins IMU blocks across samples of sensors that the navigator may get ahead of their time.

Such a sample is not older than the IMU sample behind which it arrived, so that it acts between the same two rows in
either order. One of the time of that IMU sample acts behind it (``Observation.behind``).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from nav_pose_estimator.engine.navigator.sins import SinsEngine
from nav_pose_estimator.engine.observation import Observation
from nav_pose_estimator.engine.samples import ImuBlock, MagSample, PressureSample, Sample, joined
from nav_pose_estimator.engine.solutions import Output

_QUIET = (MagSample, PressureSample)  # their observations never change the mode
_LONGEST_NS = 1_000_000_000  # longest batch
_AHEAD_NS = 250_000_000  # a sample stamped further ahead of the IMU is left to the navigator to judge
STEP_NS = 100_000_000
"""IMU samples further apart may cause a restart, so a gap is fed sample by sample."""


Early = Sequence[tuple[int, Sample]]
"""Samples with the number of IMU samples of a block before their arrival; the navigator gets them before the block."""


@dataclass(frozen=True)
class SensorBatch:
    """An IMU block, the ``others`` that arrived within it, each with the number of IMU samples before it, and those
    that arrived ``after`` it."""

    imu: ImuBlock
    others: list[tuple[int, Sample]]
    after: list[Sample]

    @classmethod
    def of(cls, samples: Sequence[Sample]) -> SensorBatch:
        """A batch of samples that belong together by ``length``."""
        blocks: list[ImuBlock] = []
        others: list[tuple[int, Sample]] = []
        count = 0
        for sample in samples:
            if isinstance(sample, ImuBlock):
                blocks.append(sample)
                count += len(sample)
            else:
                others.append((count, sample))
        within = [other for other in others if other[0] < count]
        return cls(joined(blocks), within, [sample for _, sample in others[len(within) :]])

    def early(self, begin: int, end: int) -> list[tuple[int, Sample]]:
        """The others that arrived within IMU samples ``begin`` to ``end``, with their place counted from ``begin``."""
        return [(place - begin, sample) for place, sample in self.others if begin <= place < end]


def length(samples: Sequence[Sample], first: int, waiting: Collection[int] = (), in_water: bool = False) -> int:
    """Number of ``samples`` from ``first`` on that can form a batch, at least one.

    ``waiting``: times of validity [ns] of observations that the navigator already has ahead of the IMU. ``in_water``:
    pressures are of the water, and the first of them changes the filter's states on arrival.
    """
    block = samples[first]
    if not isinstance(block, ImuBlock) or not _is_steady(block):
        return 1
    begin, last = int(block.stamps_ns[0]), int(block.stamps_ns[-1])
    ahead = set(waiting)  # ns: times of what is valid after the IMU sample behind which it arrived
    quiet = MagSample if in_water else _QUIET
    for count in range(1, len(samples) - first):
        sample = samples[first + count]
        if isinstance(sample, ImuBlock):
            follows = len(sample) > 0 and 0 < sample.stamps_ns[0] - last <= STEP_NS
            if not (follows and sample.stamps_ns[-1] - begin <= _LONGEST_NS and _is_steady(sample)):
                return count
            last = int(sample.stamps_ns[-1])
        elif not isinstance(sample, quiet) or not last <= sample.stamp_ns <= last + _AHEAD_NS:
            return count
        elif sample.stamp_ns > last:
            ahead.add(sample.stamp_ns)
        elif last in ahead:  # of two observations of a time, one would act ahead of its row and one behind it
            return count
    return len(samples) - first


def feed_ahead(sins: SinsEngine, block: Sample, early: Early) -> list[Output]:
    """Feed the ``early`` samples of an IMU ``block`` ahead of it."""
    assert isinstance(block, ImuBlock)
    outputs: list[Output] = []
    for place, sample in early:
        run, behind_ns = sins.run, int(block.stamps_ns[place - 1]) if place else 0

        def mark(observation: Observation, stamp_ns: int = behind_ns) -> bool:
            observation.behind = observation.stamp_ns == stamp_ns
            return False

        run.take_observation = mark
        if place:  # the past is computed again in order of arrival
            run.waiting_until = run.clock.seconds(behind_ns)
        try:
            outputs += sins.feed(sample)
        finally:
            run.take_observation = run.waiting_until = None
    return outputs


def _is_steady(block: ImuBlock) -> bool:
    """Whether the samples of a block follow each other without a gap."""
    steps = np.diff(block.stamps_ns)
    return len(block) == 1 or (len(block) > 1 and bool(steps.min() > 0 and steps.max() <= STEP_NS))
