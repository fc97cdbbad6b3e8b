"""Reading MCAP files without their index, so that a truncated recording reads like an intact one.

The file is scanned from record to record (https://mcap.dev/spec); chunks give their time range in their header, hence a
scan touches only a few bytes of each. A chunk that the recording broke off in is decompressed as far as it goes.
"""

import mmap
import struct
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from nav_pose_estimator.offline.bags.raw_messages import (
    BagError,
    RawBatch,
    Topic,
    from_payloads,
    in_time_order,
    merge_overlapping,
)

MAGIC = b"\x89MCAP0\r\n"
SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, STATISTICS = 0x03, 0x04, 0x05, 0x06, 0x07, 0x0B
RECORD_HEAD = struct.Struct("<BQ")
MESSAGE_HEAD = struct.Struct("<BQHIQ")  # opcode, length, channel, sequence, log time; publish time and data follow
MESSAGE_DATA = 31  # bytes before the data of a message record
MESSAGE_FIXED = 22  # bytes of the record's content that are not data
CHUNK_HEAD = struct.Struct("<QQQI")  # start time, end time, uncompressed size, crc
LOOSE_BATCH = 4096  # messages outside chunks are handed out in batches of this size


@dataclass(frozen=True, slots=True)
class _Chunk:
    start_ns: int
    end_ns: int
    compression: str
    offset: int
    size: int
    whole: bool


class McapFile:
    """One .mcap file: its topics, and their messages in receive-time order. ``warnings`` says what was damaged."""

    def __init__(self, path: Path) -> None:
        """Scan the file. Raises ``BagError`` for a file that is no MCAP."""
        self.path = path
        self.warnings: list[str] = []
        self._schemas: dict[int, tuple[str, str]] = {}
        self._channels: dict[int, tuple[str, int, str]] = {}
        self._counts: dict[int, int] = {}
        self._statistics: dict[int, int] | None = None
        self._chunks: list[_Chunk] = []
        self._loose: list[tuple[int, int, int, int]] = []  # messages outside chunks: time, channel, offset, length
        with path.open("rb") as file:
            if file.read(len(MAGIC)) != MAGIC:
                raise BagError(f"{path} is not an MCAP file: its first bytes are not those of the format")
            self._map = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        self._scan()
        if not self._channels and self._chunks:
            self._look_into_chunks()

    @property
    def topics(self) -> list[Topic]:
        """The topics of the file; several channels of one topic are one."""
        counts = self._counts if self._statistics is None else self._statistics
        found: dict[str, Topic] = {}
        for channel, (name, schema, encoding) in self._channels.items():
            kind, definition = self._schemas.get(schema, ("", ""))
            before = found[name].count if name in found else 0
            found[name] = Topic(name, kind, before + counts.get(channel, 0), encoding, definition)
        return list(found.values())

    def close(self) -> None:
        """Release the file."""
        self._map.close()

    def batches(self, names: list[str]) -> Iterator[RawBatch]:
        """Messages of the topics ``names`` in receive-time order, about a chunk at a time."""
        wanted = {c: names.index(name) for c, (name, _, _) in self._channels.items() if name in names}
        parts = sorted(self._chunks, key=lambda chunk: chunk.start_ns)
        yield from merge_overlapping(self._tables(parts, wanted))

    def _tables(self, chunks: list[_Chunk], wanted: dict[int, int]) -> Iterator[tuple[int, RawBatch]]:
        loose = [row for row in self._loose if row[1] in wanted]
        loose.sort(key=lambda row: row[0])
        for i in range(0, len(loose), LOOSE_BATCH):
            rows = loose[i : i + LOOSE_BATCH]
            payloads = [self._map[offset : offset + length] for _, _, offset, length in rows]
            yield rows[0][0], from_payloads([row[0] for row in rows], [wanted[row[1]] for row in rows], payloads)
        for chunk in chunks:
            data = self._chunk_data(chunk)
            yield chunk.start_ns, _batch(list(_messages(data, wanted)), wanted, data)

    def _scan(self) -> None:
        """Walk over the records of the file and note where everything is."""
        data, position, size = self._map, len(MAGIC), len(self._map)
        while position + RECORD_HEAD.size <= size:
            opcode, length = RECORD_HEAD.unpack_from(data, position)
            start = position + RECORD_HEAD.size
            if data[position : position + len(MAGIC)] == MAGIC:
                return
            whole = start + length <= size
            if not whole:
                self.warnings.append(f"{self.path.name} breaks off: {size - position} bytes of an unfinished record")
            if whole or opcode == CHUNK:
                self._note(opcode, start, min(length, size - start), position)
            position = start + length
        if position == size and not self._statistics:
            self.warnings.append(f"{self.path.name} has no end mark: the recording was not closed")

    def _note(self, opcode: int, start: int, length: int, record: int) -> None:
        if opcode == CHUNK:
            self._note_chunk(start, length)
        elif opcode == MESSAGE:
            _, size, channel, _, time = MESSAGE_HEAD.unpack_from(self._map, record)
            self._loose.append((time, channel, record + MESSAGE_DATA, size - MESSAGE_FIXED))
            self._counts[channel] = self._counts.get(channel, 0) + 1
        elif opcode == MESSAGE_INDEX:
            channel, size = struct.unpack_from("<HI", self._map, start)
            self._counts[channel] = self._counts.get(channel, 0) + size // 16
        elif opcode == STATISTICS:
            (size,) = struct.unpack_from("<I", self._map, start + 42)
            pairs = struct.iter_unpack("<HQ", self._map[start + 46 : start + 46 + size])
            self._statistics = dict(pairs)
        elif opcode in (SCHEMA, CHANNEL):
            self._learn(opcode, self._map[start : start + length])

    def _note_chunk(self, start: int, available: int) -> None:
        if available < CHUNK_HEAD.size + 12:
            return
        first, last, _, _ = CHUNK_HEAD.unpack_from(self._map, start)
        compression, position = _text(self._map, start + CHUNK_HEAD.size)
        (size,) = struct.unpack_from("<Q", self._map, position)
        position += 8
        room = start + available - position
        self._chunks.append(_Chunk(first, last, compression, position, min(size, room), size <= room))

    def _learn(self, opcode: int, content: bytes) -> None:
        if opcode == SCHEMA:
            name, position = _text(content, 2)
            _, position = _text(content, position)
            definition, _ = _text(content, position)
            self._schemas[struct.unpack_from("<H", content)[0]] = (name, definition)
        else:
            channel, schema = struct.unpack_from("<HH", content)
            name, position = _text(content, 4)
            encoding, _ = _text(content, position)
            self._channels[channel] = (name, schema, encoding)

    def _look_into_chunks(self) -> None:
        """Without a summary section the channels stand only inside the chunks."""
        self._counts = {}
        for chunk in self._chunks:
            data = self._chunk_data(chunk)
            for opcode, start, length in _records(data):
                if opcode == MESSAGE:
                    (channel,) = struct.unpack_from("<H", data, start)
                    self._counts[channel] = self._counts.get(channel, 0) + 1
                elif opcode in (SCHEMA, CHANNEL):
                    self._learn(opcode, data[start : start + length])

    def _chunk_data(self, chunk: _Chunk) -> bytes:
        data = self._map[chunk.offset : chunk.offset + chunk.size]
        try:
            return _decompress(data, chunk.compression, chunk.whole)
        except (ValueError, EOFError, OSError, RuntimeError) as error:
            raise BagError(f"{self.path}: a chunk at byte {chunk.offset} is damaged ({error})") from None
        except Exception as error:  # the zstd modules have an exception type of their own, one each
            if type(error).__name__ != "ZstdError":
                raise
            self._warn_once(f"{self.path.name}: a chunk at byte {chunk.offset} is damaged and was left out")
            return b""

    def _warn_once(self, text: str) -> None:
        if text not in self.warnings:
            self.warnings.append(text)


def _text(data: bytes | mmap.mmap, position: int) -> tuple[str, int]:
    (size,) = struct.unpack_from("<I", data, position)
    end = position + 4 + size
    return data[position + 4 : end].decode("utf-8", "replace"), end


def _records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Opcode, start and length of the content of each whole record."""
    position, size = 0, len(data)
    while position + RECORD_HEAD.size <= size:
        opcode, length = RECORD_HEAD.unpack_from(data, position)
        position += RECORD_HEAD.size
        if position + length > size:
            return
        yield opcode, position, length
        position += length


def _messages(data: bytes, wanted: dict[int, int]) -> Iterator[tuple[int, int, int, int]]:
    """(time, channel, offset, length) of each wanted message. The hot loop of reading: one unpack a record."""
    unpack, position, end = MESSAGE_HEAD.unpack_from, 0, len(data)
    head = RECORD_HEAD.size
    while position + MESSAGE_DATA <= end:
        opcode, length, channel, _, time = unpack(data, position)
        if position + head + length > end:
            return
        if opcode == MESSAGE and channel in wanted:
            yield time, channel, position + MESSAGE_DATA, length - MESSAGE_FIXED
        position += head + length


def _batch(rows: list[tuple[int, int, int, int]], wanted: dict[int, int], data: bytes) -> RawBatch:
    table = np.array(rows, np.int64).reshape(-1, 4)
    lookup = np.zeros(max(wanted, default=0) + 1, np.int64)
    for channel, index in wanted.items():
        lookup[channel] = index
    return in_time_order(RawBatch(table[:, 0], lookup[table[:, 1]], table[:, 2], table[:, 3], data))


def _decompress(data: bytes, compression: str, whole: bool) -> bytes:
    """The records of a chunk; of a broken chunk as many bytes as can be had."""
    if compression == "":
        return data
    if compression == "zstd":
        zstd = zstandard()
        return zstd.decompress(data) if whole else zstd.ZstdDecompressor().decompress(data)
    if compression == "lz4":
        try:
            import lz4.frame as lz4
        except ImportError:
            raise BagError("the bag is compressed with lz4: install the Python package lz4") from None
        return lz4.decompress(data) if whole else lz4.LZ4FrameDecompressor().decompress(data)
    raise BagError(f"the bag is compressed with {compression!r}; zstd, lz4 and no compression can be read")


def zstandard():
    """The zstd module: in the standard library from Python 3.14 on, a backport before."""
    if sys.version_info >= (3, 14):
        from compression import zstd
    else:
        try:
            from backports import zstd
        except ImportError:
            raise BagError("the bag is compressed with zstd: install the Python package backports.zstd") from None
    return zstd
