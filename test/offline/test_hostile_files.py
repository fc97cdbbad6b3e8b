"""Damaged and hostile recordings end in what can be read, or in one sentence."""

import io
import os
import random
import shutil
import sqlite3
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import numpy as np
import pytest
from backports import zstd
from rosbags.rosbag2 import CompressionMode, StoragePlugin

import mcap_bytes
from nav_pose_estimator.engine.samples import ImuBlock
from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.bags import unpacking
from nav_pose_estimator.offline.bags.raw_messages import BagError, from_payloads, merge_overlapping, usable_times
from nav_pose_estimator.offline.bags.reader import BagReader, read_samples
from nav_pose_estimator.offline.bags.storage import Bag
from nav_pose_estimator.offline.command_line import main
from nav_pose_estimator.offline.flights.recording import load
from nav_pose_estimator.offline.terminal import LONGEST, printable
from pieces import one_by_one
from small_bags import EPOCH_NS, flight, write_bag


def flat(path: Path) -> list[str]:
    return [str(sample) for sample in one_by_one(read_samples(path))]


def imu_rows(path: Path) -> int:
    return sum(len(sample) for sample in read_samples(path) if isinstance(sample, ImuBlock))


def replay(bag: Path, out: Path) -> tuple[int, str]:
    errors = io.StringIO()
    with redirect_stderr(errors), redirect_stdout(io.StringIO()):
        code = main(["replay", str(bag), "--method", "coast", "--out", str(out)])
    return code, errors.getvalue()


# --- mutations -------------------------------------------------------------------------------------------------------

FORMS = {
    "mcap": {},
    "zstd_chunks": {"compression": CompressionMode.STORAGE},
    "zstd_file": {"compression": CompressionMode.FILE},
    "zstd_messages": {"compression": CompressionMode.MESSAGE},
    "db3": {"storage": StoragePlugin.SQLITE3},
    "db3_messages": {"storage": StoragePlugin.SQLITE3, "compression": CompressionMode.MESSAGE},
}
LENGTHS = (b"\xff" * 8, bytes(8), b"\xff" * 7 + b"\x7f", b"\x00\x00\x00\x80\x00\x00\x00\x00", b"\xff" * 4, bytes(4))


def mutate(data: bytearray, generator: random.Random) -> bytearray:
    """One to thirty changes: bits, lengths, holes, insertions, an early end; half of them where the structure is."""
    for _ in range(generator.choice((1, 1, 2, 5, 30))):
        place = generator.randrange(len(data) if generator.random() < 0.6 else min(600, len(data)))
        match generator.randrange(5):
            case 0:
                data[place] ^= 1 << generator.randrange(8)
            case 1:
                value = generator.choice(LENGTHS)
                data[place : place + len(value)] = value
            case 2:
                del data[place : place + generator.randrange(1, 2000)]
            case 3:
                data[place:place] = generator.randbytes(generator.randrange(1, 50))
            case 4:
                del data[max(place, 1) :]
        data = data or bytearray(b"x")
    return data


@pytest.mark.parametrize("form", FORMS)
def test_mutated_recordings_end_with_results_or_one_sentence(tmp_path, form):
    """Fifty seeded mutations of each form, through the command line."""
    good = write_bag(tmp_path / "good", flight(2.0), **FORMS[form])
    generator = random.Random(form)
    outcomes = set()
    for i in range(50):
        bag = tmp_path / "bag"
        shutil.rmtree(bag, ignore_errors=True)
        shutil.copytree(good, bag)
        files = sorted(bag.iterdir())
        chosen = generator.choice([path for path in files for _ in range(1 if path.suffix == ".yaml" else 4)])
        chosen.write_bytes(mutate(bytearray(chosen.read_bytes()), generator))
        if generator.random() < 0.3:
            (bag / "metadata.yaml").unlink()
        code, errors = replay(bag, tmp_path / "out")
        outcomes.add("never aligned" in errors)  # in two seconds; all files are written
        assert code == 2, f"mutation {i}: {errors}"
        assert errors.isascii() or errors.replace("\n", "").isprintable()
        assert errors.splitlines()[-1].startswith("replay: ")
    assert outcomes == {True, False}


# --- what stands in the place of a file ------------------------------------------------------------------------------


def test_pipes_and_devices_are_no_recordings(tmp_path):
    (tmp_path / "bag").mkdir()
    os.mkfifo(tmp_path / "bag" / "bag.mcap")
    for path in (tmp_path / "bag", tmp_path / "bag" / "bag.mcap", Path("/dev/zero")):
        code, errors = replay(path, tmp_path / "out")
        assert (code, errors.count("\n")) == (2, 1)


def test_a_ros_1_bag_is_named_with_what_converts_it(tmp_path):
    bag = tmp_path / "flight.bag"
    bag.write_bytes(b"#ROSBAG V2.0\n" + bytes(100))
    with pytest.raises(BagError, match=r"ROS 1 bag.*rosbags-convert --src flight\.bag --dst flight "):
        Bag(bag)
    converted = mcap_bytes.Writer(flight(1.0), encoding="ros1")
    with pytest.raises(BagError, match=r"ROS 1 messages.*rosbags-convert"):
        Bag(mcap_bytes.write(tmp_path / "bag.mcap", converted.head, converted.loose()))


@pytest.mark.parametrize("text", ["[" * 100_000, "a: &a [1]\nb: *a", "rosbag2_bagfile_information: 7", "\x00"])
def test_hostile_metadata_is_no_metadata(tmp_path, mcap_bag, text):
    bag = tmp_path / "bag"
    shutil.copytree(mcap_bag, bag)
    (bag / "metadata.yaml").write_text(text)
    with Bag(bag) as opened:
        assert any("no usable metadata.yaml" in warning for warning in opened.warnings)
    assert flat(bag) == flat(mcap_bag)


def test_a_file_that_is_listed_often_is_read_once(tmp_path, mcap_bag):
    bag = tmp_path / "bag"
    shutil.copytree(mcap_bag, bag)
    names = "".join("    - small.mcap\n" for _ in range(5000))
    (bag / "metadata.yaml").write_text(f"rosbag2_bagfile_information:\n  relative_file_paths:\n{names}")
    assert flat(bag) == flat(mcap_bag)


def test_a_sidecar_that_makes_no_sense_is_one_sentence(tmp_path, mcap_bag):
    shutil.copytree(mcap_bag, tmp_path / "x_bag")
    bad = ("[" * 100_000, '{"gnss_latency_est_s": "a"}', '{"bag": [1]}', '{"flight_window_s": [1, null]}', "{")
    for text in (*bad, '{"gnss_latency_est_s": NaN}', '{"bag": {"stamp_offset_s": 1e999}}', "\x00"):
        (tmp_path / "x.json").write_text(text)
        with pytest.raises(UserError, match=r"x\.json"):
            load(tmp_path / "x_bag")


# --- sqlite ----------------------------------------------------------------------------------------------------------


def database(tmp_path: Path, *statements: str) -> Path:
    bag = write_bag(tmp_path / "bag", flight(2.0), storage=StoragePlugin.SQLITE3) / "bag.db3"
    with sqlite3.connect(bag) as connection:
        for statement in statements:
            connection.execute(statement)
    connection.close()
    return bag


ENDLESS = (
    "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT i AS id, 1 AS topic_id, i AS timestamp"
)


@pytest.mark.parametrize(
    "statements",
    [
        ("ALTER TABLE messages RENAME TO m", f"CREATE VIEW messages AS {ENDLESS}, x'00' AS data FROM n"),
        ("ALTER TABLE messages RENAME TO m", "CREATE VIEW messages AS SELECT * FROM m"),
        ("ALTER TABLE messages ADD COLUMN more GENERATED ALWAYS AS (zeroblob(1000000000))",),
        ("DROP TABLE topics",),
    ],
)
def test_views_and_computed_columns_are_refused(tmp_path, statements):
    with pytest.raises(BagError, match="no plain table"):
        Bag(database(tmp_path, *statements))


@pytest.mark.parametrize(
    "statement",
    [
        "UPDATE messages SET timestamp = 'noon' WHERE id % 10 = 0",
        "UPDATE messages SET data = 17 WHERE id % 10 = 0",
        "UPDATE messages SET timestamp = 1e300 WHERE id % 10 = 0",
        "UPDATE topics SET name = x'ff00' WHERE name = '/baro'",
    ],
)
def test_values_of_the_wrong_type_are_left_out_and_said(tmp_path, statement):
    with BagReader(database(tmp_path, statement)) as reader:
        samples = list(reader.samples())
        assert any("is damaged" in text for text in reader.notices)
    assert samples


# --- bombs -----------------------------------------------------------------------------------------------------------


def test_a_chunk_never_unpacks_to_more_than_it_says(tmp_path):
    writer = mcap_bytes.Writer(flight(1.0))
    bomb = zstd.compress(bytes(1 << 28))
    for size in (1000, (1 << 28) - 1, 1 << 40, (1 << 64) - 1):
        chunk = mcap_bytes.chunk(b"", EPOCH_NS, EPOCH_NS + 1, bomb, "zstd", size)
        file = mcap_bytes.write(tmp_path / "bag.mcap", writer.head, writer.loose(), chunk)
        with BagReader(file) as reader:
            assert sum(len(s) for s in reader.samples() if isinstance(s, ImuBlock)) == 100
            assert any("a damaged chunk was left out" in text for text in reader.notices)


def test_many_bombs_are_no_recording(tmp_path):
    writer = mcap_bytes.Writer(flight(1.0))
    bomb = zstd.compress(bytes(200 << 20))
    chunk = mcap_bytes.chunk(b"", EPOCH_NS, EPOCH_NS + 1, bomb, "zstd", 200 << 20)
    with pytest.raises(BagError, match="not a recording"):
        Bag(mcap_bytes.write(tmp_path / "bag.mcap", writer.head, *[chunk] * 20))


def test_a_compressed_file_that_is_a_bomb_leaves_no_copy(tmp_path, monkeypatch):
    monkeypatch.setattr(unpacking, "_FREE", 1 << 20)
    monkeypatch.setenv("TMPDIR", str(tmp_path / "scratch"))
    monkeypatch.setattr("tempfile.tempdir", None)
    (tmp_path / "scratch").mkdir()
    (tmp_path / "bag.mcap.zstd").write_bytes(zstd.compress(bytes(100 << 20)))
    with pytest.raises(BagError, match="not a recording"):
        Bag(tmp_path / "bag.mcap.zstd")
    assert list((tmp_path / "scratch").iterdir()) == []


def test_a_message_that_is_a_bomb_is_left_out(tmp_path):
    rows = flight(1.0)
    bag = write_bag(tmp_path / "bag", rows, storage=StoragePlugin.SQLITE3, compression=CompressionMode.MESSAGE)
    with sqlite3.connect(bag / "bag.db3") as connection:
        connection.execute("UPDATE messages SET data = ? WHERE id % 3 = 0", (zstd.compress(bytes(1 << 27)),))
    connection.close()
    with BagReader(bag) as reader:
        samples = list(reader.samples())
        assert any("compressed messages cannot be unpacked" in text for text in reader.notices)
    assert samples


@pytest.mark.parametrize("line", ["geometry_msgs/Point[100000000] points", "x" * 300_000, "uint8[9999999999999] a"])
def test_a_definition_with_a_huge_array_is_left_out(tmp_path, monkeypatch, line):
    monkeypatch.setattr(mcap_bytes.Writer, "_definition", staticmethod(lambda kind: f"{line}\n"))
    writer = mcap_bytes.Writer(flight(1.0))
    with Bag(mcap_bytes.write(tmp_path / "bag.mcap", writer.head, writer.loose())) as bag:
        assert {topic.definition for topic in bag.topics.values()} == {""}
        assert any("is too large and was left out" in text for text in bag.warnings)


# --- MCAP ------------------------------------------------------------------------------------------------------------

PACKERS = {"none": (None, ""), "zstd": (zstd.compress, "zstd")}


@pytest.mark.parametrize("packer", PACKERS)
def test_a_damaged_chunk_is_left_out_and_said(tmp_path, packer):
    """GIVEN a flipped bit in the third of ten chunks THEN the messages of the nine others are read."""
    pack, name = PACKERS[packer]
    messages = [m for m in flight(4.0) if m[1] == "/imu/data_raw"]
    writer = mcap_bytes.Writer(messages)

    def flip(i: int, chunk: bytes) -> bytes:
        damaged = bytearray(chunk)
        damaged[len(chunk) * 2 // 3] ^= 0x10 if i == 2 else 0
        return bytes(damaged)

    file = mcap_bytes.write(tmp_path / "bag.mcap", writer.head, writer.chunks(40, flip, pack=pack, name=name))
    with BagReader(file) as reader:
        stamps = np.concatenate([s.stamps_ns for s in reader.samples() if isinstance(s, ImuBlock)])
        (told,) = [text for text in reader.notices if "left out" in text]
    whole = np.array([m[0] for m in messages])
    np.testing.assert_array_equal(stamps, np.delete(whole, np.arange(80, 120)))
    assert "a damaged chunk was left out, about 0.4 s of data" in told


@pytest.mark.parametrize("cut", [0.2, 0.5, 0.9, 1.0])
def test_a_file_without_summary_and_index_is_read_to_the_end(tmp_path, mcap_bag, cut):
    """Schemas and channels inside the chunks only, as a recorder that was cut off leaves it."""
    messages = flight()
    data = mcap_bytes.Writer(messages).chunks(50, head=True)
    file = mcap_bytes.write(tmp_path / "bag.mcap", data[: int(cut * len(data))], closed=False)
    got, wanted = flat(file), flat(mcap_bag)
    assert abs(len(got) - cut * len(wanted)) < 60
    assert got == wanted[: len(got)]
    with BagReader(file) as reader:
        assert reader.imu_count > 0


@pytest.mark.parametrize("options", [{"times": False}, {"times": False, "head": True}])
def test_chunks_that_state_no_times_are_read_in_order(tmp_path, mcap_bag, options):
    messages = flight()
    writer = mcap_bytes.Writer(messages)
    assert flat(mcap_bytes.write(tmp_path / "bag.mcap", writer.head, writer.chunks(20, **options))) == flat(mcap_bag)


@pytest.mark.parametrize("time", [lambda t: 0, lambda t: -t, lambda t: t if t % 7 else 0, lambda t: -1 - t % 1000])
def test_receive_times_that_cannot_be_leave_the_order_of_the_file(tmp_path, mcap_bag, time):
    writer = mcap_bytes.Writer(flight())
    file = mcap_bytes.write(tmp_path / "bag.mcap", writer.head, writer.loose(time))
    assert sorted(flat(file)) == sorted(flat(mcap_bag))
    stamps = np.concatenate([s.stamps_ns for s in read_samples(file) if isinstance(s, ImuBlock)])
    assert (np.diff(stamps) > 0).all()


def test_usable_times_are_those_of_the_message_before():
    high = (1 << 64) - 5
    assert usable_times(np.array([0, 5, 0, high, 9], np.uint64)).tolist() == [5, 5, 5, 5, 9]
    assert usable_times(np.array([0, high], np.uint64)).tolist() == [0, 0]
    assert usable_times(np.array([], np.uint64)).tolist() == []


def test_batches_that_all_overlap_are_not_copied_again_and_again(monkeypatch):
    """GIVEN 2000 batches that all reach to the end THEN each byte is copied a few times only."""
    copied = [0]

    def counting(times, topics, payloads):
        copied[0] += len(payloads)
        return from_payloads(times, topics, payloads)

    monkeypatch.setattr("nav_pose_estimator.offline.bags.raw_messages.from_payloads", counting)
    batches = [(i, from_payloads([i, 10**6 + i], [0, 0], [b"a", b"b"])) for i in range(2000)]
    merged = list(merge_overlapping(batches))
    times = np.concatenate([batch.times for batch in merged])
    np.testing.assert_array_equal(times, np.sort(times))
    assert len(times) == 4000
    assert copied[0] < 4000 * 4


# --- split recordings ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_a_split_recording_without_metadata_is_read_in_order_of_time(tmp_path, mcap_bag, storage):
    bag = split(tmp_path, storage, [f"bag_{i}" for i in range(12)])
    assert flat(bag) == flat(mcap_bag)


def test_names_against_the_time_do_not_matter_and_overlaps_are_merged(tmp_path, mcap_bag):
    assert flat(split(tmp_path, StoragePlugin.MCAP, [f"bag_{99 - i}" for i in range(12)])) == flat(mcap_bag)
    both = tmp_path / "both"
    both.mkdir()
    for i in range(2):  # two recorders at once
        part = write_bag(tmp_path / f"part{i}", [m for m in flight() if (m[1] == "/imu/data_raw") == bool(i)])
        (part / f"part{i}.mcap").rename(both / f"part{i}.mcap")
    assert flat(both) == flat(mcap_bag)


def split(tmp_path: Path, storage: StoragePlugin, names: list[str]) -> Path:
    messages, bag = flight(), tmp_path / "split"
    shutil.rmtree(bag, ignore_errors=True)
    bag.mkdir()
    ending = "mcap" if storage is StoragePlugin.MCAP else "db3"
    size = -(-len(messages) // len(names))
    for i, name in enumerate(names):
        part = write_bag(tmp_path / f"p{i}", messages[i * size : (i + 1) * size], storage=storage)
        (part / f"p{i}.{ending}").rename(bag / f"{name}.{ending}")
        shutil.rmtree(part)
    return bag


@pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_compressed_messages_are_recognised_without_metadata(tmp_path, mcap_bag, storage):
    bag = write_bag(tmp_path / "bag", flight(), storage=storage, compression=CompressionMode.MESSAGE)
    (bag / "metadata.yaml").unlink()
    assert flat(bag) == flat(mcap_bag)


# --- terminal --------------------------------------------------------------------------------------------------------


def test_names_cannot_command_the_terminal(tmp_path):
    messages = [
        (t, "/imu\x1b[2J\x07\n" if topic == "/imu/data_raw" else topic, kind, m) for t, topic, kind, m in flight(1.0)
    ]
    messages += [(EPOCH_NS, "/x" * 500_000, messages[0][2], messages[0][3])]
    writer = mcap_bytes.Writer(messages)
    file = mcap_bytes.write(tmp_path / "bag.mcap", writer.head, writer.loose())
    code, errors = replay(file, tmp_path / "out")
    assert code in (0, 2)
    assert errors.replace("\n", "").isprintable()
    assert len(errors) < 2000
    assert r"\x1b[2J\x07\n" in errors
    assert "a topic was left out" in errors or code == 2
    assert len(printable("x" * 10**6)) < LONGEST + 10
    assert printable("a\x9bb\u202ec") == r"a\x9bb\u202ec"
