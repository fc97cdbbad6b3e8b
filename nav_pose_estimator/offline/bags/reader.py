"""A rosbag2 as a stream of samples in receive-time order, IMU messages in blocks.

The conversions are those of the nodes (``convert``); only the message types that come at hundreds of hertz are
decoded many at a time. Header stamps are the samples' stamps; receive time only orders them.
"""

from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from nav_pose_estimator.engine.samples import ImuBlock, ImuSample, MagSample, PressureSample, Sample
from nav_pose_estimator.engine.solutions import Event
from nav_pose_estimator.offline.bags import topic_map
from nav_pose_estimator.offline.bags.cdr import LAYOUTS, Decoder, columns
from nav_pose_estimator.offline.bags.raw_messages import BagError, RawBatch, Topic
from nav_pose_estimator.offline.bags.storage import Bag
from nav_pose_estimator.ros.messages import convert, covariance, gps_umd, px4, satellites

_CONVERSIONS: dict[tuple[str, str], convert.Adapter] = {
    (topic_map.IMU, "sensor_msgs/msg/Imu"): convert.imu,
    (topic_map.IMU, topic_map.PX4_IMU): px4.imu,
    (topic_map.MAGNETOMETER, "sensor_msgs/msg/MagneticField"): convert.magnetic_field,
    (topic_map.FIX, "sensor_msgs/msg/NavSatFix"): convert.nav_sat_fix,
    (topic_map.FIX, "gps_msgs/msg/GPSFix"): gps_umd.fix,
    (topic_map.FIX, "px4_msgs/msg/SensorGps"): px4.fix,
    (topic_map.SATELLITES, "std_msgs/msg/UInt32"): satellites.from_uint32,
    (topic_map.SATELLITES, "gps_msgs/msg/GPSFix"): satellites.from_gpsfix,
    (topic_map.SATELLITES, "mavros_msgs/msg/GPSRAW"): satellites.from_gpsraw,
    (topic_map.SATELLITES, "ublox_msgs/msg/NavPVT"): satellites.from_navpvt,
    (topic_map.SATELLITES, "px4_msgs/msg/SensorGps"): px4.satellites,
    (topic_map.GNSS_VELOCITY, "geometry_msgs/msg/TwistWithCovarianceStamped"): convert.twist_with_covariance,
    (topic_map.GNSS_VELOCITY, "geometry_msgs/msg/TwistStamped"): convert.twist,
    (topic_map.GNSS_VELOCITY, "gps_msgs/msg/GPSFix"): gps_umd.velocity,
    (topic_map.GNSS_VELOCITY, "px4_msgs/msg/SensorGps"): px4.velocity,
    (topic_map.BAROMETER, "sensor_msgs/msg/FluidPressure"): convert.fluid_pressure,
    (topic_map.BODY_VELOCITY, "geometry_msgs/msg/TwistWithCovarianceStamped"): convert.body_velocity,
    (topic_map.SET_POSE, "geometry_msgs/msg/PoseWithCovarianceStamped"): convert.set_pose,
}
_IMU_FIELDS = (
    "angular_velocity",
    "angular_velocity_covariance",
    "linear_acceleration",
    "linear_acceleration_covariance",
)
_MAVROS_VELOCITY = "raw/gps_vel"  # MAVROS leaves the vertical velocity of this topic at zero
Convert = Callable[[RawBatch], list[convert.Converted]]


class BagReader:
    """Samples of a recording. ``events`` holds what the conversion had to disregard, ``counters`` what was lost."""

    def __init__(self, path: Path | str, remaps: dict[str, str] | None = None) -> None:
        """Open a bag. Raises ``BagError`` if it cannot be read, is empty or has no IMU."""
        self.bag = Bag(Path(path))
        try:
            if not any(topic.count for topic in self.bag.topics.values()) and not self.bag.warnings:
                raise BagError(f"{path} holds no messages")
            self.topics = topic_map.map_topics(self.bag.topics, remaps or {})
        except BagError:
            self.bag.close()
            raise
        self.events: list[Event] = []
        self.counters: Counter[str] = Counter()

    def __enter__(self) -> "BagReader":
        return self

    def __exit__(self, *_: object) -> None:
        self.bag.close()

    @property
    def notices(self) -> list[str]:
        """What was assumed, damaged or left out, one sentence each; complete once all samples are read."""
        lost = [f"{count} messages were left out ({name})" for name, count in sorted(self.counters.items())]
        return self.topics.notices + self.bag.warnings + lost

    @property
    def imu_count(self) -> int:
        """Number of IMU messages that the bag announces; 0 if it does not say."""
        return self.topics.topics[topic_map.IMU].count

    def samples(self) -> Iterator[Sample]:
        """All samples in receive-time order; consecutive IMU messages come as one block."""
        inputs = {part: topic for part, topic in self.topics.topics.items() if part != topic_map.TRUTH}
        names = list(dict.fromkeys(topic.name for topic in inputs.values()))
        players: list[list[Convert]] = [[] for _ in names]
        for part, topic in inputs.items():
            if part != topic_map.IMU:
                players[names.index(topic.name)].append(self._converter(part, topic))
        imu = names.index(inputs[topic_map.IMU].name)
        decode_imu = self._imu_converter(inputs[topic_map.IMU])
        for batch in self.bag.batches(names):
            block, kept = decode_imu(batch.select(batch.topics == imu))
            rows = np.zeros(len(batch), np.int64)
            rows[batch.topics == imu] = kept
            others = np.flatnonzero(batch.topics != imu)
            samples = self._convert_others(batch, others, players)
            yield from _interleave(block, np.cumsum(rows)[others].tolist(), samples)

    def _convert_others(
        self, batch: RawBatch, others: np.ndarray, players: list[list[Convert]]
    ) -> list[tuple[Sample, ...]]:
        """What each message that is not from the IMU turns into."""
        out: list[tuple[Sample, ...]] = [()] * len(others)
        kinds = batch.topics[others]
        for index in np.unique(kinds).tolist():
            places = np.flatnonzero(kinds == index)
            messages = batch.select(others[places])
            for convert_batch in players[index]:
                for place, items in zip(places.tolist(), convert_batch(messages), strict=True):
                    out[place] += self._samples_of(items)
        return out

    def _samples_of(self, items: convert.Converted) -> tuple[Sample, ...]:
        self.events += [item for item in items if isinstance(item, Event)]
        return tuple(item for item in items if not isinstance(item, Event))

    def _converter(self, part: str, topic: Topic) -> Convert:
        """A function from a batch of messages of one topic to samples and events."""
        try:
            decode = Decoder(topic)
        except BagError as error:
            self.topics.notices.append(str(error))
            return lambda batch: self._lost(batch, "bag.unknown_type")
        adapter = _CONVERSIONS[part, topic.type]
        if part == topic_map.GNSS_VELOCITY and topic.name.endswith(_MAVROS_VELOCITY):
            adapter = convert.without_vertical(adapter)
        many = _MANY.get(topic.type)

        def convert_batch(batch: RawBatch) -> list[convert.Converted]:
            if many is not None and (samples := many(batch)) is not None:
                return samples
            return [self._convert_one(decode, adapter, batch.payload(i)) for i in range(len(batch))]

        return convert_batch

    def _convert_one(self, decode: Decoder, adapter: convert.Adapter, payload: bytes) -> convert.Converted:
        try:
            return adapter(decode(payload))
        except (BagError, TypeError, AttributeError):  # damaged bytes, or a definition unlike the known one
            self.counters["bag.damaged_message"] += 1
            return ()

    def _lost(self, batch: RawBatch, reason: str) -> list[convert.Converted]:
        self.counters[reason] += len(batch)
        return [()] * len(batch)

    def _imu_converter(self, topic: Topic) -> Callable[[RawBatch], tuple[ImuBlock, np.ndarray]]:
        """A function from a batch of IMU messages to a block, and which of the messages are in it (N,) 0 or 1."""
        decode, adapter = Decoder(topic), _CONVERSIONS[topic_map.IMU, topic.type]

        def convert_batch(batch: RawBatch) -> tuple[ImuBlock, np.ndarray]:
            found = columns(topic.type, batch, _IMU_FIELDS) if len(batch) and topic.type in LAYOUTS else None
            if found is not None and not _has_absent(found):
                block = ImuBlock(found["stamp_ns"], found["angular_velocity"], found["linear_acceleration"])
                return block, np.ones(len(batch), np.int64)
            items = [self._convert_one(decode, adapter, batch.payload(i)) for i in range(len(batch))]
            samples = [self._samples_of(item) for item in items]
            good = [s for item in samples for s in item if isinstance(s, ImuSample)]
            return _block(good), np.array([len(item) for item in samples], np.int64)

        return convert_batch


def _has_absent(found: dict[str, np.ndarray]) -> bool:
    """True if a message says with covariance[0] == -1 that it lacks one half."""
    halves = found["angular_velocity_covariance"], found["linear_acceleration_covariance"]
    return bool((halves[0][:, 0] == -1.0).any() or (halves[1][:, 0] == -1.0).any())


def _interleave(block: ImuBlock, before: list[int], others: list[tuple[Sample, ...]]) -> Iterator[Sample]:
    """Merge: item j of ``others`` comes after the first ``before[j]`` rows of ``block``."""
    stamps, gyro, accel = block.stamps_ns, block.gyro, block.accel
    done = 0
    for count, samples in zip(before, others, strict=True):
        if samples:
            if count > done:
                yield ImuBlock(stamps[done:count], gyro[done:count], accel[done:count])
                done = count
            yield from samples
    if done < len(block):
        yield ImuBlock(stamps[done:], gyro[done:], accel[done:])


def _block(samples: list[ImuSample]) -> ImuBlock:
    stamps = np.array([s.stamp_ns for s in samples], np.int64)
    gyro = np.array([s.gyro for s in samples], float).reshape(-1, 3)
    return ImuBlock(stamps, gyro, np.array([s.accel for s in samples], float).reshape(-1, 3))


def _many_magnetic(batch: RawBatch) -> list[convert.Converted] | None:
    """``convert.magnetic_field`` for a whole batch; None if its messages have to be decoded one by one."""
    found = columns("sensor_msgs/msg/MagneticField", batch, ("magnetic_field",))
    if found is None:
        return None
    stamps, fields = found["stamp_ns"].tolist(), found["magnetic_field"].tolist()
    return [(MagSample(stamp, tuple(field)),) for stamp, field in zip(stamps, fields, strict=True)]


def _many_pressure(batch: RawBatch) -> list[convert.Converted] | None:
    """``convert.fluid_pressure`` for a whole batch; None if its messages have to be decoded one by one."""
    found = columns("sensor_msgs/msg/FluidPressure", batch, ("fluid_pressure", "variance"))
    if found is None or len(np.unique(found["variance"])) > 1:
        return None
    variance, flaw = covariance.read_variance(found["variance"][0])
    if flaw:
        return None
    stamps, pressures = found["stamp_ns"].tolist(), found["fluid_pressure"].tolist()
    return [(PressureSample(stamp, value, variance),) for stamp, value in zip(stamps, pressures, strict=True)]


_MANY = {"sensor_msgs/msg/MagneticField": _many_magnetic, "sensor_msgs/msg/FluidPressure": _many_pressure}


def read_samples(path: Path | str, remaps: dict[str, str] | None = None) -> Iterator[Sample]:
    """All samples of a bag in receive-time order; see :class:`BagReader` for what was assumed or lost."""
    with BagReader(path, remaps) as reader:
        yield from reader.samples()
