"""Tables of numbers that grow with a flight, in memory while they are short, then in an unnamed temporary file.

The memory of file pages that have been read can be released, so that a flight of hours needs no more memory than one of
minutes.
"""

import mmap
from collections.abc import Iterator
from tempfile import TemporaryFile
from typing import IO

import numpy as np

from nav_pose_estimator.errors import UserError

Array = np.ndarray
IN_MEMORY = 1 << 15
"""Number of rows from which a table is in a file: eleven minutes at 50 Hz."""
AT_ONCE = 1 << 12
"""Number of rows that are processed together."""


class RowStore:
    """Rows of ``columns`` doubles, appended many at a time. Raises ``UserError`` for a full disk."""

    def __init__(self, columns: int) -> None:
        self._columns = columns
        self._parts: list[Array] = []
        self._held = 0
        self._file: IO[bytes] | None = None

    def append(self, rows: Array) -> None:
        """Add ``rows`` (N, columns)."""
        self._parts.append(rows)
        self._held += len(rows)
        if self._held >= (IN_MEMORY if self._file is None else AT_ONCE):
            self._write()

    def table(self) -> Array:
        """All rows (N, columns); read only if in a file."""
        if self._file is None:
            return np.concatenate([np.empty((0, self._columns)), *self._parts])
        self._write()
        pages = mmap.mmap(self._file.fileno(), 0, access=mmap.ACCESS_READ)
        return np.frombuffer(pages, float).reshape(-1, self._columns)

    def _write(self) -> None:
        try:
            if self._file is None:
                self._file = TemporaryFile(prefix="nav_pose_estimator_")  # noqa: SIM115  it lives as long as its rows
            for part in self._parts:
                self._file.write(np.ascontiguousarray(part, float).data)
            self._file.flush()
        except OSError as error:
            why = error.strerror or error
            raise UserError(f"there is no room for the solutions of a long flight ({why}): set TMPDIR") from None
        self._parts, self._held = [], 0


def pieces(count: int, size: int | None = None) -> Iterator[slice]:
    """Slices of ``size``, by default ``AT_ONCE``, that cover ``count`` rows."""
    size = size or AT_ONCE
    return (slice(start, min(start + size, count)) for start in range(0, count, size))


def release(table: Array) -> None:
    """Release the memory of a table in a file, or of a part of it; its pages are read again when needed."""
    owner: object = table
    while isinstance(owner, np.ndarray):
        owner = owner.base
    pages = owner.obj if isinstance(owner, memoryview) else owner
    if isinstance(pages, mmap.mmap) and hasattr(pages, "madvise"):  # not on every system
        pages.madvise(mmap.MADV_DONTNEED)
