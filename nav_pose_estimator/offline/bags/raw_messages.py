"""Batches of serialized messages of a bag: the interface between storage formats and decoders."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from nav_pose_estimator.errors import UserError


class BagError(UserError):
    """A recording cannot be read. The text is for the user."""


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic of a bag. ``definition`` is the message definition in the bag, empty if there is none."""

    name: str
    type: str  # package/msg/Name
    count: int
    encoding: str = "cdr"
    definition: str = ""


@dataclass(frozen=True, slots=True)
class RawBatch:
    """N serialized messages in receive-time order, all in one buffer.

    ``times`` (N,) int64: receive times [ns]. ``topics`` (N,): indices into the list of requested names. Message i is
    ``data[offsets[i]:offsets[i] + lengths[i]]``.
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
        """Batch of the messages at ``chosen`` (index array, mask or slice), which shares the buffer."""
        return RawBatch(self.times[chosen], self.topics[chosen], self.offsets[chosen], self.lengths[chosen], self.data)


def from_payloads(times: list[int], topics: list[int], payloads: list[bytes]) -> RawBatch:
    """Create a batch from separate byte strings."""
    lengths = np.fromiter(map(len, payloads), np.int64, len(payloads))
    offsets = np.cumsum(lengths) - lengths
    return RawBatch(np.array(times, np.int64), np.array(topics, np.int64), offsets, lengths, b"".join(payloads))


def usable_times(stated: np.ndarray) -> np.ndarray:
    """Receive times (N,) int64 [ns] from the ``stated`` times (N,) uint64 in a file.

    Zero, and times after the year 2262, which would be negative, are invalid and replaced by the preceding valid time.
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
    """Join batches to one, sorted by receive time; equal times keep their order in the file."""
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
    """Copy of the batch with its own buffer, so that a large shared one can be released."""
    return from_payloads(batch.times.tolist(), batch.topics.tolist(), [batch.payload(i) for i in range(len(batch))])


def in_time_order(batch: RawBatch) -> RawBatch:
    """The batch sorted by receive time; the same object if it is already sorted."""
    if len(batch) < 2 or bool(np.all(batch.times[1:] >= batch.times[:-1])):
        return batch
    return batch.select(np.argsort(batch.times, kind="stable"))


def merge_overlapping(batches: Iterable[tuple[int, RawBatch]]) -> Iterator[RawBatch]:
    """Yield batches in global time order, from pairs (earliest time in the batch, batch) sorted by that time.

    Messages later than the start of the next batch are held back. They are only sorted again when their number has
    doubled, so that a file in which all batches overlap takes O(N log N).
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
