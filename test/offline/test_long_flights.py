"""What makes the memory of a replay independent of the length of the flight, and that nothing else depends on it."""

import dataclasses
import shutil
from pathlib import Path

import numpy as np
import pytest

from flight_bag import write_flight_bag
from nav_pose_estimator.core.filter.layout import OUT_COLUMNS, OUT_QUAT, OUT_VEL
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import GnssFix
from nav_pose_estimator.engine.solutions import Mode, NavBlock
from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.flights import methods, recording, row_store, tracks
from nav_pose_estimator.offline.flights.outages import Outage
from nav_pose_estimator.offline.flights.recording import load
from nav_pose_estimator.offline.flights.row_store import RowStore, pieces, release
from nav_pose_estimator.offline.flights.survey import GnssColumns
from nav_pose_estimator.offline.flights.tracks import Track, TrackRecorder
from nav_pose_estimator.offline.replay import files
from nav_pose_estimator.offline.replay import replay as replaying
from nav_pose_estimator.offline.replay.replay import replay
from nav_pose_estimator.offline.replay.solution_bag import write_solution


@pytest.fixture
def soon_in_files(monkeypatch):
    """Tables go to a file after a few rows, and are worked on a few at a time."""
    monkeypatch.setattr(row_store, "IN_MEMORY", 100)
    monkeypatch.setattr(row_store, "AT_ONCE", 37)


def rows(count: int) -> np.ndarray:
    return np.random.default_rng(1).normal(size=(count, 3))


@pytest.mark.parametrize("count", [0, 99, 100, 101, 350])
def test_a_table_is_the_same_in_memory_and_in_a_file(soon_in_files, count):
    """GIVEN rows that are appended in parts WHEN there are few or many THEN the table holds them all in order."""
    expected, store = rows(count), RowStore(3)
    for start in range(0, count, 7):
        store.append(expected[start : start + 7])
    table = store.table()
    assert table.flags.writeable == (count < 100), "in a file from the hundredth row on"
    np.testing.assert_array_equal(table, expected)
    release(table[:, 1:])
    np.testing.assert_array_equal(table, expected)


def test_no_room_for_the_file_is_one_sentence(soon_in_files, monkeypatch):
    def full(**_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(row_store, "TemporaryFile", full)
    with pytest.raises(UserError, match="No space left on device"):
        RowStore(3).append(rows(100))


def test_pieces_are_all_of_it(soon_in_files):
    assert [i for part in pieces(100) for i in range(100)[part]] == list(range(100))
    assert list(pieces(0)) == []


def recorded(seconds: float, back: float = 0.0) -> Track:
    """A track of 50 Hz; ``back``: by how much the clock goes back in the middle [s]."""
    recorder = TrackRecorder(0)
    count = round(50 * seconds)
    for i in range(0, count, 10):
        t = np.arange(i, i + 10) / 50.0 - (back if i >= count // 2 else 0.0)
        values = np.sin(np.outer(t, np.arange(1, OUT_COLUMNS + 1)))
        recorder.add(NavBlock(np.round(t * 1e9).astype(np.int64), values, Mode.AIDED, 0, np.zeros(3)))
    return recorder.track()


@pytest.mark.parametrize("back", [0.0, 3.0])
def test_a_track_in_a_file_says_what_one_in_memory_says(monkeypatch, back):
    """GIVEN a flight, also one whose clock goes back WHEN its track lies in a file THEN all it is asked is the same."""
    in_memory = recorded(20.0, back)
    monkeypatch.setattr(row_store, "IN_MEMORY", 100)
    monkeypatch.setattr(row_store, "AT_ONCE", 37)
    monkeypatch.setattr(tracks, "_TIMES_AT_ONCE", 50)
    in_file = recorded(20.0, back)
    times, lever = np.linspace(-1.0, 21.0, 333), np.array([1.0, 2.0, 3.0])
    np.testing.assert_array_equal(in_file.at(times), in_memory.at(times))
    np.testing.assert_array_equal(in_file.velocity_at(times), in_memory.at(times)[:, OUT_VEL:OUT_QUAT])
    np.testing.assert_array_equal(in_file.antenna_at(times, lever), in_memory.antenna_at(times, lever))
    for asked in (in_file, in_memory):
        np.testing.assert_array_equal(np.concatenate([piece.rows for piece in asked.pieces()]), in_memory.rows)
        np.testing.assert_array_equal(asked.thinned(400).rows, in_memory.rows[::3])
        assert asked.thinned(2000) is asked
    thinned = [np.concatenate([part.t for part in files.decimated(track, 7.0)]) for track in (in_file, in_memory)]
    np.testing.assert_array_equal(*thinned)


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    path = tmp_path_factory.mktemp("flight") / "circles_bag"
    write_flight_bag(path, 60.0, imu_hz=100.0)
    return path


def test_a_recording_that_is_not_held_replays_the_same(bag, tmp_path, monkeypatch):
    """GIVEN a bag WHEN it is read again instead of held and its tables lie in files THEN not a bit is different."""
    coasting = methods.apply(Parameters(), "coast")
    held = load(bag)
    first = replay(held, coasting, [Outage(40.0, 10.0)])
    monkeypatch.setattr(row_store, "IN_MEMORY", 100)
    monkeypatch.setattr(row_store, "AT_ONCE", 64)
    monkeypatch.setattr(replaying, "DRAWN", 500)
    monkeypatch.setattr(recording, "HELD_BYTES", 500_000)
    streamed = load(bag, hold=False)
    assert not isinstance(streamed.samples, list)
    assert (streamed.epoch_ns, streamed.duration, streamed.imu_count) == (held.epoch_ns, held.duration, held.imu_count)
    second = replay(streamed, coasting, [Outage(40.0, 10.0)])
    np.testing.assert_array_equal(second.track.rows, first.track.rows)
    np.testing.assert_array_equal(second.record.bias_history.rows, first.record.bias_history.rows)
    assert [e.end_error_m for e in second.errors] == [e.end_error_m for e in first.errors]
    assert len(second.drawn) <= 500 < len(second.track)
    for write in (files.write_csv, files.write_tum):
        for name, result in (("first", first), ("second", second)):
            write(tmp_path / name, result, 20.0)
        assert (tmp_path / "first").read_bytes() == (tmp_path / "second").read_bytes()
    assert messages(tmp_path / "bag_1", first) == messages(tmp_path / "bag_2", second)


def test_a_short_bag_is_read_only_once(bag, tmp_path, monkeypatch):
    """GIVEN a bag that was opened WHEN it is gone THEN its samples are there if it is short, as often as needed."""
    copy = Path(shutil.copytree(bag, tmp_path / "flight_bag"))
    short = load(copy, hold=False)
    monkeypatch.setattr(recording, "HELD_BYTES", 10_000)
    long = load(copy, hold=False)
    shutil.rmtree(copy)
    assert same(short.samples, load(bag).samples)
    assert same(short.samples, load(bag).samples)
    with pytest.raises(UserError):
        list(long.samples)


def same(samples, others) -> bool:
    """Whether two streams have the same samples, in the same blocks."""
    return all(a == b for a, b in zip(map(plain, samples), map(plain, others), strict=True))


def plain(sample) -> tuple:
    """A sample as bytes and numbers, which can be compared."""
    fields = (getattr(sample, field.name) for field in dataclasses.fields(sample))
    return type(sample), *(value.tobytes() if isinstance(value, np.ndarray) else value for value in fields)


def messages(path, result) -> list:
    """All messages of the solution bag of ``result``, in order."""
    from rosbags.highlevel import AnyReader

    write_solution(path, result, 10.0)
    with AnyReader([path]) as reader:
        found = [(time, connection.topic, raw) for connection, time, raw in reader.messages()]
    assert [time for time, _, _ in found] == sorted(time for time, _, _ in found)
    return sorted(found)


def test_a_stamp_that_no_clock_has_is_no_part_of_the_reference():
    """GIVEN fixes whose 64 bits of microseconds are damaged THEN the others are collected all the same."""
    stamps = (10**18, ((1 << 64) - 1) * 1000, 10**18 + 1)
    found = GnssColumns.of([GnssFix(stamp, 0.8, 0.1, 500.0) for stamp in stamps])
    assert found.fix_ns.tolist() == [10**18, 10**18 + 1]
