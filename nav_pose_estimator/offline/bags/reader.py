"""Reader of a rosbag2 as a stream of samples in receive-time order, with IMU samples in blocks.

The conversions are those of the nodes (the message table); the most frequent message types are decoded many at a time.
The samples have the stamps of the message headers; the receive time only determines their order.
"""

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import ImuBlock, ImuSample, Sample
from nav_pose_estimator.engine.solutions import Event
from nav_pose_estimator.offline.bags import topic_map
from nav_pose_estimator.offline.bags.decoder import Decoder
from nav_pose_estimator.offline.bags.raw_messages import BagError, RawBatch, Topic
from nav_pose_estimator.offline.bags.storage import Bag
from nav_pose_estimator.ros.messages.cdr import CdrError, columns
from nav_pose_estimator.ros.messages.convert import Converted
from nav_pose_estimator.ros.messages.message_table import IMU, Source

EVENTS_KEPT = 1000  # largest number of stored events of one name
Convert = Callable[[RawBatch], list[Converted]]
UNREADABLE = (BagError, CdrError, ArithmeticError, AttributeError, LookupError, TypeError, ValueError)
"""Exceptions caused by damaged bytes, or by a definition in the bag that differs from the expected one."""


@dataclass(frozen=True, slots=True)
class SampleBatch:
    """A part of a recording: its IMU samples in columns, and the other samples between them.

    ``others[j]`` are the samples of one message, received after the first ``before[j]`` rows of ``imu``. ``aside``:
    messages that are not an input.
    """

    imu: ImuBlock
    before: list[int]
    others: list[tuple[Sample, ...]]
    aside: RawBatch

    def samples(self) -> Iterator[Sample]:
        """Yield all samples in order of receipt, those of the IMU in blocks."""
        stamps, gyro, accel = self.imu.stamps_ns, self.imu.gyro, self.imu.accel
        done = 0
        for count, samples in zip(self.before, self.others, strict=True):
            if samples:
                if count > done:
                    yield ImuBlock(stamps[done:count], gyro[done:count], accel[done:count])
                    done = count
                yield from samples
        if done < len(self.imu):
            yield ImuBlock(stamps[done:], gyro[done:], accel[done:])

    def pieces(self) -> tuple[np.ndarray, np.ndarray]:
        """First rows of the IMU blocks of ``samples``, and the rows after their last ones."""
        cuts = {count for count, samples in zip(self.before, self.others, strict=True) if samples}
        starts = np.array(sorted({0} | cuts - {len(self.imu)}))
        return starts, np.append(starts[1:], len(self.imu))


class BagReader:
    """Samples of a recording. ``counters``: numbers of lost messages, by reason.

    ``events``: events of the conversion about data that are not used, at most ``EVENTS_KEPT`` of each name;
    ``event_counts`` counts all of them.
    """

    def __init__(
        self, path: Path | str, remaps: dict[str, str] | None = None, parameters: Parameters | None = None
    ) -> None:
        """Open a bag; ``parameters`` determine how messages are read, as in a node.

        Raises ``BagError`` if the bag cannot be read, is empty or has no IMU.
        """
        self.bag = Bag(Path(path))
        try:
            if not any(topic.count for topic in self.bag.topics.values()) and not self.bag.warnings:
                raise BagError(f"{path} holds no messages")
            if not self.bag.topics:
                raise BagError(f"{path} holds no topics: it was cut off or damaged ({self.bag.warnings[0]})")
            self.topics = topic_map.map_topics(self.bag.topics, remaps or {}, parameters)
        except BagError:
            self.bag.close()
            raise
        self.events: list[Event] = []
        self.event_counts: Counter[str] = Counter()
        self.counters: Counter[str] = Counter()

    def __enter__(self) -> "BagReader":
        return self

    def __exit__(self, *_: object) -> None:
        self.bag.close()

    @property
    def notices(self) -> list[str]:
        """Sentences about assumptions, damage and omissions; complete after all samples have been read."""
        lost = [f"{count} messages were left out ({name})" for name, count in sorted(self.counters.items())]
        return self.topics.notices + self.bag.warnings + lost

    @property
    def imu_count(self) -> int:
        """Number of IMU messages according to the bag; 0 if unknown."""
        return self.topics.imu.count

    def samples(self) -> Iterator[Sample]:
        """Yield all samples in receive-time order, consecutive IMU messages as one block. Raises as ``batches``."""
        return (sample for batch in self.batches() for sample in batch.samples())

    def batches(self, aside: Topic | None = None) -> Iterator[SampleBatch]:
        """Yield all samples, about a chunk of the bag at a time, with the messages of another topic ``aside``.

        Raises ``BagError`` at the end of a recording without any angular rate.
        """
        topics, gyroscope = self.topics.topics, _GyroscopeWatch()
        names = list(dict.fromkeys(topic.name for topic in topics.values()))
        inputs = len(names)
        names += [] if aside is None else [aside.name]
        players: list[list[Convert]] = [[] for _ in names]
        for key, topic in topics.items():
            if key != IMU.topic:
                players[names.index(topic.name)].append(self._converter(topic, self.topics.sources[key]))
        imu = names.index(self.topics.imu.name)
        decode_imu = self._imu_converter(self.topics.imu, self.topics.sources[IMU.topic])
        for batch in self.bag.batches(names):
            block, kept = decode_imu(batch.select(batch.topics == imu))
            gyroscope.see(block)
            rows = np.zeros(len(batch), np.int64)
            rows[batch.topics == imu] = kept
            others = np.flatnonzero((batch.topics != imu) & (batch.topics < inputs))
            samples = self._convert_others(batch, others, players)
            yield SampleBatch(block, np.cumsum(rows)[others].tolist(), samples, batch.select(batch.topics >= inputs))
        if gyroscope.is_missing:
            name = self.topics.imu.name
            raise BagError(f"no message of {name} has an angular velocity (all zero), which navigation needs")

    def _convert_others(
        self, batch: RawBatch, others: np.ndarray, players: list[list[Convert]]
    ) -> list[tuple[Sample, ...]]:
        """Samples of each message that is not from the IMU."""
        out: list[tuple[Sample, ...]] = [()] * len(others)
        kinds = batch.topics[others]
        for index in np.flatnonzero(np.bincount(kinds)).tolist():
            places = np.flatnonzero(kinds == index)
            messages = batch.select(others[places])
            for convert_batch in players[index]:
                for place, items in zip(places.tolist(), convert_batch(messages), strict=True):
                    out[place] += self._samples_of(items)
        return out

    def _samples_of(self, items: Converted) -> tuple[Sample, ...]:
        if len(items) == 1 and not isinstance(items[0], Event):
            return (items[0],)
        for event in items:
            if isinstance(event, Event):
                self.event_counts[event.name] += 1
                if self.event_counts[event.name] <= EVENTS_KEPT:
                    self.events.append(event)
        return tuple([item for item in items if not isinstance(item, Event)])

    def _converter(self, topic: Topic, source: Source) -> Convert:
        """Function that converts a batch of messages of one topic to samples and events."""
        try:
            decode = Decoder(topic)
        except BagError as error:
            self.topics.notices.append(str(error))
            return lambda batch: self._lost(batch, "bag.unknown_type")

        def convert_batch(batch: RawBatch) -> list[Converted]:
            many = _convert_many(topic, source, batch)
            if isinstance(many, list):
                return many
            return [self._convert_one(decode, source, batch.payload(i)) for i in range(len(batch))]

        return convert_batch

    def _convert_one(self, decode: Decoder, source: Source, payload: bytes) -> Converted:
        try:
            return source.adapter(decode(payload))
        except UNREADABLE:
            self.counters["bag.damaged_message"] += 1
            return ()

    def _lost(self, batch: RawBatch, reason: str) -> list[Converted]:
        self.counters[reason] += len(batch)
        return [()] * len(batch)

    def _imu_converter(self, topic: Topic, source: Source) -> Callable[[RawBatch], tuple[ImuBlock, np.ndarray]]:
        """Function that converts a batch of N IMU messages to a block, and to (N,) 1 for each message in it, else 0."""
        decode = Decoder(topic)

        def convert_batch(batch: RawBatch) -> tuple[ImuBlock, np.ndarray]:
            block = _convert_many(topic, source, batch)
            if isinstance(block, ImuBlock):
                return block, np.ones(len(batch), np.int64)
            items = [self._convert_one(decode, source, batch.payload(i)) for i in range(len(batch))]
            samples = [self._samples_of(item) for item in items]
            good = [s for item in samples for s in item if isinstance(s, ImuSample)]
            return _block(good), np.array([len(item) for item in samples], np.int64)

        return convert_batch


class _GyroscopeWatch:
    """Detects an IMU without gyroscope: its forces vary, but its rates are exactly zero from begin to end."""

    def __init__(self) -> None:
        self._turned = self._changed = False
        self._first: np.ndarray | None = None

    def see(self, block: ImuBlock) -> None:
        """Evaluate the next block."""
        if self._turned or not len(block):
            return
        self._turned = bool(block.gyro.any())
        self._first = block.accel[0] if self._first is None else self._first
        self._changed = self._changed or bool((block.accel != self._first).any())

    @property
    def is_missing(self) -> bool:
        """Whether all rates so far are zero although the forces vary."""
        return self._changed and not self._turned


def _convert_many(topic: Topic, source: Source, batch: RawBatch) -> ImuBlock | list[Converted] | None:
    """Convert all messages of a batch at once; None if they must be decoded one by one."""
    if source.columns is None:
        return None
    found = columns(topic.type, batch, source.columns.fields)
    return None if found is None else source.columns.convert(found)


def _block(samples: list[ImuSample]) -> ImuBlock:
    stamps = np.array([s.stamp_ns for s in samples], np.int64)
    gyro = np.array([s.gyro for s in samples], float).reshape(-1, 3)
    return ImuBlock(stamps, gyro, np.array([s.accel for s in samples], float).reshape(-1, 3))


def read_samples(
    path: Path | str, remaps: dict[str, str] | None = None, parameters: Parameters | None = None
) -> Iterator[Sample]:
    """Yield all samples of a bag in receive-time order; :class:`BagReader` also gives assumptions and losses."""
    with BagReader(path, remaps, parameters) as reader:
        yield from reader.samples()
