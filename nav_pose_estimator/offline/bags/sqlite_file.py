"""Reader of sqlite3 files of rosbag2 (.db3)."""

import contextlib
import os
import shutil
import sqlite3
import struct
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from nav_pose_estimator.offline.bags.raw_messages import BagError, RawBatch, Topic, from_payloads

ROWS_AT_ONCE = 8192
LARGEST_VALUE = 64 << 20  # bytes of a text or a message
_MAGIC = b"SQLite format 3\0"
_HEAD = struct.Struct(">16sH10xI")  # magic, size of a page, number of pages (https://sqlite.org/fileformat.html)


class SqliteFile:
    """A .db3 file: its topics, and their messages in receive-time order. ``warnings`` lists what was damaged."""

    def __init__(self, path: Path) -> None:
        """Open the file. Raises ``BagError`` if it is not a rosbag2 database."""
        self.path = path
        self.warnings: list[str] = []
        # a bag that was not closed has its last messages in a write-ahead log beside it; without such a log,
        # "immutable" permits reading from a read-only folder
        option = "mode=ro" if _log_of(path).exists() else "mode=ro&immutable=1"
        self._folder: TemporaryDirectory | None = None
        whole = self._with_all_pages()
        try:
            self._database = sqlite3.connect(f"{whole.resolve().as_uri()}?{option}", uri=True)
            self._database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LARGEST_VALUE)
            self._database.text_factory = lambda raw: raw.decode("utf-8", "replace")
            self._database.execute("PRAGMA trusted_schema = OFF")
            self._refuse_computed()
            self._topics = self._read_topics()
        except sqlite3.Error as error:
            raise BagError(_why(path, error)) from None

    @property
    def topics(self) -> list[Topic]:
        """The topics of the file."""
        return list(self._topics.values())

    @property
    def span(self) -> tuple[int, int] | None:
        """Receive times [ns] of the first and last message; None without messages."""
        query = "SELECT min(timestamp), max(timestamp) FROM messages WHERE typeof(timestamp) = 'integer'"
        try:
            first, last = self._database.execute(query).fetchone()
        except sqlite3.Error:  # reported when the messages are read
            return None
        return None if first is None else (first, last)

    def close(self) -> None:
        """Close the file."""
        self._database.close()
        if self._folder is not None:
            self._folder.cleanup()

    def _with_all_pages(self) -> Path:
        """The file; or, of one that breaks off, a copy as long as its header says, without which SQLite refuses it."""
        path, size = self.path, self.path.stat().st_size
        with path.open("rb") as content:
            head = content.read(_HEAD.size)
        if len(head) < _HEAD.size:
            return path
        magic, page, pages = _HEAD.unpack(head)
        length = pages * (65536 if page == 1 else page)
        # beyond a thousand times the size, a damaged header is more likely
        if magic != _MAGIC or not size < length < 1000 * size or _log_of(path).exists():
            return path
        try:
            self._folder = TemporaryDirectory(prefix="nav_pose_estimator_")
            copy = Path(self._folder.name, path.name)
            shutil.copyfile(path, copy)
            os.truncate(copy, length)
        except OSError:  # no room for a copy
            return path
        self.warnings.append(f"{path.name} breaks off: {size} of {length} bytes")
        return copy

    def batches(self, names: list[str]) -> Iterator[RawBatch]:
        """Yield the messages of the topics ``names`` in receive-time order."""
        wanted = {i: names.index(topic.name) for i, topic in self._topics.items() if topic.name in names}
        marks = ",".join("?" * len(wanted))
        query = f"SELECT timestamp, topic_id, data FROM messages WHERE topic_id IN ({marks}) ORDER BY timestamp, id"
        lost = 0
        try:
            for rows in self._rows(query, list(wanted)):
                times, topics, payloads = zip(*rows, strict=True)
                if {*map(type, times)} != {int} or {*map(type, payloads)} != {bytes}:
                    good = [row for row in rows if type(row[0]) is int and type(row[2]) is bytes]
                    lost += len(rows) - len(good)
                    times, topics, payloads = zip(*good, strict=True) if good else ((), (), ())
                yield from_payloads(list(times), [wanted[topic] for topic in topics], list(payloads))
        except sqlite3.Error as error:
            self._warn(f"{self.path.name} is damaged ({error}): the messages after that point are lost")
        if lost:
            self._warn(f"{self.path.name} is damaged: {lost} messages have no time or no content")

    def _rows(self, query: str, values: list[int]) -> Iterator[list[tuple]]:
        """The rows of ``query`` in batches. Raises ``sqlite3.Error`` behind the last one ahead of a damaged page."""
        count = 0
        try:
            cursor = self._database.execute(query, values)
            while rows := cursor.fetchmany(ROWS_AT_ONCE):
                count += len(rows)
                yield rows
        except sqlite3.Error as error:  # the batch in which it occurred is lost: read it again, row by row
            rest, damage = self._until_damage(f"{query} LIMIT -1 OFFSET {count}", values), error
        else:
            return
        if rest:
            yield rest
        raise damage

    def _until_damage(self, query: str, values: Sequence[int] = ()) -> list[tuple]:
        """The rows of ``query`` ahead of the first damaged page."""
        rows: list[tuple] = []
        with contextlib.suppress(sqlite3.Error):
            rows += iter(self._database.execute(query, values).fetchone, None)
        return rows

    def _warn(self, text: str) -> None:
        if text not in self.warnings:
            self.warnings.append(text)

    def _refuse_computed(self) -> None:
        """Reject views and generated columns, which a recording does not have, and whose evaluation may not end."""
        for name in ("topics", "messages"):
            (kind,) = self._database.execute("SELECT type FROM sqlite_master WHERE name = ?", (name,)).fetchone() or (
                "",
            )
            hidden = [row[6] for row in self._database.execute(f"PRAGMA table_xinfo({name})")]
            if kind != "table" or any(hidden):
                raise BagError(f"{self.path} is not a rosbag2 database: it has no plain table {name!r}")

    def _read_topics(self) -> dict[int, Topic]:
        definitions: dict[str, str] = {}
        if self._has_table("message_definitions"):
            query = "SELECT topic_type, encoded_message_definition FROM message_definitions"
            definitions = {k: v for k, v in self._database.execute(query) if isinstance(k, str) and isinstance(v, str)}
        rows = self._database.execute("SELECT id, name, type, serialization_format FROM topics").fetchall()
        good = [row for row in rows if isinstance(row[0], int) and all(isinstance(text, str) for text in row[1:])]
        if len(good) < len(rows):
            self.warnings.append(f"{self.path.name} is damaged: {len(rows) - len(good)} topics have no usable name")
        counts = self._counts()
        return {i: Topic(n, kind, counts.get(i, 0), enc, definitions.get(kind, "")) for i, n, kind, enc in good}

    def _counts(self) -> dict[int, int]:
        try:
            return dict(self._database.execute("SELECT topic_id, count(*) FROM messages GROUP BY topic_id"))
        except sqlite3.Error as error:
            self._warn(f"{self.path.name} is damaged ({error}): not all of its messages can be counted")
            return Counter(row[0] for row in self._until_damage("SELECT topic_id FROM messages NOT INDEXED"))

    def _has_table(self, name: str) -> bool:
        query = "SELECT 1 FROM sqlite_master WHERE type = 'table' AND name = ?"
        return self._database.execute(query, (name,)).fetchone() is not None


def _log_of(path: Path) -> Path:
    """The write-ahead log of a database."""
    return path.with_name(path.name + "-wal")


def _why(path: Path, error: sqlite3.Error) -> str:
    """Sentence on why the database ``path`` cannot be opened."""
    if _log_of(path).exists() and not os.access(path.parent, os.W_OK):
        return (
            f"{path} was not closed ({_log_of(path).name} is beside it): copy the bag to a folder that can be written"
        )
    if getattr(error, "sqlite_errorcode", None) == sqlite3.SQLITE_CORRUPT:
        recover = f"sqlite3 {path.name} .recover | sqlite3 NEW.db3"
        return f"{path} is damaged or cut off ({error}); this may save a part of it: {recover}"
    return f"{path} is not a rosbag2 database ({error})"
