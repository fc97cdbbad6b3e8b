"""Conversion of samples to serialized messages, for the bags of benchmark and tests."""

from collections.abc import Iterable, Iterator
from itertools import islice
from pathlib import Path

import numpy as np

from nav_pose_estimator.engine.samples import ImuBlock, ImuSample, Sample, joined, known_stamp
from nav_pose_estimator.offline.bags.sensor_topics import imu_topic, sensor_topics
from nav_pose_estimator.offline.bags.writer import MCAP, PLAIN, Messages, write_new

_AT_ONCE = 2000  # number of samples, including IMU blocks, that are written at once


def imu_bytes(sample: ImuSample) -> bytes:
    """A sensor_msgs/Imu in plain CDR: header with frame ``imu_link``, then 37 doubles."""
    seconds, nanoseconds = divmod(sample.stamp_ns, 10**9)
    head = np.array([seconds, nanoseconds, 9], "<u4").tobytes() + b"imu_link\0"
    body = np.zeros(37)
    body[3] = 1.0
    body[13:16], body[25:28] = sample.gyro, sample.accel
    return b"\x00\x01\x00\x00" + head + b"\0" * (-len(head) % 8) + body.tobytes()


def write_samples(path: Path, samples: Iterable[Sample], storage: str = MCAP) -> None:
    """Write ``samples`` as the uncompressed rosbag2 ``path``, each received at its stamp, in parts."""
    write_new(path, map(_messages, _parts(iter(samples))), storage, PLAIN)


def _parts(samples: Iterator[Sample]) -> Iterator[list[Sample]]:
    while part := list(islice(samples, _AT_ONCE)):
        yield part


def _messages(samples: list[Sample]) -> list[Messages]:
    imu = [sample for sample in samples if isinstance(sample, ImuBlock)]
    others: list[tuple[int, Sample]] = [
        (known_stamp(sample), sample) for sample in samples if not isinstance(sample, ImuBlock)
    ]
    block = joined(imu) if imu else None
    return [*([imu_topic(block, block.stamps_ns)] if block else []), *sensor_topics(others)]
