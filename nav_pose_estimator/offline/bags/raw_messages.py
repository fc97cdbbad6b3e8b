"""Serialized messages of a bag, many at a time: the common ground of the storage formats and the decoders."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from nav_pose_estimator.errors import UserError


class BagError(UserError):
    """A recording that cannot be read. The text is for the user."""


@dataclass(frozen=True, slots=True)
class Topic:
    """One topic of a bag. ``definition`` is the message definition that the bag carries, empty if it carries none."""

    name: str
    type: str  # package/msg/Name
    count: int
    encoding: str = "cdr"
    definition: str = ""


@dataclass(frozen=True, slots=True)
class RawBatch:
    """N serialized messages in receive-time order, all in one buffer.

    ``times`` (N,) int64 receive time [ns]; ``topics`` (N,) index into the list of names that was asked for;
    message i is ``data[offsets[i]:offsets[i] + lengths[i]]``.
    """

    times: np.ndarray
    topics: np.ndarray
    offsets: np.ndarray
    lengths: np.ndarray
    data: bytes

    def __len__(self) -> int:
        return len(self.times)

    def payload(self, i: int) -> bytes:
        """The bytes of message ``i``."""
        start = int(self.offsets[i])
        return self.data[start : start + int(self.lengths[i])]

    def select(self, chosen: np.ndarray | slice) -> "RawBatch":
        """The messages at ``chosen`` (index array, mask or slice); the buffer is shared."""
        return RawBatch(self.times[chosen], self.topics[chosen], self.offsets[chosen], self.lengths[chosen], self.data)


def from_payloads(times: list[int], topics: list[int], payloads: list[bytes]) -> RawBatch:
    """A batch from separate byte strings."""
    lengths = np.fromiter(map(len, payloads), np.int64, len(payloads))
    offsets = np.cumsum(lengths) - lengths
    return RawBatch(np.array(times, np.int64), np.array(topics, np.int64), offsets, lengths, b"".join(payloads))


def usable_times(stated: np.ndarray) -> np.ndarray:
    """Receive times (N,) int64 [ns] from those that a file states (N,) uint64.

    Zero and what is beyond the year 2262 (a negative time) cannot be one: such a message came when the one before did.
    """
    good = (stated > 0) & (stated < np.uint64(1 << 63))
    times = stated.astype(np.int64)
    if good.all():
        return times
    if not good.any():
        return np.zeros_like(times)
    last_good = np.maximum.accumulate(np.where(good, np.arange(len(times)), int(np.argmax(good))))
    return times[last_good]


def concatenate(batches: list[RawBatch]) -> RawBatch:
    """All batches as one, sorted by receive time (stable: equal times keep their order in the file)."""
    if len(batches) == 1:
        return in_time_order(batches[0])
    starts = np.cumsum([0, *(len(batch.data) for batch in batches[:-1])])
    joined = RawBatch(
        np.concatenate([batch.times for batch in batches]),
        np.concatenate([batch.topics for batch in batches]),
        np.concatenate([batch.offsets + start for batch, start in zip(batches, starts.tolist(), strict=True)]),
        np.concatenate([batch.lengths for batch in batches]),
        b"".join([batch.data for batch in batches]),
    )
    return in_time_order(joined)


def compact(batch: RawBatch) -> RawBatch:
    """The batch with a buffer of its own, so that the rest of a large one can go."""
    return from_payloads(batch.times.tolist(), batch.topics.tolist(), [batch.payload(i) for i in range(len(batch))])


def in_time_order(batch: RawBatch) -> RawBatch:
    """The batch sorted by receive time; itself when it is sorted already."""
    if len(batch) < 2 or bool(np.all(batch.times[1:] >= batch.times[:-1])):
        return batch
    return batch.select(np.argsort(batch.times, kind="stable"))


def merge_overlapping(batches: Iterable[tuple[int, RawBatch]]) -> Iterator[RawBatch]:
    """Batches in global time order, from pairs (earliest time in the batch, batch) sorted by that time.

    Messages that are later than the start of the next batch wait for it. They are sorted anew only when they have
    become twice as many, so that a file in which all batches overlap takes no more than N log N.
    """
    waiting: list[RawBatch] = []
    held = enough = 0
    for start_ns, batch in batches:
        if held and held >= enough:
            joined = concatenate(waiting)
            ready = int(np.searchsorted(joined.times, start_ns, side="right"))
            if ready:
                yield joined.select(slice(0, ready))
            waiting = [compact(joined.select(slice(ready, None)))] if ready < len(joined) else []
            held = len(joined) - ready
            enough = 2 * held
        if len(batch):
            waiting.append(batch)
            held += len(batch)
    if waiting:
        yield concatenate(waiting)
