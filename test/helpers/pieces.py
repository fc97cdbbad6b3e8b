"""Division of a flight into single samples."""

from collections.abc import Iterable

from nav_pose_estimator.engine.samples import ImuBlock, Sample


def one_by_one(flight: Iterable[Sample]) -> list[Sample]:
    """All samples one by one, with the rows of IMU blocks as single samples."""
    return [single for sample in flight for single in (sample.samples() if isinstance(sample, ImuBlock) else [sample])]
