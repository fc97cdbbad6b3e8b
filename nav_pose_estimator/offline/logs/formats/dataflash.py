"""ArduPilot's binary DataFlash log. The format describes itself: FMT messages name the fields of all others.

https://ardupilot.org/copter/docs/logmessages.html; layout of FMT, format letters and multipliers as in AP_Logger's
LogStructure.h. A message is 0xA3 0x95, one byte of type, and as many bytes as its FMT says.
"""

import re
from array import array
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from nav_pose_estimator.offline.logs.formats.dataflash_tables import FIELDS_OF_FMT, Format, RawMessages, build
from nav_pose_estimator.offline.logs.formats.log_tables import LogTables

MAGIC = b"\xa3\x95"
FMT_TYPE, FMT_LENGTH = 0x80, 89
FMT_MAGIC = MAGIC + bytes([FMT_TYPE])
_HEADER = 3  # bytes of the header of a message
_TYPES = {
    "a": "(32,)<i2",
    "b": "i1",
    "B": "u1",
    "h": "<i2",
    "H": "<u2",
    "i": "<i4",
    "I": "<u4",
    "f": "<f4",
    "d": "<f8",
    "g": "<f2",
    "n": "S4",
    "N": "S16",
    "Z": "S64",
    "c": "<i2",
    "C": "<u2",
    "e": "<i4",
    "E": "<u4",
    "L": "<i4",
    "M": "u1",
    "q": "<i8",
    "Q": "<u8",
}
_SCALES = {"c": 1e-2, "C": 1e-2, "e": 1e-2, "E": 1e-2, "L": 1e-7}
_TEXT = re.compile(rb"[ -~]{1,4}\Z")


@dataclass
class _Walk:
    """Positions of the messages of each type, and damage between them."""

    formats: dict[int, Format] = field(default_factory=dict)
    starts: dict[int, array] = field(default_factory=dict)
    garbage: int = 0  # bytes
    holes: int = 0  # places
    cut: bool = False  # ends in the middle of a message


def read_dataflash(path: Path) -> LogTables:
    """Read a binary log. Raises ``BagError`` where it holds no messages."""
    data = path.read_bytes()
    walk = _walk(data)
    octets = np.frombuffer(data, np.uint8)
    messages = [_columns(octets, walk, kind) for kind in walk.formats if kind in walk.starts]
    notices = []
    if walk.garbage:
        where = "place" if walk.holes == 1 else "places"
        notices.append(f"{walk.garbage} bytes in {walk.holes} {where} of {path.name} are not messages: skipped")
    if walk.cut:
        notices.append(f"{path.name} ends in the middle of a message: read up to there")
    return build(path, messages, notices, walk.garbage)


def _walk(data: bytes) -> _Walk:
    """Follow the messages from header to header; after damage, continue at one that is followed by another."""
    walk = _Walk()
    lengths = [0] * 256
    lengths[FMT_TYPE] = FMT_LENGTH
    starts: list[array] = [array("q") for _ in range(256)]
    at, size = 0, len(data)
    while at + _HEADER <= size:
        length = lengths[data[at + 2]] if data[at] == 0xA3 and data[at + 1] == 0x95 else 0
        end = at + length
        if length and end <= size and (end == size or data[end] == 0xA3):
            _take(walk, data, lengths, starts, at)
            at = end
            continue
        at = _resume(walk, data, lengths, starts, at, length)
    walk.starts = {kind: places for kind, places in enumerate(starts) if len(places)}
    return walk


def _take(walk: _Walk, data: bytes, lengths: list[int], starts: list[array], at: int) -> None:
    """Store the position of the message at ``at``."""
    kind = data[at + 2]
    if kind == FMT_TYPE:
        _define(walk, lengths, data[at + _HEADER : at + FMT_LENGTH])
    starts[kind].append(at)


def _resume(walk: _Walk, data: bytes, lengths: list[int], starts: list[array], at: int, length: int) -> int:
    """Position to continue at after ``at``, where no message begins, or none that is followed by another."""
    after = _next_message(data, lengths, at + (1 if not length else _HEADER))
    if length and at + length > len(data) and after >= len(data):
        walk.cut = True
        return len(data)
    if length and after >= at + length:  # the message itself is whole, what follows is not
        _take(walk, data, lengths, starts, at)
        at += length
    if data[at:after].strip(b"\0\xff") or after < len(data):  # a file is filled up with zeros or ones
        walk.garbage += after - at
        walk.holes += 1
    return after


def _next_message(data: bytes, lengths: list[int], at: int) -> int:
    """First position from ``at`` on of a message that is followed by another message or the end of the file."""
    size = len(data)
    while (at := data.find(MAGIC, at)) >= 0 and at + _HEADER <= size:
        length = lengths[data[at + 2]]
        end = at + length
        if length and (end == size or data[end : end + 2] == MAGIC):
            return at
        at += 1
    return size


def _define(walk: _Walk, lengths: list[int], body: bytes) -> None:
    """Store an FMT message; an inconsistent one is left out."""
    kind, length = body[0], body[1]
    name, letters, columns = (body[a:b].split(b"\0")[0] for a, b in ((2, 6), (6, 22), (22, 86)))
    if length < _HEADER or not _TEXT.match(name) or not columns.isascii() or not letters.isascii():
        return
    form = Format(name.decode(), letters.decode(), tuple(columns.decode().split(",")) if columns else ())
    size = sum(np.dtype(_TYPES[letter]).itemsize for letter in form.letters if letter in _TYPES)
    readable = len(set(form.columns)) == len(form.letters) and set(form.letters) <= _TYPES.keys() and all(form.columns)
    if lengths[kind] and kind != FMT_TYPE:
        return  # already defined: a second definition that differs is damaged
    lengths[kind] = length if kind != FMT_TYPE else FMT_LENGTH
    if readable and size == length - _HEADER and kind != FMT_TYPE:
        walk.formats[kind] = form
    elif kind == FMT_TYPE:
        walk.formats[kind] = Format("FMT", "BBnNZ", FIELDS_OF_FMT)


def _columns(data: np.ndarray, walk: _Walk, kind: int) -> RawMessages:
    """The messages of one type in columns, scaled by their format letters."""
    form = walk.formats[kind]
    if not form.wanted:
        return RawMessages(form, np.empty(0, np.int64), {})
    places = np.frombuffer(walk.starts[kind], np.int64)
    dtype = np.dtype([(name, _TYPES[letter]) for name, letter in zip(form.columns, form.letters, strict=True)])
    rows = np.lib.stride_tricks.sliding_window_view(data, dtype.itemsize)[places + _HEADER]
    table = rows.view(dtype)[:, 0]
    columns = {}
    for name, letter in zip(form.columns, form.letters, strict=True):
        scale = _SCALES.get(letter)
        columns[name] = table[name] if scale is None else table[name].astype(np.float64) * scale
    return RawMessages(form, places, columns)
