"""Writer of a rosbag2 (mcap with zstd chunks, or sqlite3) from whole topics.

The files are written by rosbags, whose call per message is replaced by one per chunk, which is ten times faster.
"""

import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.rosbag2.storage_mcap import McapWriter
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Writer

from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.bags.cdr_packing import typestore
from nav_pose_estimator.offline.bags.unpacking import zstandard
from nav_pose_estimator.offline.output_folder import OutputFolder

MCAP, SQLITE3 = "mcap", "sqlite3"
PLAIN, FAST, SMALL = 0, 3, 19
"""Compression levels of zstd: none, fast, and small, which takes 15 times as long as fast and saves 10 %."""
CHUNK_BYTES = 1 << 20  # size of an mcap chunk, unpacked
METADATA_VERSION: Literal[9] = 9  # of rosbag2 in Jazzy

_NEVER = QosTime(2147483647, 4294967295)
LATCHED = Qos(
    QosHistory.KEEP_LAST,
    1,
    QosReliability.RELIABLE,
    QosDurability.TRANSIENT_LOCAL,
    _NEVER,
    _NEVER,
    QosLiveliness.AUTOMATIC,
    _NEVER,
    False,
)


@dataclass(frozen=True)
class Messages:
    """N messages of one topic: ``times_ns`` (N,) of receipt, and payloads as a table (N, length) or one by one."""

    topic: str
    kind: str  # package/msg/Name
    times_ns: np.ndarray
    payloads: np.ndarray | Sequence[bytes]
    latched: bool = False


def write_bag(
    path: Path,
    topics: Sequence[Messages],
    storage: str = MCAP,
    force: bool = False,
    level: int = FAST,
    notes: Mapping[str, str] | None = None,
) -> None:
    """Write ``topics`` as the rosbag2 ``path`` (a folder), in order of receipt; equal times in the order of ``topics``.

    ``level`` of zstd: ``PLAIN``, ``FAST`` or ``SMALL``. ``notes`` go into metadata.yaml. An existing bag is replaced
    only with ``force``, and only if this function has written it, because a recorded flight cannot be recovered. Raises
    ``UserError`` if the bag cannot be written.
    """
    if storage not in (MCAP, SQLITE3):
        raise UserError(f"there is no storage {storage!r}; choose {MCAP} or {SQLITE3}")
    try:
        with _folder(path, force) as work:
            write_new(work, [topics], storage, level, notes)
    except sqlite3.OperationalError as error:  # usually a full disk
        raise UserError(f"{path} cannot be written: {error}; nothing was changed") from None


def write_new(
    path: Path,
    stretches: Iterable[Sequence[Messages]],
    storage: str = MCAP,
    level: int = FAST,
    notes: Mapping[str, str] | None = None,
) -> None:
    """Write a bag to ``path``, which must not exist.

    The ``stretches`` are consecutive in time; each is written before the next one is requested from the iterator.
    """
    with _Writer(path, storage, level) as writer:
        for key, value in (notes or {}).items():
            writer.set_custom_data(key, value)
        connections: dict[tuple[str, str], int] = {}
        for topics in stretches:
            for item in topics:
                if (item.topic, item.kind) not in connections:
                    connections[item.topic, item.kind] = _connect(writer, item)
            _write(writer, topics, connections)


def check_room(path: Path, force: bool) -> None:
    """Raise ``UserError`` unless a bag can be written to ``path``, with ``force`` in place of an existing one."""
    _folder(path, force).check()


def _folder(path: Path, force: bool) -> OutputFolder:
    return OutputFolder(Path(path), "bag", replace=force, option="name")


def _connect(writer: "_Writer", item: Messages) -> int:
    profiles = [LATCHED] if item.latched else []
    return writer.add_connection(item.topic, item.kind, typestore=typestore(), offered_qos_profiles=profiles).id


def _write(writer: "_Writer", topics: Sequence[Messages], connections: Mapping[tuple[str, str], int]) -> None:
    times = np.concatenate([np.asarray(item.times_ns, np.int64) for item in topics] or [np.empty(0, np.int64)])
    owners = [connections[item.topic, item.kind] for item in topics]
    owner = np.repeat(owners, [len(item.times_ns) for item in topics])
    payloads = [payload for item in topics for payload in _split(item.payloads)]
    order = np.argsort(times, kind="stable")
    writer.write_sorted(owner[order], times[order], [payloads[i] for i in order.tolist()])


def _split(payloads: np.ndarray | Sequence[bytes]) -> Iterator[bytes]:
    if not isinstance(payloads, np.ndarray):
        yield from payloads
        return
    data, length = payloads.tobytes(), payloads.shape[1]
    for start in range(0, len(data), length):
        yield data[start : start + length]


class _McapStorage(McapWriter):
    """mcap storage that adds many messages to a chunk at once."""

    def write_sorted(self, owners: np.ndarray, times: np.ndarray, payloads: list[bytes]) -> None:
        lengths = np.fromiter(map(len, payloads), np.int64, len(payloads))
        heads = _record_heads(owners, times, lengths)
        ends = np.cumsum(lengths + heads.dtype.itemsize)
        first = 0
        while first < len(payloads):
            base = int(ends[first - 1]) if first else 0
            last = max(int(np.searchsorted(ends, base + CHUNK_BYTES)), first + 1)
            raw = heads[first:last].tobytes()
            size = heads.dtype.itemsize
            start = self.chunk.bio.tell()
            parts = [
                part for i in range(last - first) for part in (raw[i * size : (i + 1) * size], payloads[first + i])
            ]
            self.chunk.bio.write(b"".join(parts))
            offsets = ends[first:last] - lengths[first:last] - size - base + start
            for owner in np.unique(owners[first:last]).tolist():
                mine = owners[first:last] == owner
                pairs = zip(times[first:last][mine].tolist(), offsets[mine].tolist(), strict=True)
                self.chunk.msgs[owner].extend(pairs)
                self.channel_stats[owner] += int(mine.sum())
            self._note_times(int(times[first]), int(times[last - 1]))
            self.close_chunk()
            first = last

    def _note_times(self, first: int, last: int) -> None:
        self.message_start_time = min(self.message_start_time, first)
        self.message_end_time = max(self.message_end_time, last)
        self.chunk.message_start_time, self.chunk.message_end_time = first, last


def _record_heads(owners: np.ndarray, times: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """Heads of MCAP message records, before their data (https://mcap.dev/spec#message-op0x05)."""
    dtype = np.dtype(
        [("op", "u1"), ("length", "<u8"), ("channel", "<u2"), ("number", "<u4"), ("log", "<u8"), ("publish", "<u8")]
    )
    heads = np.zeros(len(times), dtype)
    heads["op"], heads["length"], heads["channel"] = 0x05, lengths + 22, owners
    heads["log"] = heads["publish"] = times
    return heads


class _SqliteStorage(Sqlite3Writer):
    """sqlite3 storage that inserts many messages with one call."""

    def write_sorted(self, owners: np.ndarray, times: np.ndarray, payloads: list[bytes]) -> None:
        rows = zip(owners.tolist(), times.tolist(), payloads, strict=True)
        self.cursor.executemany("INSERT INTO messages (topic_id, timestamp, data) VALUES(?, ?, ?)", rows)


class _Writer(Writer):
    """Writer of rosbags with storages that write many messages at once."""

    STORAGE_PLUGINS = {StoragePlugin.MCAP: _McapStorage, StoragePlugin.SQLITE3: _SqliteStorage}  # noqa: RUF012

    def __init__(self, path: Path, storage: str, level: int) -> None:
        super().__init__(path, version=METADATA_VERSION, storage_plugin=StoragePlugin[storage.upper()])
        self._level = level
        if storage == MCAP and level != PLAIN:
            self.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)

    def open(self) -> None:
        super().open()
        if isinstance(self.storage, _McapStorage) and self._level != PLAIN:
            self.storage.compressor = partial(zstandard().compress, level=self._level)

    def write_sorted(self, owners: np.ndarray, times: np.ndarray, payloads: list[bytes]) -> None:
        """Write messages in order of time; ``owners`` (N,) are their connection ids."""
        storage: Any = self.storage
        if not len(times):
            return
        storage.write_sorted(owners, times, payloads)
        for owner, count in zip(*np.unique(owners, return_counts=True), strict=True):
            self.counts[int(owner)] += int(count)
        self.min_timestamp = min(self.min_timestamp, int(times[0]))
        self.max_timestamp = max(self.max_timestamp, int(times[-1]))
