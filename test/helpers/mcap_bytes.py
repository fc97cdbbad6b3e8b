"""Writer of MCAP files byte by byte, so that a test determines all of their content."""

import struct
import zlib
from collections.abc import Callable
from pathlib import Path

from small_bags import STORE

MAGIC = b"\x89MCAP0\r\n"
Message = tuple[int, str, str, object]  # receive time, topic, type, message


def record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def text(value: str) -> bytes:
    return struct.pack("<I", len(value.encode())) + value.encode()


class Writer:
    """Schemas, channels and messages as records; messages loose or in chunks."""

    def __init__(self, messages: list[Message], encoding: str = "cdr") -> None:
        kinds = {kind: i for i, kind in enumerate(dict.fromkeys(m[2] for m in messages), 1)}
        self.channels = {topic: i for i, topic in enumerate(dict.fromkeys(m[1] for m in messages), 1)}
        kind_of = {topic: kind for _, topic, kind, _ in messages}
        self.head = b"".join(
            record(3, struct.pack("<H", i) + text(kind) + text("ros2msg") + text(self._definition(kind)))
            for kind, i in kinds.items()
        ) + b"".join(
            record(4, struct.pack("<HH", i, kinds[kind_of[topic]]) + text(topic) + text(encoding) + bytes(4))
            for topic, i in self.channels.items()
        )
        self.messages = messages

    @staticmethod
    def _definition(kind: str) -> str:
        return STORE.generate_msgdef(kind, ros_version=2)[0]

    def message(self, message: Message, time: int | None = None) -> bytes:
        stamp, topic, kind, content = message
        stamp = stamp if time is None else time % (1 << 64)
        raw = bytes(STORE.serialize_cdr(content, kind))
        return record(5, struct.pack("<HIQQ", self.channels[topic], 0, stamp, stamp) + raw)

    def loose(self, time: Callable[[int], int] | None = None) -> bytes:
        return b"".join(self.message(m, None if time is None else time(m[0])) for m in self.messages)

    def chunks(self, size: int, change: Callable[[int, bytes], bytes] = lambda i, chunk: chunk, **options) -> bytes:
        parts = [self.messages[i : i + size] for i in range(0, len(self.messages), size)]
        return b"".join(change(i, self._chunk(part, **options)) for i, part in enumerate(parts))

    def _chunk(self, part: list[Message], times: bool = True, head: bool = False, pack=None, name: str = "") -> bytes:
        body = (self.head if head else b"") + b"".join(self.message(m) for m in part)
        first, last = (part[0][0], part[-1][0]) if times else (0, 0)
        return chunk(body, first, last, body if pack is None else pack(body), name)


def chunk(body: bytes, first: int, last: int, packed: bytes, name: str = "", size: int | None = None) -> bytes:
    size = len(body) if size is None else size
    content = struct.pack("<QQQI", first, last, size, zlib.crc32(body)) + text(name)
    return record(6, content + struct.pack("<Q", len(packed)) + packed)


def write(path: Path, *parts: bytes, closed: bool = True) -> Path:
    end = record(0x0F, bytes(4)) + record(2, bytes(20)) + MAGIC if closed else b""
    path.write_bytes(MAGIC + record(1, text("ros2") + text("test")) + b"".join(parts) + end)
    return path
