"""Decompression of untrusted data, limited to the announced size and to plausible sizes of recordings."""

import sys
from pathlib import Path
from typing import Any

from nav_pose_estimator.offline.bags.raw_messages import BagError

LARGEST_CHUNK = 256 << 20  # bytes, unpacked
LARGEST_MESSAGE = 16 << 20  # bytes, unpacked
_FREE, _RATIO = 1 << 30, 100  # limit of the unpacked size of a file: bytes, plus a multiple of its packed size
_AT_ONCE = 1 << 20  # bytes that are unpacked at once
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


class DamagedError(Exception):
    """Data cannot be unpacked, or not to the announced size. The text is a clause."""


def unpack(data: bytes, compression: str, limit: int, whole: bool = True) -> bytes:
    """Decompress ``data`` to at most ``limit`` bytes; truncated data (not ``whole``) as far as possible.

    Raises ``DamagedError``, and ``BagError`` for a compression that is unknown or not installed.
    """
    unpacked = {"zstd": _unpack_zstd, "lz4": _unpack_lz4}.get(compression)
    if unpacked is None:
        raise BagError(f"the bag is compressed with {compression!r}; zstd, lz4 and no compression can be read")
    out, ended = unpacked(data, limit)
    if len(out) > limit:
        raise DamagedError(f"it unpacks to more than {limit} bytes")
    if whole and not ended:
        raise DamagedError("its compressed data end too early")
    return out


def _unpack_zstd(data: bytes, limit: int) -> tuple[bytes, bool]:
    """Content of all frames, up to just over ``limit`` bytes, and whether it is complete."""
    zstd, out = zstandard(), b""
    while data and len(out) <= limit:
        frame = zstd.ZstdDecompressor()
        try:
            out += frame.decompress(data, limit + 1 - len(out))
        except (zstd.ZstdError, MemoryError) as error:
            raise DamagedError(f"it cannot be unpacked ({error})") from None
        if not frame.eof:
            return out, False
        data = frame.unused_data
    return out, True


def _unpack_lz4(data: bytes, limit: int) -> tuple[bytes, bool]:
    try:
        import lz4.frame as lz4
    except ImportError:
        raise BagError("the bag is compressed with lz4: install the Python package lz4") from None
    frame = lz4.LZ4FrameDecompressor()
    try:
        return frame.decompress(data, max_length=limit + 1), frame.eof
    except (RuntimeError, EOFError, MemoryError, OverflowError, ValueError) as error:
        raise DamagedError(f"it cannot be unpacked ({error})") from None


def unpacked_limit(packed: int) -> int:
    """Largest unpacked size [bytes] of a file with ``packed`` compressed bytes; more is a decompression bomb."""
    return _FREE + _RATIO * packed


def unpack_file(source: Path, target: Path) -> str:
    """Unpack a zstd file; return a sentence about its damage, empty without any. Raises ``BagError``."""
    zstd = zstandard()
    limit, written = unpacked_limit(source.stat().st_size), 0
    try:
        with source.open("rb") as packed, zstd.open(packed, "rb") as unpacked, target.open("wb") as out:
            while part := unpacked.read(_AT_ONCE):
                written += len(part)
                if written > limit:
                    raise BagError(f"{source} unpacks to more than {limit >> 20} MB: that is not a recording")
                out.write(part)
    except (zstd.ZstdError, EOFError, MemoryError) as error:
        return f"{source.name} is damaged ({error}): reading what could be unpacked"
    except OSError as error:
        place = target.parent.parent
        raise BagError(f"{source} cannot be unpacked into {place} ({error.strerror}): set TMPDIR") from None
    return ""


def zstandard() -> Any:
    """Import the zstd module: of the standard library from Python 3.14 on, otherwise its backport."""
    if sys.version_info >= (3, 14):
        from compression import zstd
    else:
        try:
            from backports import zstd
        except ImportError:
            raise BagError("the bag is compressed with zstd: install the Python package backports.zstd") from None
    return zstd
