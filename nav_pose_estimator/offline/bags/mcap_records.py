"""Records of an MCAP file (https://mcap.dev/spec): their layout, and the topics and chunks that they describe.

All lengths in the file are checked; a record that is too short raises ``struct.error``.
"""

import mmap
import struct
import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from nav_pose_estimator.offline.bags.raw_messages import Topic
from nav_pose_estimator.offline.bags.unpacking import LARGEST_CHUNK, DamagedError, unpack

MAGIC = b"\x89MCAP0\r\n"
SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, STATISTICS = 0x03, 0x04, 0x05, 0x06, 0x07, 0x0B
RECORD_HEAD = struct.Struct("<BQ")
MESSAGE_HEAD = struct.Struct("<BQHIQ")  # opcode, length, channel, sequence, log time; publish time and data follow
MESSAGE_DATA = 31  # bytes before the data of a message record
MESSAGE_FIXED = 22  # bytes of the record's content that are not data
_HEADS = np.dtype(
    {
        "names": ["opcode", "length", "channel", "time"],
        "formats": ["u1", "<u8", "<u2", "<u8"],
        "offsets": [0, 1, 9, 15],
        "itemsize": MESSAGE_HEAD.size,
    }
)
CHUNK_HEAD = struct.Struct("<QQQI")  # start time, end time, uncompressed size, crc


@dataclass(slots=True)
class Chunk:
    """A chunk: the position in the file of the messages of a time range, compressed or not."""

    start_ns: int
    end_ns: int
    unpacked: int  # size of its records in bytes, according to its header
    crc: int  # checksum of these bytes; 0: unknown
    compression: str
    offset: int
    size: int
    whole: bool  # False: truncated
    index: list[tuple[int, int]] = field(default_factory=list)  # position and length of its message index records

    @classmethod
    def parse(cls, data: mmap.mmap, start: int, available: int, whole: bool) -> "Chunk":
        """Parse the chunk record whose content begins at ``start``; ``available`` bytes of it exist."""
        if available < CHUNK_HEAD.size + 12:
            raise struct.error
        first, last, unpacked, crc = CHUNK_HEAD.unpack_from(data, start)
        compression, position = read_text(data, start + CHUNK_HEAD.size)
        (size,) = struct.unpack_from("<Q", data, position)
        room = start + available - position - 8
        if room < 0 or (whole and size > room):
            raise struct.error
        return cls(first, last, unpacked, crc, compression, position + 8, min(size, room), whole)

    @property
    def has_times(self) -> bool:
        """Whether the header has a valid time range, which some writers leave at zero."""
        return 0 < self.start_ns <= self.end_ns < 1 << 63

    def message_places(self, data: mmap.mmap) -> np.ndarray:
        """Offsets (N,) int64 of the messages in its records, from the message index records."""
        entries = [data[start + 6 : start + length] for start, length in self.index]
        pairs = [np.frombuffer(entry[: len(entry) // 16 * 16], "<u8").reshape(-1, 2) for entry in entries]
        return np.concatenate(pairs)[:, 1].astype(np.int64)

    def records(self, data: mmap.mmap) -> bytes:
        """Its records, of a truncated chunk as many bytes as possible. Raises ``DamagedError``."""
        if self.unpacked > LARGEST_CHUNK:
            raise DamagedError(f"it claims to unpack to more than {LARGEST_CHUNK >> 20} MB")
        content = data[self.offset : self.offset + self.size]
        if self.compression:
            content = unpack(content, self.compression, self.unpacked, self.whole)
        if self.whole and len(content) != self.unpacked:
            raise DamagedError("its size is not the one it states")
        if self.whole and self.crc and zlib.crc32(content) != self.crc:
            raise DamagedError("its checksum does not match")
        return content


class Directory:
    """Channels of a file, and the numbers of their messages."""

    def __init__(self) -> None:
        self.channels: dict[int, tuple[str, int, str]] = {}  # id -> topic, schema, encoding
        self.statistics: dict[int, int] | None = None  # messages of each channel, from the end of a closed file
        self.counts: Counter[int] = Counter()  # messages of each channel, by counting
        self._schemas: dict[int, tuple[str, str]] = {}

    @property
    def is_blind(self) -> bool:
        """Whether there are messages of channels that no record outside the chunks describes."""
        counted = self.counts if self.statistics is None else self.statistics
        return not self.channels or not set(counted) <= set(self.channels)

    def topics(self) -> list[Topic]:
        """Topics of the file; several channels of one topic are joined."""
        counts = self.counts if self.statistics is None else self.statistics
        found: dict[str, Topic] = {}
        for channel, (name, schema, encoding) in self.channels.items():
            kind, definition = self._schemas.get(schema, ("", ""))
            before = found[name].count if name in found else 0
            found[name] = Topic(name, kind, before + counts.get(channel, 0), encoding, definition)
        return list(found.values())

    def learn(self, opcode: int, content: bytes) -> None:
        """Store the content of a schema, channel, message index or statistics record."""
        if opcode == SCHEMA:
            name, position = read_text(content, 2)
            _, position = read_text(content, position)
            definition, _ = read_text(content, position)
            self._schemas[struct.unpack_from("<H", content)[0]] = (name, definition)
        elif opcode == CHANNEL:
            channel, schema = struct.unpack_from("<HH", content)
            name, position = read_text(content, 4)
            encoding, _ = read_text(content, position)
            self.channels[channel] = (name, schema, encoding)
        elif opcode == MESSAGE_INDEX:
            channel, size = struct.unpack_from("<HI", content)
            self.counts[channel] += size // 16
        elif opcode == STATISTICS:
            (size,) = struct.unpack_from("<I", content, 42)
            found = dict(struct.iter_unpack("<HQ", content[46 : 46 + size]))
            self.statistics = found if any(found.values()) else None

    def look_into(self, content: bytes, count: bool) -> int:
        """Store the records of a chunk, and ``count`` its messages; return the number of damaged records."""
        damaged = 0
        for opcode, start, length in records(content):
            try:
                if opcode == MESSAGE and count:
                    self.counts[struct.unpack_from("<H", content, start)[0]] += 1
                elif opcode in (SCHEMA, CHANNEL):
                    self.learn(opcode, content[start : start + length])
            except struct.error:
                damaged += 1
        return damaged


def read_text(data: bytes | mmap.mmap, position: int) -> tuple[str, int]:
    """Read a string with its length in front of it; return the string and the position after it."""
    (size,) = struct.unpack_from("<I", data, position)
    end = position + 4 + size
    if end > len(data):
        raise struct.error
    return data[position + 4 : end].decode("utf-8", "replace"), end


def records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, start and length of the content of each complete record."""
    position, size = 0, len(data)
    while position + RECORD_HEAD.size <= size:
        opcode, length = RECORD_HEAD.unpack_from(data, position)
        position += RECORD_HEAD.size
        if position + length > size:
            return
        yield opcode, position, length
        position += length


def indexed_messages(data: bytes, offsets: np.ndarray) -> np.ndarray | None:
    """Table (N, 4) uint64 of what ``messages`` yields for all channels, from the ``offsets`` in an index.

    The offsets are only used if the messages there, with records of other kinds in between, fill the data without gaps;
    None for an incorrect index.
    """
    positions = np.sort(offsets)  # np.unique takes ten times as long
    if (positions[1:] == positions[:-1]).any():
        positions = np.unique(positions)
    if not len(positions) or positions[-1] + MESSAGE_DATA > len(data) or positions[0] < 0:
        return None
    heads = np.lib.stride_tricks.sliding_window_view(np.frombuffer(data, np.uint8), MESSAGE_HEAD.size)[positions]
    table = np.ascontiguousarray(heads).view(_HEADS)[:, 0]
    lengths = table["length"].astype(np.int64)
    if (table["opcode"] != MESSAGE).any() or (table["length"] > len(data)).any():
        return None
    begins, ends = np.append(positions, len(data)), np.append(0, positions + RECORD_HEAD.size + lengths)
    for gap in np.flatnonzero(begins != ends).tolist():
        if not _is_without_message(data, int(ends[gap]), int(begins[gap])):
            return None
    columns = table["time"], table["channel"], positions + MESSAGE_DATA, lengths
    return np.column_stack([column.astype(np.uint64) for column in columns])


def _is_without_message(data: bytes, position: int, end: int) -> bool:
    """Whether there are only complete records of other kinds between ``position`` and ``end``."""
    while position < end:
        if position + RECORD_HEAD.size > end:
            return False
        opcode, length = RECORD_HEAD.unpack_from(data, position)
        if opcode == MESSAGE:
            return False
        position += RECORD_HEAD.size + length
    return position == end


def messages(data: bytes, wanted: dict[int, int] | None) -> Iterator[tuple[int, int, int, int]]:
    """Yield (time, channel, offset, length of the record) of each message of the channels ``wanted``; None: of all.

    This loop dominates the time of reading; it unpacks once per record.
    """
    unpack_head, position, end = MESSAGE_HEAD.unpack_from, 0, len(data)
    head = RECORD_HEAD.size
    while position + MESSAGE_DATA <= end:
        opcode, length, channel, _, time = unpack_head(data, position)
        if position + head + length > end:
            return
        if opcode == MESSAGE and (wanted is None or channel in wanted):
            yield time, channel, position + MESSAGE_DATA, length
        position += head + length
