"""Serialization of many messages of one topic at once.

Messages without sequences and with constant strings (frame_id) all have the same length and layout in CDR. They are a
table of bytes with one row per message, which is filled by columns. The layout follows from the message definitions of
rosbags.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

STAMP = "header.stamp"
_HEADER = b"\x00\x01\x00\x00"  # plain CDR, little-endian
_CODES = {
    "bool": "u1",
    "byte": "u1",
    "char": "u1",
    "float32": "<f4",
    "float64": "<f8",
    **{f"{sign}int{8 * size}": f"<{sign or 'i'}{size}" for size in (1, 2, 4, 8) for sign in ("", "u")},
}


@cache
def typestore() -> Any:
    """The message definitions of ROS 2 Jazzy."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_JAZZY)


def pack(kind: str, count: int, fields: Mapping[str, Any]) -> np.ndarray:
    """Serialize ``count`` messages of type ``kind`` (package/msg/Name) to (count, length) uint8.

    ``fields`` by dotted path (``pose.pose.position``): a string, or numbers (), (count,) or (count, k) for all fields
    below the path in the order of the definition (a quaternion: x, y, z, w). ``header.stamp`` is in nanoseconds. Other
    fields are zero or empty. Raises ``KeyError`` for a path that the message does not have.
    """
    texts = {path: value for path, value in fields.items() if isinstance(value, str)}
    leaves, length = _layout(kind, texts)
    row = np.zeros(length, np.uint8)
    row[: len(_HEADER)] = np.frombuffer(_HEADER, np.uint8)
    for path, text in texts.items():
        place = next(leaf for leaf in leaves if leaf.path == path)
        data = text.encode() + b"\0"
        row[place.offset - 4 : place.offset + len(data)] = np.frombuffer(
            len(data).to_bytes(4, "little") + data, np.uint8
        )
    for leaf in leaves:
        if leaf.code == "text" and leaf.path not in texts:
            row[leaf.offset - 4] = 1  # length of an empty string with its terminating zero
    rows = np.tile(row, (count, 1))
    for path, values in fields.items():
        if path not in texts:
            _fill(rows, leaves, path, values)
    return rows


@dataclass(frozen=True, slots=True)
class _Leaf:
    """A number, a fixed array of numbers, or a string, and its position in the serialized message."""

    path: str
    code: str  # numpy code, or "text"
    count: int
    offset: int  # of a string: of its first character


def _layout(kind: str, texts: Mapping[str, str]) -> tuple[list[_Leaf], int]:
    """Leaves of ``kind`` in order, and the length of a message."""
    leaves, position = [], len(_HEADER)
    for path, code, count in _walk(kind, ""):
        if code == "text":
            position += -position % 4 + 4
            leaves.append(_Leaf(path, code, 1, position))
            position += len(texts.get(path, "").encode()) + 1
        else:
            # CDR aligns numbers to their size, relative to the end of the four-byte header
            size = np.dtype(code).itemsize
            position += -(position - len(_HEADER)) % size
            leaves.append(_Leaf(path, code, count, position))
            position += size * count
    if unknown := texts.keys() - {leaf.path for leaf in leaves if leaf.code == "text"}:
        raise KeyError(f"{kind} has no text {sorted(unknown)[0]!r}")
    return leaves, position


def _walk(kind: str, prefix: str) -> Iterator[tuple[str, str, int]]:
    """Yield (path, numpy code or "text", count) of all fields of ``kind``, depth first."""
    from rosbags.interfaces import Nodetype

    for name, (node, what) in typestore().fielddefs[kind][1]:
        path, count = prefix + name, 1
        if node == Nodetype.ARRAY:
            (node, what), count = what
        if node == Nodetype.NAME and count == 1:
            yield from _walk(what, path + ".")
        elif node == Nodetype.BASE and what[0] == "string" and count == 1:
            yield path, "text", 1
        elif node == Nodetype.BASE and what[0] in _CODES:
            yield path, _CODES[what[0]], count
        else:
            raise KeyError(f"{kind}: {path} has no fixed length; serialize its messages one by one")


def _fill(rows: np.ndarray, leaves: list[_Leaf], path: str, values: Any) -> None:
    if path.endswith(STAMP):
        seconds, nanoseconds = np.divmod(np.asarray(values, np.int64), 1_000_000_000)
        _fill(rows, leaves, path + ".sec", seconds)
        _fill(rows, leaves, path + ".nanosec", nanoseconds)
        return
    below = [leaf for leaf in leaves if leaf.path == path or leaf.path.startswith(path + ".")]
    if not below or any(leaf.code == "text" for leaf in below):
        raise KeyError(f"there are no numbers at {path!r}")
    width = sum(leaf.count for leaf in below)
    values = np.asarray(values)
    table = np.broadcast_to(values[:, None] if values.ndim == 1 and width == 1 else values, (len(rows), width))
    column = 0
    for leaf in below:
        part = np.ascontiguousarray(table[:, column : column + leaf.count], dtype=leaf.code)
        raw = part.view(np.uint8).reshape(len(rows), -1)
        rows[:, leaf.offset : leaf.offset + raw.shape[1]] = raw
        column += leaf.count
