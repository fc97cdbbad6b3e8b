"""Reader of MCAP files without their summary, so that truncated recordings are read like intact ones.

The file is scanned from record to record. The headers of chunks contain their time range, so that the scan reads only a
few bytes of each. A truncated chunk is decompressed as far as possible; one with a wrong checksum is left out and
reported.
"""

import heapq
import mmap
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from nav_pose_estimator.offline.bags import mcap_records as mcap
from nav_pose_estimator.offline.bags.raw_messages import (
    BagError,
    RawBatch,
    Topic,
    from_payloads,
    in_time_order,
    merge_overlapping,
    usable_times,
)
from nav_pose_estimator.offline.bags.unpacking import LARGEST_CHUNK, DamagedError, unpacked_limit

LOOSE_BATCH = 4096  # batch size of messages outside of chunks
_LONGEST = 1e5  # s: largest plausible time range of a chunk


class McapFile:
    """An .mcap file: its topics, and their messages in receive-time order. ``warnings`` lists what was damaged."""

    def __init__(self, path: Path) -> None:
        """Scan the file. Raises ``BagError`` if it is not an MCAP file."""
        self.path = path
        self._warnings: list[str] = []
        self._left_out: dict[int, tuple[str, float]] = {}  # offset of a damaged chunk -> why, seconds in it
        self._bad_records = 0
        self._directory = mcap.Directory()
        self._chunks: list[mcap.Chunk] = []
        loose: list[tuple[int, int, int, int]] = []  # messages outside chunks: time, channel, offset, length
        with path.open("rb") as file:
            if file.read(len(mcap.MAGIC)) != mcap.MAGIC:
                raise BagError(f"{path} is not an MCAP file: its first bytes are not those of the format")
            self._map = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        self._scan(loose)
        table = np.array(loose, np.uint64).reshape(-1, 4)
        self._loose = np.column_stack([usable_times(table[:, 0]), table[:, 1:].astype(np.int64)])
        self._refuse_bombs()
        self._look_into_chunks()
        self._settle_times()

    @property
    def topics(self) -> list[Topic]:
        """The topics of the file."""
        return self._directory.topics()

    @property
    def warnings(self) -> list[str]:
        """Sentences about damage found so far; reading can add some."""
        found = list(self._warnings)
        for why in dict.fromkeys(why for why, _ in self._left_out.values()):
            mine = [(offset, seconds) for offset, (reason, seconds) in self._left_out.items() if reason == why]
            many = "a damaged chunk was" if len(mine) == 1 else f"{len(mine)} damaged chunks were"
            lost = sum(seconds for _, seconds in mine)
            found.append(f"{self.path.name}: {many} left out, about {lost:.1f} s of data ({why}; byte {min(mine)[0]})")
        if self._bad_records:
            found.append(f"{self.path.name}: {self._bad_records} damaged records were left out")
        return found

    @property
    def span(self) -> tuple[int, int] | None:
        """Receive times [ns] of the first and last message according to the file; None without messages."""
        loose = self._loose[:, 0].tolist()
        starts = [chunk.start_ns for chunk in self._chunks] + loose
        ends = [chunk.end_ns for chunk in self._chunks] + loose
        return (min(starts), max(ends)) if starts else None

    def close(self) -> None:
        """Close the file."""
        self._map.close()

    def batches(self, names: list[str]) -> Iterator[RawBatch]:
        """Yield the messages of the topics ``names`` in receive-time order, about a chunk at a time."""
        channels = self._directory.channels
        wanted = {channel: names.index(name) for channel, (name, _, _) in channels.items() if name in names}
        parts = heapq.merge(self._loose_batches(wanted), self._chunk_batches(wanted), key=lambda part: part[0])
        yield from merge_overlapping(parts)

    def _loose_batches(self, wanted: dict[int, int]) -> Iterator[tuple[int, RawBatch]]:
        rows = self._loose[np.isin(self._loose[:, 1], list(wanted))]
        rows = rows[np.argsort(rows[:, 0], kind="stable")]
        for i in range(0, len(rows), LOOSE_BATCH):
            times, channels, offsets, lengths = rows[i : i + LOOSE_BATCH].T.tolist()
            places = zip(offsets, lengths, strict=True)
            payloads = [self._map[offset : offset + length] for offset, length in places]
            yield times[0], from_payloads(times, [wanted[channel] for channel in channels], payloads)

    def _chunk_batches(self, wanted: dict[int, int]) -> Iterator[tuple[int, RawBatch]]:
        for chunk in sorted(self._chunks, key=lambda chunk: chunk.start_ns):
            data = self._chunk_data(chunk)
            table = mcap.indexed_messages(data, chunk.message_places(self._map)) if chunk.index else None
            if table is None:
                table = np.array(list(mcap.messages(data, wanted)), np.uint64).reshape(-1, 4)
            yield chunk.start_ns, _batch(table[np.isin(table[:, 1], list(wanted))], wanted, data)

    def _scan(self, loose: list[tuple[int, int, int, int]]) -> None:
        """Scan the records of the file, and store the positions of chunks and ``loose`` messages."""
        data, position, size = self._map, len(mcap.MAGIC), len(self._map)
        while position + mcap.RECORD_HEAD.size <= size:
            opcode, length = mcap.RECORD_HEAD.unpack_from(data, position)
            start = position + mcap.RECORD_HEAD.size
            if data[position : position + len(mcap.MAGIC)] == mcap.MAGIC:
                return
            whole = start + length <= size
            if not whole:
                self._warnings.append(f"{self.path.name} breaks off: {size - position} bytes of an unfinished record")
            try:
                if opcode == mcap.CHUNK:
                    _release(data)
                    self._chunks.append(mcap.Chunk.parse(data, start, min(length, size - start), whole))
                elif whole and opcode == mcap.MESSAGE:
                    loose.append(self._loose_message(position))
                elif whole:
                    self._note(opcode, start, length)
            except struct.error:
                self._bad_records += 1
            position = start + length
        if position == size and not self._directory.statistics:
            self._warnings.append(f"{self.path.name} has no end marker: the recording was not closed")

    def _note(self, opcode: int, start: int, length: int) -> None:
        if opcode in (mcap.SCHEMA, mcap.CHANNEL, mcap.MESSAGE_INDEX, mcap.STATISTICS):
            self._directory.learn(opcode, self._map[start : start + length])
        if opcode == mcap.MESSAGE_INDEX and self._chunks:
            self._chunks[-1].index.append((start, length))

    def _loose_message(self, record: int) -> tuple[int, int, int, int]:
        _, size, channel, _, time = mcap.MESSAGE_HEAD.unpack_from(self._map, record)
        if size < mcap.MESSAGE_FIXED:
            raise struct.error
        self._directory.counts[channel] += 1
        return time, channel, record + mcap.MESSAGE_DATA, size - mcap.MESSAGE_FIXED

    def _refuse_bombs(self) -> None:
        packed = [chunk for chunk in self._chunks if chunk.compression and chunk.unpacked <= LARGEST_CHUNK]
        limit = unpacked_limit(sum(chunk.size for chunk in packed))
        if sum(chunk.unpacked for chunk in packed) > limit:
            raise BagError(f"{self.path} unpacks to more than {limit >> 20} MB: that is not a recording")

    def _look_into_chunks(self) -> None:
        """Read channels and message counts from inside the chunks, where the file lacks its summary or index."""
        directory = self._directory
        blind, counted = directory.is_blind, directory.statistics is not None
        for chunk in self._chunks:
            count = not (counted or chunk.index)
            if blind or count:
                self._bad_records += directory.look_into(self._chunk_data(chunk), count)

    def _settle_times(self) -> None:
        """Set the time range of chunks that lack it by their messages."""
        before = 0
        for chunk in self._chunks:
            if not chunk.has_times:
                rows = list(mcap.messages(self._chunk_data(chunk), None))
                times = usable_times(np.array([row[0] for row in rows], np.uint64))
                known = times[times > 0].tolist()
                chunk.start_ns, chunk.end_ns = (min(known), max(known)) if known else (before, before)
            before = chunk.start_ns

    def _chunk_data(self, chunk: mcap.Chunk) -> bytes:
        """Records of a chunk; empty if it is damaged."""
        try:
            data = chunk.records(self._map)
            _release(self._map)
            return data
        except DamagedError as error:
            seconds = (chunk.end_ns - chunk.start_ns) * 1e-9
            self._left_out[chunk.offset] = str(error), seconds if 0.0 <= seconds < _LONGEST else 0.0
            return b""


def _release(pages: mmap.mmap) -> None:
    """Release the memory of pages that have been read; they are read again when needed."""
    if hasattr(pages, "madvise"):  # not on every system
        pages.madvise(mmap.MADV_DONTNEED)


def _batch(table: np.ndarray, wanted: dict[int, int], data: bytes) -> RawBatch:
    table = table[table[:, 3] >= mcap.MESSAGE_FIXED]
    times = usable_times(table[:, 0])
    channels, offsets, lengths = table[:, 1:].astype(np.int64).T
    lookup = np.zeros(max(wanted, default=0) + 1, np.int64)
    for channel, index in wanted.items():
        lookup[channel] = index
    return in_time_order(RawBatch(times, lookup[channels], offsets, lengths - mcap.MESSAGE_FIXED, data))
