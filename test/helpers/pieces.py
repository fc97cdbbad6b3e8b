"""Division of a flight into single samples."""

from collections.abc import Iterable

from nav_pose_estimator.engine.samples import ImuBlock, ImuSample, Sample


def one_by_one(flight: Iterable[Sample]) -> list[Sample]:
    """All samples one by one, with the rows of IMU blocks as single samples."""
    return [single for sample in flight for single in _singles(sample)]


def _singles(sample: Sample) -> list[Sample]:
    if not isinstance(sample, ImuBlock):
        return [sample]
    rows = zip(sample.stamps_ns.tolist(), sample.gyro.tolist(), sample.accel.tolist(), strict=True)
    return [ImuSample(t, tuple(w), tuple(f)) for t, w, f in rows]
