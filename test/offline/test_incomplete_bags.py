"""Bags whose folder, names and metadata do not agree: what is there is read, and what is missing is named."""

import shutil
from pathlib import Path

import pytest
from rosbags.rosbag2 import StoragePlugin

from nav_pose_estimator.offline.bags.raw_messages import BagError
from nav_pose_estimator.offline.bags.reader import BagReader, read_samples
from nav_pose_estimator.offline.bags.storage import Bag
from pieces import one_by_one
from small_bags import flight, write_bag


def flat(path: Path) -> list[str]:
    return [str(sample) for sample in one_by_one(read_samples(path))]


@pytest.fixture(scope="module")
def bag(tmp_path_factory) -> Path:
    return write_bag(tmp_path_factory.mktemp("bags") / "small", flight(1.0))


@pytest.fixture
def copy(tmp_path, bag) -> Path:
    return shutil.copytree(bag, tmp_path / "copy")


def list_files(folder: Path, *names: str) -> None:
    text = "".join(f"    - {name}\n" for name in names)
    (folder / "metadata.yaml").write_text(f"rosbag2_bagfile_information:\n  relative_file_paths:\n{text}")


def test_a_part_that_is_missing_is_named_and_the_others_are_read(bag, copy):
    list_files(copy, "small.mcap", "small_1.mcap", "small_2.mcap")
    with Bag(copy) as opened:
        assert opened.warnings == [
            "copy lacks small_1.mcap and 1 more, listed in metadata.yaml: reading the files found in it"
        ]
    assert flat(copy) == flat(bag)


def test_a_file_that_was_renamed_is_read(bag, copy):
    (copy / "small.mcap").rename(copy / "my flight.mcap")
    with Bag(copy) as opened:
        assert "lacks small.mcap" in opened.warnings[0]
    assert flat(copy) == flat(bag)


def test_metadata_without_any_file_is_refused(copy):
    (copy / "small.mcap").unlink()
    with pytest.raises(BagError, match=r"lacks small\.mcap, listed in metadata\.yaml: it holds no recorded data"):
        Bag(copy)


def test_a_folder_of_bags_names_one_of_them(bag):
    with pytest.raises(BagError, match=r"give one of the bags below it: small"):
        Bag(bag.parent)


@pytest.mark.parametrize("name", ["flight.db3", "flight", "flight.bag.mcap.bak"])
def test_the_content_says_which_storage_it_is(tmp_path, bag, name):
    shutil.copy(bag / "small.mcap", tmp_path / name)
    assert flat(tmp_path / name) == flat(bag)


def test_a_database_with_the_name_of_an_mcap_is_read(tmp_path, bag):
    database = write_bag(tmp_path / "base", flight(1.0), storage=StoragePlugin.SQLITE3) / "base.db3"
    assert flat(database.rename(tmp_path / "base.mcap")) == flat(bag)


@pytest.mark.parametrize("kept", [8, 100])
def test_a_file_that_ends_before_its_first_topic_was_cut_off(copy, kept):
    file = copy / "small.mcap"
    file.write_bytes(file.read_bytes()[:kept])
    with pytest.raises(BagError, match=r"holds no topics: it was cut off or damaged"):
        BagReader(copy)
