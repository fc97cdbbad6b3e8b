"""Bags with changed messages, to imitate the recordings of other drivers."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer

from small_bags import STORE

Row = tuple[str, str, int, Any]  # topic, type, receive time [ns], message


def rows(bag: Path) -> list[Row]:
    """Every message of a bag."""
    with AnyReader([bag]) as reader:
        return [(c.topic, c.msgtype, t, reader.deserialize(raw, c.msgtype)) for c, t, raw in reader.messages()]


def write_rows(path: Path, messages: Iterable[Row]) -> Path:
    """A bag of these messages, in order of receive time."""
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections: dict[str, Any] = {}
        for topic, kind, time, message in sorted(messages, key=lambda row: row[2]):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(connections[topic], time, STORE.serialize_cdr(message, kind))
    return path


def rewrite(source: Path, target: Path, change: Callable[[Row], Iterable[Row]]) -> Path:
    """``source`` with each message replaced by what ``change`` makes of it."""
    return write_rows(target, [new for row in rows(source) for new in change(row)])
