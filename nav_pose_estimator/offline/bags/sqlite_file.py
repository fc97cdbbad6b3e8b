"""Reading rosbag2's sqlite3 files (.db3)."""

import sqlite3
from collections.abc import Iterator
from pathlib import Path

from nav_pose_estimator.offline.bags.raw_messages import BagError, RawBatch, Topic, from_payloads

ROWS_AT_ONCE = 8192


class SqliteFile:
    """One .db3 file: its topics, and their messages in receive-time order. ``warnings`` says what was damaged."""

    def __init__(self, path: Path) -> None:
        """Open the file. Raises ``BagError`` for a file that is no rosbag2 database."""
        self.path = path
        self.warnings: list[str] = []
        # A bag that was not closed keeps its last messages in a write-ahead log beside it; without one, "immutable"
        # lets sqlite read from a read-only place.
        option = "mode=ro" if path.with_name(path.name + "-wal").exists() else "mode=ro&immutable=1"
        try:
            self._database = sqlite3.connect(f"{path.resolve().as_uri()}?{option}", uri=True)
            self._topics = self._read_topics()
        except sqlite3.Error as error:
            raise BagError(f"{path} is not a rosbag2 database ({error})") from None

    @property
    def topics(self) -> list[Topic]:
        """The topics of the file."""
        return list(self._topics.values())

    def close(self) -> None:
        """Release the file."""
        self._database.close()

    def batches(self, names: list[str]) -> Iterator[RawBatch]:
        """Messages of the topics ``names`` in receive-time order."""
        wanted = {i: names.index(topic.name) for i, topic in self._topics.items() if topic.name in names}
        marks = ",".join("?" * len(wanted))
        query = f"SELECT timestamp, topic_id, data FROM messages WHERE topic_id IN ({marks}) ORDER BY timestamp, id"
        try:
            cursor = self._database.execute(query, list(wanted))
            while rows := cursor.fetchmany(ROWS_AT_ONCE):
                times, topics, payloads = zip(*rows, strict=True)
                yield from_payloads(list(times), [wanted[topic] for topic in topics], list(payloads))
        except sqlite3.Error as error:
            self.warnings.append(f"{self.path.name} is damaged ({error}): the messages after that place are lost")

    def _read_topics(self) -> dict[int, Topic]:
        definitions: dict[str, str] = {}
        if self._has_table("message_definitions"):
            query = "SELECT topic_type, encoded_message_definition FROM message_definitions"
            definitions = dict(self._database.execute(query))
        rows = self._database.execute("SELECT id, name, type, serialization_format FROM topics").fetchall()
        counts = self._counts()
        return {i: Topic(n, kind, counts.get(i, 0), enc, definitions.get(kind, "")) for i, n, kind, enc in rows}

    def _counts(self) -> dict[int, int]:
        try:
            return dict(self._database.execute("SELECT topic_id, count(*) FROM messages GROUP BY topic_id"))
        except sqlite3.Error as error:
            self.warnings.append(f"{self.path.name} is damaged ({error}): its messages cannot be counted")
            return {}

    def _has_table(self, name: str) -> bool:
        query = "SELECT 1 FROM sqlite_master WHERE type = 'table' AND name = ?"
        return self._database.execute(query, (name,)).fetchone() is not None
