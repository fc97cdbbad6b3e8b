"""Samples in order: an IMU in blocks, and what came between its rows."""

from collections.abc import Sequence

import numpy as np

from nav_pose_estimator.engine.samples import ImuBlock, Sample


def interleaved(imu: ImuBlock, others: Sequence[Sample], rows: np.ndarray) -> list[Sample]:
    """``others`` between parts of ``imu``: number i comes before row ``rows[i]``; ``rows`` (N,) never fall."""
    out: list[Sample] = []
    done = 0
    for row, sample in zip(rows.tolist(), others, strict=True):
        if row > done:
            out.append(imu.part(done, row))
            done = row
        out.append(sample)
    if done < len(imu):
        out.append(imu.part(done, None))
    return out
