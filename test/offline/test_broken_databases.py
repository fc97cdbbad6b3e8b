"""Databases of rosbag2 that break off: a full disk, a power cut, an unfinished copy."""

import pytest
from rosbags.rosbag2 import StoragePlugin

from nav_pose_estimator.engine.samples import ImuBlock
from nav_pose_estimator.offline.bags.raw_messages import BagError
from nav_pose_estimator.offline.bags.reader import BagReader
from nav_pose_estimator.offline.bags.unpacking import zstandard
from small_bags import flight, write_bag


def imu_count(reader: BagReader) -> int:
    return sum(len(s) for s in reader.samples() if isinstance(s, ImuBlock))


def test_a_truncated_database_gives_what_is_in_it(tmp_path):
    """GIVEN a database that breaks off (full disk) THEN its messages up to there are read, and it is left as it was."""
    bag = write_bag(tmp_path / "bag", flight(20.0), storage=StoragePlugin.SQLITE3)
    with BagReader(bag) as reader:
        whole = imu_count(reader)
    path = bag / "bag.db3"
    size = path.stat().st_size * 2 // 3
    path.write_bytes(path.read_bytes()[:size])
    with BagReader(bag) as reader:
        part = imu_count(reader)
        assert any(f"bag.db3 breaks off: {size} of" in text for text in reader.notices)
        assert not any("holds no message" in text for text in reader.notices)
    assert 0.5 * whole < part < 0.8 * whole
    assert path.stat().st_size == size


def test_a_database_without_its_first_pages_is_one_sentence(tmp_path):
    bag = write_bag(tmp_path / "bag", flight(20.0), storage=StoragePlugin.SQLITE3)
    path = bag / "bag.db3"
    path.write_bytes(path.read_bytes()[:4000])
    with pytest.raises(BagError, match=r"bag\.db3"):
        BagReader(bag)


def test_a_damaged_compressed_database_is_named_as_given(tmp_path):
    """GIVEN a compressed file that cannot be opened WHEN it is refused THEN not the unpacked copy is named."""
    bag = write_bag(tmp_path / "bag", flight(5.0), storage=StoragePlugin.SQLITE3)
    path = bag / "bag.db3"
    packed = path.with_name("bag.db3.zstd")
    packed.write_bytes(zstandard().compress(path.read_bytes()[:4000]))
    path.unlink()
    with pytest.raises(BagError) as caught:
        BagReader(packed)
    assert str(packed) in str(caught.value)
