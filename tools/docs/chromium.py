"""Rendering of HTML pages by headless Chromium, as pictures or as the document after its scripts have run."""

import shutil
import struct
import subprocess
import zlib
from pathlib import Path

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
_OPTIONS = ("--headless=new", "--no-sandbox", "--hide-scrollbars", "--enable-unsafe-swiftshader")
_FRAME = 150  # pixels at the foot of a picture that Chromium leaves unpainted, for the frame of the window
_BUDGET = "--virtual-time-budget=30000"  # ms of the page's own time, in which all of its scripts run


def _run(page: Path, size: tuple[int, int], dark: bool, *what: str) -> str:
    assert CHROMIUM is not None
    theme = f"--blink-settings=preferredColorScheme={0 if dark else 1}"
    window = f"--window-size={size[0]},{size[1]}"
    call = [CHROMIUM, *_OPTIONS, theme, _BUDGET, window, *what, page.resolve().as_uri()]
    return subprocess.run(call, capture_output=True, text=True, timeout=300, check=True).stdout


def picture(page: Path, path: Path, size: tuple[int, int], dark: bool = False) -> None:
    """Write a picture of ``page`` in a window of ``size`` (width, height) to ``path``, a PNG."""
    _run(page, (size[0], size[1] + _FRAME), dark, f"--screenshot={path.resolve()}")
    path.write_bytes(_upper_rows(path.read_bytes(), size[1]))


def _upper_rows(png: bytes, height: int) -> bytes:
    """The first ``height`` rows of a PNG with eight bits and without interlacing."""
    chunks, place = [], 8
    while place < len(png):
        (length,) = struct.unpack(">I", png[place : place + 4])
        chunks.append((png[place + 4 : place + 8], png[place + 8 : place + 8 + length]))
        place += 12 + length
    width, _, bits, color, *rest = struct.unpack(">IIBBBBB", chunks[0][1])
    assert (bits, rest[-1]) == (8, 0)
    rows = zlib.decompress(b"".join(data for name, data in chunks if name == b"IDAT"))
    kept = rows[: height * (1 + width * {2: 3, 6: 4}[color])]
    header = struct.pack(">IIBBBBB", width, height, bits, color, *rest)
    parts = [(b"IHDR", header), (b"IDAT", zlib.compress(kept, 9)), (b"IEND", b"")]
    return png[:8] + b"".join(_chunk(name, data) for name, data in parts)


def _chunk(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


def document(page: Path, width: int, dark: bool = False) -> str:
    """The document after all scripts have run."""
    return _run(page, (width, 1200), dark, "--dump-dom")
