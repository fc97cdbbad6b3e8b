"""IMU blocks joined over samples of sensors that a navigator may know ahead of their time.

Only a sample that is valid after the IMU sample behind which it arrived can go ahead: known early or not, it then acts
between the same two rows. One of the same time acts behind that row, or ahead of it where it is known before.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nav_pose_estimator.engine.samples import ImuBlock, MagSample, PressureSample, Sample, joined

_QUIET = (MagSample, PressureSample)  # their observations never change the mode
_LONGEST_NS = 1_000_000_000  # of a batch
_AHEAD_NS = 500_000_000  # a stamp further ahead of the IMU's is for the navigator to judge when it comes
_STEP_NS = 100_000_000  # IMU samples further apart may make it start again: a gap is met sample by sample


@dataclass(frozen=True)
class SensorBatch:
    """One IMU block, ``others`` that arrived within it (behind how many IMU samples), and those that came after it."""

    imu: ImuBlock
    others: list[tuple[int, Sample]]
    after: list[Sample]

    @classmethod
    def of(cls, samples: Sequence[Sample]) -> SensorBatch:
        """From samples of which ``length`` says that they go together."""
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
        """What arrived within the IMU samples ``begin`` to ``end``, with its place counted from ``begin``."""
        return [(place - begin, sample) for place, sample in self.others if begin <= place < end]


def length(samples: Sequence[Sample], first: int) -> int:
    """How many of ``samples`` from ``first`` on go together, at least one."""
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
    """Whether every sample follows the one before it closely."""
    steps = np.diff(block.stamps_ns)
    return len(block) == 1 or (len(block) > 1 and bool(steps.min() > 0 and steps.max() <= _STEP_NS))
