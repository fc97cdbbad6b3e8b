"""Joins IMU blocks across samples of sensors that the navigator may get ahead of their time.

A sample may go ahead only if it is valid after the IMU sample behind which it arrived: it then acts between the same
two rows in either order. A sample of the same time would act before that row if known early, and behind it otherwise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nav_pose_estimator.engine.samples import ImuBlock, MagSample, PressureSample, Sample, joined

_QUIET = (MagSample, PressureSample)  # their observations never change the mode
_LONGEST_NS = 1_000_000_000  # longest batch
_AHEAD_NS = 500_000_000  # a sample stamped further ahead of the IMU is left to the navigator to judge
_STEP_NS = 100_000_000  # IMU samples further apart may cause a restart, so a gap is fed sample by sample


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


def length(samples: Sequence[Sample], first: int) -> int:
    """Number of ``samples`` from ``first`` on that can form a batch, at least one."""
    block = samples[first]
    if not isinstance(block, ImuBlock) or not _is_steady(block):
        return 1
    begin, last = int(block.stamps_ns[0]), int(block.stamps_ns[-1])
    for count in range(1, len(samples) - first):
        sample = samples[first + count]
        if isinstance(sample, ImuBlock):
            follows = len(sample) > 0 and 0 < sample.stamps_ns[0] - last <= _STEP_NS
            if not (follows and sample.stamps_ns[-1] - begin <= _LONGEST_NS and _is_steady(sample)):
                return count
            last = int(sample.stamps_ns[-1])
        elif not (isinstance(sample, _QUIET) and last < sample.stamp_ns <= last + _AHEAD_NS):
            return count
    return len(samples) - first


def _is_steady(block: ImuBlock) -> bool:
    """Whether the samples of a block follow each other without a gap."""
    steps = np.diff(block.stamps_ns)
    return len(block) == 1 or (len(block) > 1 and bool(steps.min() > 0 and steps.max() <= _STEP_NS))
