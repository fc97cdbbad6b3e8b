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


def concatenate(first: RawBatch, second: RawBatch) -> RawBatch:
    """Both batches as one, sorted by receive time (stable: equal times keep their order in the file)."""
    # Only what is referenced moves into the new buffer, so a carried-over tail does not drag its chunk along.
    data = b"".join([first.payload(i) for i in range(len(first))])
    offsets = np.cumsum(first.lengths) - first.lengths
    joined = RawBatch(
        np.concatenate([first.times, second.times]),
        np.concatenate([first.topics, second.topics]),
        np.concatenate([offsets, second.offsets + len(data)]),
        np.concatenate([first.lengths, second.lengths]),
        data + bytes(second.data),
    )
    return in_time_order(joined)


def in_time_order(batch: RawBatch) -> RawBatch:
    """The batch sorted by receive time; itself when it is sorted already."""
    if len(batch) < 2 or bool(np.all(batch.times[1:] >= batch.times[:-1])):
        return batch
    return batch.select(np.argsort(batch.times, kind="stable"))


def merge_overlapping(batches: Iterable[tuple[int, RawBatch]]) -> Iterator[RawBatch]:
    """Batches in global time order, from pairs (earliest time in the batch, batch) sorted by that time.

    Messages that are later than the start of the next batch wait for it.
    """
    waiting: RawBatch | None = None
    for start_ns, batch in batches:
        batch = in_time_order(batch)
        if waiting is not None and len(waiting):
            ready = int(np.searchsorted(waiting.times, start_ns, side="right"))
            if ready:
                yield waiting.select(slice(0, ready))
            if ready < len(waiting):
                batch = concatenate(waiting.select(slice(ready, None)), batch)
        waiting = batch
    if waiting is not None and len(waiting):
        yield waiting
