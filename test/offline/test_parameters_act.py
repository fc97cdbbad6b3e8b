"""Parameters do what they say, at least something: each is changed, and something else must come out.

Those of the estimators change what replay and node compute, which is one engine; those of reading change what a bag
gives, and it must be what a node hears; those of nodes alone are observed in ``test/ros/test_parameters_act_in_nodes``.
"""

import hashlib
import math
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from driver_types import DVL, make
from driver_types import STORE as DRIVER_STORE
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import flatten, update
from nav_pose_estimator.engine.samples import Sample
from nav_pose_estimator.engine.solutions import AttitudeBlock, AttitudeSolution, Event, NavBlock, NavSolution, Output
from nav_pose_estimator.offline.bags.raw_messages import BagError
from nav_pose_estimator.offline.bags.reader import BagReader
from nav_pose_estimator.ros.messages import message_table
from parameter_changes import CHANGES, FLIGHTS, OF_NODES, PRESETS, READ
from pieces import one_by_one
from small_bags import EPOCH_NS, FIX, TYPES, fix, flight, header, vector, write_bag

TWIST, POSE = "geometry_msgs/msg/TwistStamped", "geometry_msgs/msg/PoseWithCovarianceStamped"
PIECES = 40  # that a flight is compared in
CASES = [pytest.param(name, key, id=key) for name, changes in CHANGES.items() for key in changes]


def test_every_parameter_has_its_flight_or_its_observer():
    """A new parameter comes with the proof that it does something."""
    observed = Counter(key for changes in CHANGES.values() for key in changes)
    observed.update(dict.fromkeys([*READ, *OF_NODES], 1))
    assert set(flatten(Parameters())) == set(observed)


# --- the estimators --------------------------------------------------------------------------------------------------


@cache
def samples(name: str) -> list[Sample]:
    return FLIGHTS[name]()


def parameters_for(name: str, **changes: Any) -> Parameters:
    return update(Parameters(), {"learner.enabled": False, **PRESETS.get(name, {}), **changes})


def pieces_of(name: str, parameters: Parameters, attitude: bool = True) -> Iterator[bytes]:
    """Everything that a user can see of a flight, piece by piece: solutions, attitudes and events, at the end counters
    and the learner's scores."""
    engine, flown = PoseEstimator(parameters, attitude=attitude), samples(name)
    step = math.ceil(len(flown) / PIECES)
    for first in range(0, len(flown), step):
        yield b"".join(map(seen, engine.feed_all(flown[first : first + step])))
    scores = [] if engine.outage_aid is None else sorted(engine.outage_aid.status().items())
    yield repr((sorted(engine.status().counters.items()), scores)).encode()


def seen(output: Output) -> bytes:
    if isinstance(output, Event):
        return repr((output.stamp_ns, output.name)).encode()
    if isinstance(output, (NavBlock, AttitudeBlock)):
        return np.ascontiguousarray(output.rows).tobytes()
    return output.values.tobytes() if isinstance(output, (NavSolution, AttitudeSolution)) else b""


@cache
def usual(name: str, attitude: bool = True) -> list[str]:
    """Digests of the pieces with the parameters as they are."""
    return [digest_of(piece) for piece in pieces_of(name, parameters_for(name), attitude)]


def digest_of(piece: bytes) -> str:
    return hashlib.sha256(piece).hexdigest()


def is_changed(name: str, parameters: Parameters, attitude: bool = True) -> bool:
    """Whether anything differs; the flight ends with the first piece that does."""
    pairs = zip(pieces_of(name, parameters, attitude), usual(name, attitude), strict=True)
    return any(digest_of(piece) != known for piece, known in pairs)


@pytest.mark.compiled
@pytest.mark.parametrize("name", ["flight", "learning"])
def test_the_same_parameters_give_the_same_flight(name):
    """Without this, nothing would follow from a difference."""
    assert not is_changed(name, parameters_for(name))


@pytest.mark.compiled
@pytest.mark.parametrize(("name", "key"), CASES)
def test_a_changed_parameter_changes_the_flight(name, key):
    assert is_changed(name, parameters_for(name, **{key: CHANGES[name][key]}))


@pytest.mark.compiled
@pytest.mark.parametrize("key", ["attitude.hard_iron", "attitude.soft_iron", "aids.magnetometer_rpy"])
def test_a_magnetometer_calibration_reaches_the_navigator(key):
    assert is_changed("flight", parameters_for("flight", **{key: CHANGES["flight"][key]}), attitude=False)


# --- reading ---------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def bag(tmp_path_factory) -> Path:
    """Every sensor of the default types, a pose from outside, an airspeed and a Doppler log."""
    twist = TYPES["geometry_msgs/msg/Twist"](linear=vector(15.0, 0.0, 0.0), angular=vector(0.0, 0.0, 0.0))
    pose = TYPES["geometry_msgs/msg/Pose"](
        position=TYPES["geometry_msgs/msg/Point"](x=1.0, y=2.0, z=3.0),
        orientation=TYPES["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
    )
    with_covariance = TYPES["geometry_msgs/msg/PoseWithCovariance"](pose=pose, covariance=np.zeros(36))
    time = EPOCH_NS + 10**9
    messages = [
        *flight(),
        (time, "/airspeed", TWIST, TYPES[TWIST](header(time), twist)),
        (time, "/set_pose", POSE, TYPES[POSE](header(time, "map"), with_covariance)),
        (time, "/beam_velocity", DVL, make(DVL, header=header(time), beam_velocity=np.ones(4, np.float32))),
        (time, "/set_origin", FIX, fix(time)),
    ]
    rows = sorted(messages, key=lambda row: row[0])
    return write_bag(tmp_path_factory.mktemp("reading") / "bag", rows, store=DRIVER_STORE)


def read_by_replay(bag: Path, parameters: Parameters) -> list[str]:
    """Samples and events by kind, as text: NaN equals NaN."""
    with BagReader(bag, parameters=parameters) as reader:
        items = one_by_one(reader.samples())
        return sorted(map(str, [*items, *reader.events]))


def heard_by_a_node(bag: Path, parameters: Parameters) -> list[str]:
    """The same for a node on whose topics the messages of the bag are published."""
    sources = {f"/{source.topic}": source for source in message_table.sources(parameters)}
    items: list[Any] = []
    with AnyReader([bag]) as reader:
        for connection, _, raw in reader.messages():
            source = sources.get(connection.topic)
            if source is not None and source.type == connection.msgtype:
                items += (
                    source.from_bytes(raw)
                    if source.from_bytes
                    else source.adapter(DRIVER_STORE.deserialize_cdr(raw, connection.msgtype))
                )
    return sorted(map(str, items))


def test_replay_reads_what_a_node_hears(bag):
    assert read_by_replay(bag, Parameters()) == heard_by_a_node(bag, Parameters())


@pytest.mark.parametrize("key", sorted(READ.keys() - {"ros.input.imu"}))
def test_a_parameter_of_reading_acts_in_replay_as_in_a_node(bag, key):
    changed = update(Parameters(), {key: READ[key]})
    read = read_by_replay(bag, changed)
    assert read != read_by_replay(bag, Parameters())
    assert read == heard_by_a_node(bag, changed)


def test_an_imu_of_another_type_is_not_heard_and_not_read(bag):
    changed = update(Parameters(), {"ros.input.imu": READ["ros.input.imu"]})
    assert not any(text.startswith("ImuSample") for text in heard_by_a_node(bag, changed))
    with pytest.raises(BagError, match=r"must be px4_msgs/msg/SensorCombined, for ros\.input\.imu is px4"):
        BagReader(bag, parameters=changed)
