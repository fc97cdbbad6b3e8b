"""One decoder for nodes and bags: whole messages, single fields, columns; and bytes that lie."""

import random
import re
import struct

import numpy as np
import pytest

from driver_types import DEFINITIONS, STORE, make
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import specs, update
from nav_pose_estimator.engine.samples import DifferentialPressure, ImuBlock
from nav_pose_estimator.engine.solutions import Event
from nav_pose_estimator.offline.bags.cdr_packing import STAMP, pack
from nav_pose_estimator.offline.bags.decoder import Decoder
from nav_pose_estimator.offline.bags.raw_messages import Topic, from_payloads
from nav_pose_estimator.offline.bags.reader import UNREADABLE
from nav_pose_estimator.ros.messages import from_bytes, message_table
from nav_pose_estimator.ros.messages.cdr import LAYOUTS, CdrError, columns, decode, peek_stamp_ns, picker
from nav_pose_estimator.ros.messages.message_table import INPUTS, Input, MessageType
from small_bags import EPOCH_NS, IMU, imu

ABSURD = (0, 1, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 0xFFFFFFF0)
NAMES = tuple(name.removesuffix("[0]") for name in from_bytes.IMU_FIELDS)
EVERY_TYPE = [pytest.param(one, kind, id=f"{one.topic}-{kind.choice}") for one in INPUTS for kind in one.types]


def serialized(kind: str, little_endian: bool = True) -> bytes:
    message = imu(EPOCH_NS, (0.1, 0.2, 0.3)) if kind == IMU else make(kind)
    return bytes(STORE.serialize_cdr(message, kind, little_endian=little_endian))


def definition(kind: str) -> str:
    """As a bag carries it: the type and, below, those that it is made of."""
    if kind not in DEFINITIONS:
        return ""
    lines = DEFINITIONS[kind].splitlines()
    parts = [name for name in DEFINITIONS if any(re.match(rf"{name.replace('/msg', '')}[ \[]", line) for line in lines)]
    below = [f"{'=' * 80}\nMSG: {name.replace('/msg', '')}\n{DEFINITIONS[name]}" for name in parts]
    return DEFINITIONS[kind] + "".join(below)


def mutations(raw: bytes, seed: int, count: int):
    """Truncated, prolonged, with absurd lengths at every place, with flipped bytes, with other encapsulations."""
    rng = random.Random(seed)
    yield from (raw[:n] for n in range(min(len(raw), 24)))
    for place in range(4, min(len(raw) - 4, 200), 4):
        for length in ABSURD:
            yield raw[:place] + struct.pack("<I", length) + raw[place + 4 :]
    for code in (0, 1, 2, 3, 6, 7, 255):
        yield bytes([0, code]) + raw[2:]
    for _ in range(count):
        data = bytearray(raw)
        for _ in range(rng.randint(1, 8)):
            data[rng.randrange(len(data))] = rng.randrange(256)
        end = rng.choice((len(data), len(data), rng.randrange(len(data))))
        yield bytes(data[:end]) + bytes(rng.choice((0, 0, 1, 7, 8, 64)))


@pytest.mark.parametrize("kind", sorted(LAYOUTS))
def test_damaged_bytes_give_a_message_or_the_one_error(kind):
    """GIVEN 900 and more mutations of a message WHEN decoded THEN nothing but ``CdrError`` ever comes out."""
    names = tuple(item.split(":")[0] for item in LAYOUTS[kind].split())
    refused = taken = 0
    for data in mutations(serialized(kind), seed=7, count=600):
        try:
            decode(kind, data)
            taken += 1
        except CdrError:
            refused += 1
        if data:
            columns(kind, from_payloads([0, 1], [0, 0], [data, data]), names)
        assert isinstance(peek_stamp_ns(data), int)
    assert refused > 50
    assert taken > 50


@pytest.mark.parametrize(("one", "kind"), EVERY_TYPE)
def test_damaged_messages_of_every_type_give_samples_events_or_nothing(one: Input, kind: MessageType):
    """GIVEN mutations of every message of the table WHEN read as a bag reads them THEN nothing else is raised."""
    decoder = Decoder(Topic("/some", kind.name, 1, "cdr", definition(kind.name)))
    parameters = update(Parameters(), {one.parameter: kind.choice}) if one.parameter else Parameters()
    source = one.source(parameters, kind.name)
    assert source is not None
    expected = (DifferentialPressure,) if "pressure" in kind.choice and one is message_table.AIRSPEED else (one.sample,)
    read = 0
    for data in mutations(serialized(kind.name), seed=11, count=300):
        try:
            items = source.adapter(decoder(data))
        except UNREADABLE:
            continue
        read += 1
        assert all(isinstance(item, (*expected, Event)) for item in items)
    assert read > 50


def test_damaged_imu_messages_in_the_node_give_samples_events_or_the_one_error():
    refused = 0
    for data in mutations(serialized(IMU), seed=3, count=2000):
        try:
            assert len(from_bytes.imu(data)) == 1
        except CdrError:
            refused += 1
    assert refused > 100


@pytest.mark.parametrize("frame", ["", "a", "imu_link", "x" * 15, "ä" * 7])
@pytest.mark.parametrize("little", [True, False])
def test_fields_of_one_message_are_those_of_the_whole(frame, little):
    message = imu(EPOCH_NS + 5, (0.1, 0.2, 0.3), (1.0, 2.0, 3.0), frame)
    raw = bytes(STORE.serialize_cdr(message, IMU, little_endian=little))
    stamp, values = picker(IMU, ("angular_velocity", "linear_acceleration"))(raw)
    assert (stamp, values) == (EPOCH_NS + 5, (0.1, 0.2, 0.3, 1.0, 2.0, 3.0))
    assert peek_stamp_ns(raw) == EPOCH_NS + 5
    whole = decode(IMU, raw)
    assert (whole.header.frame_id, whole.angular_velocity.y) == (frame, 0.2)


def test_columns_are_the_messages_one_by_one():
    raws = [bytes(STORE.serialize_cdr(imu(EPOCH_NS + i, (i, 0.5, -i)), IMU)) for i in range(50)]
    found = columns(IMU, from_payloads(list(range(50)), [0] * 50, raws), NAMES)
    block = from_bytes.imu_block(found)
    assert isinstance(block, ImuBlock)
    assert [from_bytes.imu(raw)[0].gyro for raw in raws] == [tuple(row) for row in block.gyro.tolist()]
    assert block.stamps_ns.dtype == np.int64
    assert block.stamps_ns.tolist() == [EPOCH_NS + i for i in range(50)]


def test_columns_do_not_believe_places_beyond_the_buffer():
    raw = serialized(IMU)
    batch = from_payloads([0, 1], [0, 0], [raw, raw])
    batch.offsets[1] += 8
    assert columns(IMU, batch, NAMES) is None
    batch.offsets[1] = -4
    assert columns(IMU, batch, NAMES) is None


def test_a_range_of_an_older_distribution_ends_before_its_variance():
    kind = "sensor_msgs/msg/Range"
    whole = serialized(kind)
    old = decode(kind, whole[:-4])
    assert hasattr(decode(kind, whole), "variance")
    assert not hasattr(old, "variance")
    with pytest.raises(CdrError, match="too short"):
        decode(kind, whole[:-8])


def test_the_table_names_every_input_type_and_choice_once():
    topics = [one.topic for one in INPUTS]
    assert len(set(topics)) == len(topics)
    for one in INPUTS:
        choices, names = [kind.choice for kind in one.types], [kind.name for kind in one.types]
        assert len(set(choices)) == len(choices)
        assert len(set(names)) == len(names)
        assert one.parameter or len(choices) == 1


@pytest.mark.parametrize("change", [{"ros.input.velocity_frame": "ned"}, {"ros.input.vertical_velocity": False}])
def test_a_converter_that_is_adjusted_has_no_fast_way_around_the_adjustment(change):
    plain, adjusted = (message_table.VELOCITY.source(p) for p in (Parameters(), update(Parameters(), change)))
    assert plain.columns is not None
    assert adjusted.columns is None
    assert adjusted.adapter is not plain.adapter


COVARIANCES = {
    "unknown": np.zeros((3, 3)),
    "absent": -np.eye(3),
    "diagonal": np.diag([2.0, 3.0, 4.0]),
    "full": np.array([[2.0, 0.5, 0.0], [0.5, 3.0, 0.1], [0.0, 0.1, 4.0]]),
    "zero variance": np.diag([2.0, 0.0, 4.0]),
    "negative": np.diag([2.0, -3.0, 4.0]),
    "indefinite": np.array([[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
    "too large": np.diag([2.0, 3.0, 1e300]),
    "not finite": np.diag([2.0, np.nan, 4.0]),
}


@pytest.mark.parametrize("one", [message_table.FIX, message_table.VELOCITY], ids=lambda one: one.topic)
@pytest.mark.parametrize("cov", COVARIANCES.values(), ids=COVARIANCES)
def test_gnss_in_columns_is_gnss_one_by_one(one: Input, cov):
    source = one.source(Parameters())
    if one is message_table.FIX:
        fields = {"latitude": [47.1, np.nan], "longitude": 8.5, "altitude": [1.0, 2.0], "status.status": [0, -1]}
        fields |= {"position_covariance": cov.ravel(), "position_covariance_type": [3, 0]}
    else:
        whole = np.zeros((6, 6))
        whole[:3, :3] = cov
        fields = {"twist.twist.linear": [[1.0, 2.0, 3.0], [4.0, np.nan, 6.0]], "twist.covariance": whole.ravel()}
    payloads = [row.tobytes() for row in pack(source.type, 2, {STAMP: [EPOCH_NS, EPOCH_NS + 1], **fields})]
    found = columns(source.type, from_payloads([0, 1], [0, 0], payloads), source.columns.fields)
    at_once = source.columns.convert(found)
    one_by_one = [source.adapter(decode(source.type, payload)) for payload in payloads]
    assert repr(at_once) == repr(one_by_one)


def test_the_choices_of_the_parameters_are_those_of_the_table():
    known = {spec.key: spec for spec in specs(Parameters())}
    for one in INPUTS:
        if one.parameter:
            spec = known[one.parameter]
            assert spec.default in (one.types[0].choice, message_table.NONE)
            assert set(spec.choices) - {message_table.NONE} == {kind.choice for kind in one.types}
