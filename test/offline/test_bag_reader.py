"""Any rosbag2 in, samples out: formats, order, damage, and what the user is told."""

import shutil

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionMode, StoragePlugin

import mcap_bytes
from driver_types import STORE
from nav_pose_estimator.engine.samples import GnssFix, ImuBlock, ImuSample, MagSample, PressureSample, SatelliteCount
from nav_pose_estimator.offline.bags import mcap_records
from nav_pose_estimator.offline.bags import reader as reader_module
from nav_pose_estimator.offline.bags.raw_messages import BagError
from nav_pose_estimator.offline.bags.reader import BagReader, read_samples
from nav_pose_estimator.offline.bags.topic_map import parse_remaps
from nav_pose_estimator.ros.messages import convert
from nav_pose_estimator.ros.messages.cdr import LAYOUTS, decode
from pieces import one_by_one
from small_bags import COUNT, EPOCH_NS, FIX, IMU, MAG, count, fix, flight, imu, write_bag


def flat(samples) -> list[str]:
    """Samples with the blocks taken apart, in a form that compares."""
    return [str(sample) for sample in one_by_one(samples)]


FORMS = {
    "mcap": {},
    "mcap, zstd chunks": {"compression": CompressionMode.STORAGE},
    "mcap, zstd file": {"compression": CompressionMode.FILE},
    "mcap, zstd messages": {"compression": CompressionMode.MESSAGE},
    "sqlite3": {"storage": StoragePlugin.SQLITE3},
    "sqlite3, zstd file": {"storage": StoragePlugin.SQLITE3, "compression": CompressionMode.FILE},
    "sqlite3, zstd messages": {"storage": StoragePlugin.SQLITE3, "compression": CompressionMode.MESSAGE},
}


@pytest.mark.parametrize("form", FORMS.values(), ids=FORMS.keys())
def test_every_form_gives_the_same_samples(tmp_path, mcap_bag, form):
    bag = write_bag(tmp_path / "bag", flight(), **form)
    assert flat(read_samples(bag)) == flat(read_samples(mcap_bag))


@pytest.mark.parametrize(("storage", "ending"), [(StoragePlugin.MCAP, "mcap"), (StoragePlugin.SQLITE3, "db3")])
def test_a_bare_file_and_a_folder_without_metadata_are_bags_too(tmp_path, mcap_bag, storage, ending):
    bag = write_bag(tmp_path / "bag", flight(), storage=storage)
    expected = flat(read_samples(mcap_bag))
    assert flat(read_samples(bag / f"bag.{ending}")) == expected
    (bag / "metadata.yaml").unlink()
    with BagReader(bag) as reader:
        assert flat(reader.samples()) == expected
        assert any("metadata.yaml" in text for text in reader.notices)


def test_samples_come_in_receive_order_and_imu_in_blocks(mcap_bag):
    samples = list(read_samples(mcap_bag))
    blocks = [s for s in samples if isinstance(s, ImuBlock)]
    assert sum(map(len, blocks)) == 400
    assert max(map(len, blocks)) > 1
    stamps = np.concatenate([b.stamps_ns for b in blocks])
    assert (np.diff(stamps) == 10_000_000).all()
    np.testing.assert_allclose(np.concatenate([b.gyro for b in blocks])[:, 0], np.arange(400) * 1e-4)
    now = 0
    for sample in samples:
        stamp = int(sample.stamps_ns[-1]) if isinstance(sample, ImuBlock) else sample.stamp_ns or now
        assert stamp >= now
        now = stamp


def test_the_fast_paths_agree_with_the_converters_of_the_nodes(mcap_bag):
    """Every message once more through rosbags and ``ros.messages.convert``."""
    expected = []
    adapters = {IMU: convert.imu, MAG: convert.magnetic_field, "sensor_msgs/msg/FluidPressure": convert.fluid_pressure}
    with AnyReader([mcap_bag]) as reader:
        for connection, _, raw in reader.messages():
            if connection.msgtype in adapters:
                expected += adapters[connection.msgtype](reader.deserialize(raw, connection.msgtype))
    got = [s for s in one_by_one(read_samples(mcap_bag)) if isinstance(s, (ImuSample, MagSample, PressureSample))]
    assert got == expected


def test_decoding_agrees_with_rosbags_for_every_known_type():
    rng = np.random.default_rng(3)
    for kind in LAYOUTS:
        message = _random_message(STORE, kind, rng)
        for little in (True, False):
            raw = bytes(STORE.serialize_cdr(message, kind, little_endian=little))
            _assert_same(decode(kind, raw), message)


def _random_message(store, kind: str, rng):
    fields = store.get_msgdef(kind).fields
    values = {}
    for name, (node, what) in fields:
        if node.name == "NAME":
            values[name] = _random_message(store, what, rng)
        elif node.name == "ARRAY":
            (element, of), length = what
            if element.name == "NAME":
                values[name] = [_random_message(store, of, rng) for _ in range(length)]
            else:
                values[name] = rng.normal(size=length).astype(of[0])
        elif what[0] == "string":
            values[name] = "frame_" + "x" * int(rng.integers(0, 9))
        elif what[0].startswith("float"):
            values[name] = float(np.float32(rng.normal()))
        elif what[0] == "bool":
            values[name] = bool(rng.integers(0, 2))
        else:
            values[name] = int(rng.integers(0, 100))
    return store.types[kind](**values)


def _assert_same(got, wanted):
    for name, value in vars(got).items():
        other = getattr(wanted, name)
        if hasattr(value, "__dict__"):
            _assert_same(value, other)
        elif isinstance(other, list):  # of vectors, one behind the other
            np.testing.assert_array_equal(value, [x for one in other for x in (one.x, one.y, one.z)])
        else:
            np.testing.assert_array_equal(value, other)


def test_frame_ids_of_different_length_fall_back_to_one_by_one(tmp_path):
    messages = [
        (EPOCH_NS + i * 10**7, "/imu/data_raw", IMU, imu(EPOCH_NS + i * 10**7, (i, 0, 0), frame="f" * (1 + i % 9)))
        for i in range(50)
    ]
    samples = list(read_samples(write_bag(tmp_path / "bag", messages)))
    assert np.concatenate([s.gyro[:, 0] for s in samples]).tolist() == list(range(50))


def test_a_message_without_angular_velocity_is_left_out_with_its_reason(tmp_path):
    messages = flight(1.0)
    absent = imu(EPOCH_NS + 10**9)
    absent.angular_velocity_covariance[0] = -1.0
    messages.append((EPOCH_NS + 10**9, "/imu/data_raw", IMU, absent))
    with BagReader(write_bag(tmp_path / "bag", messages)) as reader:
        assert sum(len(s) for s in reader.samples() if isinstance(s, ImuBlock)) == 100
        assert [event.name for event in reader.events] == ["imu.rejected.absent"]


def test_of_many_events_of_a_kind_all_are_counted_and_some_kept(tmp_path, monkeypatch):
    """GIVEN a long recording in which message after message says the same THEN memory does not grow with it."""
    monkeypatch.setattr(reader_module, "EVENTS_KEPT", 3)
    messages = flight(1.0)
    for stamp in range(EPOCH_NS + 10**9, EPOCH_NS + 2 * 10**9, 10**8):
        absent = imu(stamp)
        absent.linear_acceleration_covariance[0] = -1.0
        messages.append((stamp, "/imu/data_raw", IMU, absent))
    with BagReader(write_bag(tmp_path / "bag", messages)) as reader:
        list(reader.samples())
        assert reader.event_counts == {"imu.rejected.absent": 10}
        assert len(reader.events) == 3


# --- topics ----------------------------------------------------------------------------------------------------------


def test_the_only_imu_under_another_name_is_found_and_said(tmp_path):
    bag = write_bag(tmp_path / "bag", flight(imu_topic="/mavros/imu/data_raw"))
    with BagReader(bag) as reader:
        assert sum(len(s) for s in reader.samples() if isinstance(s, ImuBlock)) == 400
        assert any("/mavros/imu/data_raw" in text for text in reader.notices)


def test_of_two_imus_the_namespaced_one_is_taken_and_a_remap_overrides(tmp_path):
    second = [(t, "/mavros/imu/data", IMU, m) for t, topic, _, m in flight(2.0) if topic == "/imu/data_raw"]
    messages = sorted(flight(imu_topic="/mavros/imu/data_raw") + second, key=lambda item: item[0])
    bag = write_bag(tmp_path / "bag", messages)
    with BagReader(bag) as reader:
        assert reader.imu_count == 400
    with BagReader(bag, parse_remaps(["imu/data_raw:=/mavros/imu/data"])) as reader:
        assert reader.imu_count == 200


def test_two_equal_candidates_are_not_guessed(tmp_path):
    both = [(t, name, IMU, imu(t)) for t in range(EPOCH_NS, EPOCH_NS + 10**9, 10**8) for name in ("/left", "/right")]
    with pytest.raises(BagError, match=r"/left, /right.*--remap"):
        BagReader(write_bag(tmp_path / "bag", both))


def test_a_bag_without_imu_lists_what_it_holds(tmp_path):
    bag = write_bag(tmp_path / "bag", [(EPOCH_NS, "/gps/fix", FIX, fix(EPOCH_NS))])
    with pytest.raises(BagError, match=r"no sensor_msgs/Imu topic.*/gps/fix \(sensor_msgs/msg/NavSatFix\)"):
        BagReader(bag)


@pytest.mark.parametrize("text", ["/imu/data_raw", ":=/a", "/nothing:=/a", "/imu/data_raw:="])
def test_a_senseless_remap_is_refused(text):
    with pytest.raises(BagError):
        parse_remaps([text])


def test_a_remap_to_a_missing_topic_or_a_wrong_type_is_refused(mcap_bag):
    with pytest.raises(BagError, match="no topic /absent"):
        BagReader(mcap_bag, {"/gps/fix": "/absent"})
    with pytest.raises(BagError, match="must be sensor_msgs/msg/Imu"):
        BagReader(mcap_bag, {"/imu/data_raw": "/imu/mag"})


def test_the_autopilots_reference_is_never_an_input(shared_data):
    with BagReader(shared_data / "flights" / "px4_quad_0107_bag") as reader:
        assert "/reference/odom" in reader.bag.topics
        assert all(topic.name != "/reference/odom" for topic in reader.topics.topics.values())


# --- damage ----------------------------------------------------------------------------------------------------------


def test_a_truncated_mcap_gives_what_can_be_read_and_says_so_once(tmp_path, mcap_bag):
    whole = flat(read_samples(mcap_bag))
    data = (mcap_bag / "small.mcap").read_bytes()
    for share in (0.3, 0.6, 0.95):
        broken = tmp_path / f"broken_{share}.mcap"
        broken.write_bytes(data[: int(share * len(data))])
        with BagReader(broken) as reader:
            part = flat(reader.samples())
            warnings = [text for text in reader.notices if "breaks off" in text or "no end marker" in text]
        assert 0 < len(part) <= len(whole)
        assert part == whole[: len(part)]
        assert len(warnings) == 1


def test_a_truncated_compressed_mcap_keeps_its_whole_chunks(tmp_path):
    bag = write_bag(tmp_path / "bag", flight(60.0), compression=CompressionMode.STORAGE)
    data = (bag / "bag.mcap").read_bytes()
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(data[: int(0.7 * len(data))])
    with BagReader(broken) as reader:
        imu_samples = sum(len(s) for s in reader.samples() if isinstance(s, ImuBlock))
        assert 2000 < imu_samples < 6000
        assert reader.notices


def test_a_damaged_database_gives_what_can_be_read(tmp_path):
    bag = write_bag(tmp_path / "bag", flight(20.0), storage=StoragePlugin.SQLITE3)
    path = bag / "bag.db3"
    data = bytearray(path.read_bytes())
    place = len(data) // 2 // 4096 * 4096
    data[place : place + 40960] = b"\xff" * 40960
    path.write_bytes(data)
    with BagReader(path) as reader:
        samples = list(reader.samples())
        assert any("damaged" in text for text in reader.notices)
        assert all(isinstance(s, ImuBlock) or s.stamp_ns is None or s.stamp_ns >= EPOCH_NS for s in samples)


@pytest.mark.parametrize(
    ("name", "content"),
    [("empty.mcap", b""), ("text.mcap", b"no mcap at all"), ("text.db3", b"no database" * 100), ("flight.txt", b"x")],
)
def test_what_is_no_bag_is_one_sentence(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(BagError) as caught:
        BagReader(path)
    assert "\n" not in str(caught.value)
    assert name in str(caught.value)
    if name == "flight.txt":
        assert "neither a rosbag2 (folder, .mcap, .db3) nor a PX4 or ArduPilot log" in str(caught.value)


def test_a_missing_path_an_empty_folder_and_a_lost_file_are_one_sentence(tmp_path, mcap_bag):
    with pytest.raises(BagError, match="does not exist"):
        BagReader(tmp_path / "nothing")
    (tmp_path / "folder").mkdir()
    with pytest.raises(BagError, match="not a rosbag2"):
        BagReader(tmp_path / "folder")
    copy = tmp_path / "copy"
    shutil.copytree(mcap_bag, copy)
    (copy / "small.mcap").unlink()
    with pytest.raises(BagError, match=r"lacks small\.mcap, listed in metadata\.yaml"):
        BagReader(copy)


def test_a_damaged_message_is_counted_not_fatal(tmp_path):
    from rosbags.rosbag2 import Writer

    from small_bags import STORE

    path = tmp_path / "bag"
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        fixes = writer.add_connection("/gps/fix", FIX, typestore=STORE)
        inertial = writer.add_connection("/imu/data_raw", IMU, typestore=STORE)
        for i in range(10):
            t = EPOCH_NS + i * 10**7
            raw = bytes(STORE.serialize_cdr(imu(t), IMU))
            writer.write(inertial, t, raw if i != 5 else raw[:40])
            writer.write(fixes, t, bytes(STORE.serialize_cdr(fix(t), FIX))[: 60 if i == 3 else None])
    with BagReader(path) as reader:
        samples = list(reader.samples())
        assert sum(len(s) for s in samples if isinstance(s, ImuBlock)) == 9
        assert sum(isinstance(s, GnssFix) for s in samples) == 9
        assert reader.counters["bag.damaged_message"] == 2


def test_a_satellite_count_has_no_stamp_and_255_is_unknown(tmp_path):
    messages = [*flight(1.0), (EPOCH_NS + 10**9, "/gps/satellites", COUNT, count(255))]
    counts = [s for s in read_samples(write_bag(tmp_path / "bag", messages)) if isinstance(s, SatelliteCount)]
    assert counts[0] == SatelliteCount(None, 9)
    assert counts[-1] == SatelliteCount(None, None)


def test_a_type_that_nobody_describes_is_counted(tmp_path, mcap_bag, monkeypatch):
    monkeypatch.delitem(LAYOUTS, MAG)
    monkeypatch.setattr("nav_pose_estimator.offline.bags.decoder._typestore", _no_description)
    with BagReader(mcap_bag) as reader:
        list(reader.samples())
        assert reader.counters["bag.unknown_type"] == 40


def _no_description(topic):
    raise BagError(f"{topic.name} is of type {topic.type}, which the bag does not describe")


def test_overlapping_chunks_are_merged_in_order():
    from nav_pose_estimator.offline.bags.raw_messages import from_payloads, merge_overlapping

    first = from_payloads([1, 5, 9], [0, 0, 0], [b"a", b"bb", b"c"])
    second = from_payloads([4, 6, 12], [1, 1, 1], [b"d", b"e", b"fff"])
    third = from_payloads([13], [0], [b"g"])
    merged = list(merge_overlapping([(1, first), (4, second), (13, third)]))
    times = np.concatenate([batch.times for batch in merged]).tolist()
    payloads = [batch.payload(i) for batch in merged for i in range(len(batch))]
    assert times == [1, 4, 5, 6, 9, 12, 13]
    assert payloads == [b"a", b"d", b"bb", b"e", b"c", b"fff", b"g"]


# --- the index of an MCAP chunk ---------------------------------------------------------------------------------------


def indexed_chunk(between: bytes = b"") -> tuple[bytes, np.ndarray]:
    """The records of a chunk, with others ``between`` the messages, and where the messages begin."""
    writer = mcap_bytes.Writer([(EPOCH_NS + i, "/imu/data_raw", IMU, imu(EPOCH_NS + i)) for i in range(5)])
    data, places = writer.head, []
    for message in writer.messages:
        places.append(len(data))
        data += writer.message(message) + between
    return data, np.array(places)


@pytest.mark.parametrize("between", [b"", mcap_bytes.record(0x0C, b"metadata")], ids=["nothing", "metadata"])
def test_an_index_finds_what_a_walk_finds(between):
    data, places = indexed_chunk(between)
    walked = np.array(list(mcap_records.messages(data, None)), np.uint64)
    np.testing.assert_array_equal(mcap_records.indexed_messages(data, places[::-1]), walked)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda places: places[:-1],
        lambda places: places[1:],
        lambda places: np.delete(places, 2),
        lambda places: places + 1,
        lambda places: np.append(places, places[2] + 8),
        lambda places: np.append(places, 1 << 40),
        lambda places: np.append(places, -1),
        lambda places: places[:0],
    ],
    ids=["last missing", "first missing", "one missing", "all beside", "one more", "beyond", "negative", "empty"],
)
def test_an_index_that_is_wrong_is_not_believed(wrong):
    """GIVEN an index that leaves out a message or names one that is none THEN the chunk is walked through instead."""
    data, places = indexed_chunk()
    assert mcap_records.indexed_messages(data, wrong(places)) is None


def test_an_index_of_a_chunk_that_breaks_off_is_not_believed():
    data, places = indexed_chunk()
    assert mcap_records.indexed_messages(data[:-1], places) is None
