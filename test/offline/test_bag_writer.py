"""Bags come back as they were written, in both storages; nothing that is not a bag is ever removed."""

import sqlite3
from pathlib import Path

import numpy as np
import pytest
from rosbags.interfaces import QosDurability
from rosbags.rosbag2 import Reader, StoragePlugin

from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.bags import writer
from nav_pose_estimator.offline.bags.cdr_packing import pack, typestore
from nav_pose_estimator.offline.bags.writer import MCAP, SMALL, SQLITE3, Messages, write_bag

COUNT = 20_000


def topics(count: int = COUNT) -> list[Messages]:
    """Two interleaved topics with packed messages, one latched message, one topic with sequences."""
    times = 1_000_000_000 + np.arange(count, dtype=np.int64) * 5_000_000
    noise = np.random.default_rng(1).standard_normal((count, 3))
    imu = pack("sensor_msgs/msg/Imu", count, {"header.stamp": times, "angular_velocity": noise})
    counts = pack("std_msgs/msg/UInt32", count, {"data": np.arange(count)})
    array = typestore().types["diagnostic_msgs/msg/DiagnosticArray"]
    header = typestore().types["std_msgs/msg/Header"](
        stamp=typestore().types["builtin_interfaces/msg/Time"](sec=1, nanosec=2), frame_id=""
    )
    message = array(header=header, status=[])
    diagnostics = [bytes(typestore().serialize_cdr(message, "diagnostic_msgs/msg/DiagnosticArray"))] * 2
    return [
        Messages("/imu", "sensor_msgs/msg/Imu", times, imu),
        Messages("/count", "std_msgs/msg/UInt32", times + 1_000_000, counts),
        Messages("/flag", "std_msgs/msg/Bool", times[:1], pack("std_msgs/msg/Bool", 1, {"data": True}), latched=True),
        Messages("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", times[:2], diagnostics),
    ]


@pytest.mark.parametrize(("storage", "level"), [(MCAP, 3), (MCAP, SMALL), (SQLITE3, 3)])
def test_messages_come_back_in_order_of_time(tmp_path: Path, storage: str, level: int) -> None:
    written = topics(2000 if level == SMALL else COUNT)
    write_bag(tmp_path / "bag", written, storage, level=level, notes={"who": "test"})
    with Reader(tmp_path / "bag") as bag:
        found = list(bag.messages())
        assert bag.message_count == sum(len(item.times_ns) for item in written)
        assert {c.topic: c.msgcount for c in bag.connections} == {t.topic: len(t.times_ns) for t in written}
        assert bag.start_time == written[0].times_ns[0]
        assert bag.end_time == written[1].times_ns[-1] + 1
    times = [time for _, time, _ in found]
    assert times == sorted(times)
    for item in written:
        mine = [(time, bytes(raw)) for connection, time, raw in found if connection.topic == item.topic]
        assert [time for time, _ in mine] == item.times_ns.tolist()
        assert [raw for _, raw in mine] == [bytes(payload) for payload in item.payloads]
    assert "who: test" in (tmp_path / "bag" / "metadata.yaml").read_text()


def test_latched_topics_say_so(tmp_path: Path) -> None:
    write_bag(tmp_path / "bag", topics(10))
    with Reader(tmp_path / "bag") as bag:
        qos = {connection.topic: connection.ext.offered_qos_profiles for connection in bag.connections}
    assert qos["/flag"][0].durability == QosDurability.TRANSIENT_LOCAL
    assert qos["/imu"] == []


@pytest.mark.parametrize("storage", [MCAP, SQLITE3])
def test_same_messages_same_bytes(tmp_path: Path, storage: str) -> None:
    for name in ("a", "b"):
        write_bag(tmp_path / name / "bag", topics(500), storage)
    first, second = (sorted((tmp_path / name / "bag").iterdir()) for name in ("a", "b"))
    assert [file.read_bytes() for file in first] == [file.read_bytes() for file in second]


def test_an_existing_bag_is_replaced_only_by_force(tmp_path: Path) -> None:
    path = tmp_path / "bag"
    write_bag(path, topics(10))
    with pytest.raises(UserError, match="exists already"):
        write_bag(path, topics(20))
    write_bag(path, topics(20), force=True)
    with Reader(path) as bag:
        assert bag.message_count == 43


def test_what_is_not_a_bag_is_never_removed(tmp_path: Path) -> None:
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "thesis.tex").write_text("years of work")
    (tmp_path / "file").write_text("a file")
    for path, text in (
        (tmp_path / "thesis", "holds 'thesis.tex', not from an earlier bag"),
        (tmp_path / "file", "is a file"),
        (tmp_path / "file" / "bag", "is a file"),
    ):
        with pytest.raises(UserError, match=text):
            write_bag(path, topics(10), force=True)
    assert (tmp_path / "thesis" / "thesis.tex").read_text() == "years of work"


def test_a_failure_leaves_no_half_bag(tmp_path: Path) -> None:
    broken = [Messages("/imu", "no_msgs/msg/Such", np.array([1]), [b"x"])]
    with pytest.raises(Exception, match="no_msgs"):
        write_bag(tmp_path / "bag", [*topics(10), *broken])
    assert not (tmp_path / "bag").exists()
    with pytest.raises(UserError, match="no storage 'hdf5'"):
        write_bag(tmp_path / "bag", topics(10), storage="hdf5")


FULL = {MCAP: OSError(28, "No space left on device"), SQLITE3: sqlite3.OperationalError("database or disk is full")}


@pytest.mark.parametrize("storage", [MCAP, SQLITE3])
@pytest.mark.parametrize("step", ["write_sorted", "close"])
def test_a_full_disk_leaves_the_earlier_bag(tmp_path: Path, monkeypatch, storage: str, step: str) -> None:
    write_bag(tmp_path / "bag", topics(10), storage)
    before = {file.name: file.read_bytes() for file in (tmp_path / "bag").iterdir()}

    def full(*_: object) -> None:
        raise FULL[storage]

    monkeypatch.setattr(writer._Writer.STORAGE_PLUGINS[StoragePlugin[storage.upper()]], step, full)
    with pytest.raises(UserError, match=r"cannot be written: .*; nothing was changed"):
        write_bag(tmp_path / "bag", topics(20), storage, force=True)
    assert {file.name: file.read_bytes() for file in (tmp_path / "bag").iterdir()} == before
    assert [path.name for path in tmp_path.iterdir()] == ["bag"]


def test_an_empty_bag(tmp_path: Path) -> None:
    write_bag(tmp_path / "bag", [])
    with Reader(tmp_path / "bag") as bag:
        assert bag.message_count == 0
