"""Incomplete recordings: what is there is read, and what is missing or was not used is named."""

import errno
import io
import math
import shutil
import sqlite3
from contextlib import closing, redirect_stderr, redirect_stdout
from pathlib import Path

import pytest
from rosbags.rosbag2 import StoragePlugin

from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.bags import sqlite_file
from nav_pose_estimator.offline.bags.raw_messages import BagError
from nav_pose_estimator.offline.bags.reader import BagReader, read_samples
from nav_pose_estimator.offline.bags.storage import Bag
from nav_pose_estimator.offline.command_line import main
from nav_pose_estimator.offline.flights.recording import load
from nav_pose_estimator.offline.output_file import write_whole
from pieces import one_by_one
from small_bags import IMU, flight, write_bag


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


@pytest.mark.parametrize(("content", "why"), [(b"", "is empty"), (b"x" * 999, "is not an MCAP file")])
def test_a_part_that_cannot_be_read_is_left_out(bag, copy, content, why):
    (copy / "small_1.mcap").write_bytes(content)
    list_files(copy, "small.mcap", "small_1.mcap")
    with Bag(copy) as opened:
        assert len(opened.warnings) == 1
        assert why in opened.warnings[0]
        assert opened.warnings[0].endswith(": left out")
    assert flat(copy) == flat(bag)
    (copy / "small.mcap").write_bytes(b"")
    with pytest.raises(BagError, match=r"small\.mcap is empty$"):
        Bag(copy)


def test_a_database_that_was_cut_off_names_what_may_save_it(tmp_path):
    database = write_bag(tmp_path / "base", flight(1.0), storage=StoragePlugin.SQLITE3) / "base.db3"
    database.write_bytes(database.read_bytes()[:8192])
    with pytest.raises(BagError, match=r"is damaged or cut off .*: sqlite3 base\.db3 \.recover"):
        Bag(database)


def test_a_database_that_was_not_closed_must_lie_where_it_can_be_opened(tmp_path, monkeypatch):
    database = write_bag(tmp_path / "base", flight(1.0), storage=StoragePlugin.SQLITE3) / "base.db3"
    database.with_name("base.db3-wal").write_bytes(b"")
    monkeypatch.setattr(sqlite_file.os, "access", lambda path, mode: False)

    def refuse(*_, **__):
        raise sqlite3.OperationalError("unable to open database file")

    monkeypatch.setattr(sqlite_file.sqlite3, "connect", refuse)
    with pytest.raises(BagError, match=r"was not closed \(base\.db3-wal is beside it\): copy the bag"):
        Bag(database)


def test_a_database_without_payloads_says_what_is_wrong(tmp_path):
    database = write_bag(tmp_path / "base", flight(1.0), storage=StoragePlugin.SQLITE3) / "base.db3"
    with closing(sqlite3.connect(database)) as connection:
        connection.execute("ALTER TABLE messages RENAME COLUMN data TO payload")
        connection.commit()
    with pytest.raises(BagError, match=r"no readable IMU message: base\.db3 is damaged \(no such column"):
        load(database)


# --- what replay says when there is no solution ----------------------------------------------------------------------


def told(bag: Path, out: Path) -> tuple[int, str]:
    errors = io.StringIO()
    with redirect_stderr(errors), redirect_stdout(io.StringIO()):
        code = main(["replay", str(bag), "--method", "coast", "--out", str(out)])
    return code, errors.getvalue()


def test_a_bag_without_gnss_says_so(tmp_path):
    bag = write_bag(tmp_path / "bag", [m for m in flight(2.5) if not m[1].startswith("/gps")])
    code, errors = told(bag, tmp_path / "out")
    assert code == 2
    assert errors.startswith("note: the bag has no GNSS fix, without which there is no position\n")


def test_the_last_line_names_what_was_refused(tmp_path):
    messages = flight(2.5)
    for _, _, kind, message in messages:
        if kind == IMU:
            message.angular_velocity.z = math.nan
    code, errors = told(write_bag(tmp_path / "bag", messages), tmp_path / "out")
    assert code == 2
    assert "(imu.rejected.nan: 250 times)" in errors.splitlines()[-1].partition(" Refused: ")[2]


def test_a_link_to_itself_does_not_exist(tmp_path):
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    code, errors = told(tmp_path / "loop", tmp_path / "out")
    assert (code, errors) == (2, f"replay: {tmp_path / 'loop'} does not exist\n")


# --- a single file as output -----------------------------------------------------------------------------------------


def test_a_file_that_cannot_be_written_stays_as_it_was(tmp_path, monkeypatch):
    out = tmp_path / "parameters.yaml"
    out.write_text("old")
    write_whole(out, "new")
    assert out.read_text() == "new"

    def full(self, *args, **options):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_text", full)
    with pytest.raises(UserError, match=r"No space left on device; nothing was changed"):
        write_whole(out, "newer")
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("parameters.yaml", "new")]
