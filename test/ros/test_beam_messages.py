"""Velocities along beams as drivers publish them, and what drivers put there that means something else."""

from importlib.util import find_spec

import numpy as np
import pytest

from beamed import beam_directions
from driver_types import A50, DVL, STORE, make, sent
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import ParameterError, update
from nav_pose_estimator.engine.samples import BeamVelocitySample
from nav_pose_estimator.engine.solutions import Event
from nav_pose_estimator.offline.bags.decoder import Decoder
from nav_pose_estimator.offline.bags.raw_messages import Topic
from nav_pose_estimator.offline.bags.reader import BagReader
from nav_pose_estimator.ros.messages import beams
from nav_pose_estimator.ros.messages.cdr import decode
from nav_pose_estimator.ros.messages.message_table import BEAM_VELOCITY
from small_bags import EPOCH_NS, flight, header, write_bag

CLOUD = "sensor_msgs/msg/PointCloud2"
VELOCITIES = np.array([0.5, -0.25, 1.0, -2.0])
RANGES = np.array([10.0, 11.0, 12.0, 13.0])
NUMBERS = {"<f4": 7, ">f4": 7, "<f8": 8, "<i2": 3}


def vector3(v):
    return make("geometry_msgs/msg/Vector3", x=float(v[0]), y=float(v[1]), z=float(v[2]))


def dvl(**changes):
    values = {
        "header": header(EPOCH_NS, "dvl"),
        "velocity_mode": 1,
        "velocity": vector3((1.0, 0.5, 0.0)),
        "beam_ranges_valid": True,
        "beam_velocities_valid": True,
        "beam_unit_vec": [vector3(b) for b in beam_directions()],
        "range": RANGES,
        "beam_velocity": VELOCITIES.astype(np.float32),
        "beam_velocity_covar": np.array([-1.0, 0.0, 4e-4, 1e-4], np.float32),
    }
    return sent(make(DVL, **(values | changes)))


def a50(numbers=(0, 1, 2, 3), valid=(True, True, True, True), velocity_valid=True):
    found = [
        make("dvl_msgs/msg/DVLBeam", id=n, velocity=v, distance=r, valid=ok)
        for n, v, r, ok in zip(numbers, VELOCITIES, RANGES, valid, strict=False)
    ]
    velocity = vector3((1.0, 0.5, 0.0))
    return sent(make(A50, header=header(EPOCH_NS), beams=found, velocity=velocity, velocity_valid=velocity_valid))


def cloud(columns: dict[str, np.ndarray], code: str = "<f4", padding: int = 0, **changes):
    size, names = np.dtype(code).itemsize, list(columns)
    step = size * len(names) + padding
    rows = np.stack([np.asarray(column) for column in columns.values()], axis=1).astype(code)
    data = np.zeros((len(rows), step), np.uint8)
    data[:, : step - padding] = np.ascontiguousarray(rows).view(np.uint8).reshape(len(rows), -1)
    fields = [
        make("sensor_msgs/msg/PointField", name=name, offset=size * i, datatype=NUMBERS[code], count=1)
        for i, name in enumerate(names)
    ]
    values = {
        "header": header(EPOCH_NS),
        "height": 1,
        "width": len(rows),
        "fields": fields,
        "is_bigendian": code[0] == ">",
        "point_step": step,
        "row_step": step * len(rows),
        "data": data.ravel(),
    }
    return sent(make(CLOUD, **(values | changes)))


def points(scale: float = 1.0, **more):
    return dict(zip("xyz", scale * beam_directions().T, strict=True)) | {"velocity": VELOCITIES} | more


def of(items) -> BeamVelocitySample:
    (sample,) = items
    assert isinstance(sample, BeamVelocitySample)
    return sample


def refusal(items) -> Event:
    (event,) = items
    assert isinstance(event, Event)
    return event


def test_a_dvl_gives_directions_velocities_and_what_is_known_of_them():
    sample = of(beams.dvl(dvl()))
    np.testing.assert_allclose(sample.directions, beam_directions())
    np.testing.assert_allclose(sample.velocities, VELOCITIES)
    np.testing.assert_allclose(sample.variances, [np.nan, np.nan, 4e-4, 1e-4])
    assert (sample.stamp_ns, sample.velocity) == (EPOCH_NS, (1.0, 0.5, 0.0))
    np.testing.assert_array_equal(sample.ranges, RANGES)


def test_our_decoder_gives_what_that_of_the_driver_gives():
    raw = bytes(STORE.serialize_cdr(dvl(), DVL))
    ours, theirs = of(beams.dvl(decode(DVL, raw))), of(beams.dvl(dvl()))
    for name in ("directions", "velocities", "variances", "ranges"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))
    assert (ours.stamp_ns, ours.velocity) == (theirs.stamp_ns, theirs.velocity)


def test_flags_of_a_dvl_that_is_not_valid_as_a_whole_cost_no_beam():
    """GIVEN a driver that clears ``beam_velocities_valid`` with the 3-D velocity THEN its beams are still there."""
    sample = of(beams.dvl(dvl(beam_velocities_valid=False, beam_ranges_valid=False, range=np.zeros(4))))
    np.testing.assert_allclose(sample.velocities, VELOCITIES)
    assert sample.velocity is None
    assert sample.ranges is None


def test_a_dvl_that_tracks_the_water_is_refused():
    event = refusal(beams.dvl(dvl(velocity_mode=2)))
    assert event.name == "beam_velocity.rejected.water"
    assert "relative to the water" in event.text


@pytest.mark.parametrize("first", [0, 1])
def test_the_beams_of_an_a50_come_by_number(first):
    sample = of(beams.a50(a50(np.array([2, 0, 3, 1]) + first, valid=(True, True, False, True))))
    np.testing.assert_array_equal(sample.velocities, VELOCITIES[[1, 3, 0, 2]])
    np.testing.assert_array_equal(sample.ranges, RANGES[[1, 3, 0, 2]])
    np.testing.assert_array_equal(sample.valid, [True, True, True, False])
    assert np.isnan(sample.directions).all()
    assert of(beams.a50(a50(velocity_valid=False))).velocity is None


def test_an_a50_that_leaves_a_beam_out_has_lost_it():
    sample = of(beams.a50(a50((0, 2, 3))))
    np.testing.assert_array_equal(np.isnan(sample.velocities), [False, True, False, False])
    assert not sample.valid[1]


@pytest.mark.parametrize("numbers", [(), (0, 1, 1, 2), (0, 1, 2, 17)])
def test_beams_without_a_proper_number_are_refused(numbers):
    assert refusal(beams.a50(a50(numbers))).name == "beam_velocity.rejected.beams"


@pytest.mark.parametrize(("code", "padding"), [("<f4", 0), ("<f8", 0), (">f4", 0), ("<f4", 12)])
def test_a_point_cloud_gives_a_beam_for_each_point(code, padding):
    sample = of(beams.point_cloud(cloud(points(variance=np.array([0.0, 1e-4, -1.0, 4e-4])), code, padding)))
    np.testing.assert_allclose(sample.directions, beam_directions(), atol=1e-7)
    np.testing.assert_allclose(sample.velocities, VELOCITIES)
    np.testing.assert_allclose(sample.variances, [np.nan, 1e-4, np.nan, 4e-4], rtol=1e-6)


def test_points_of_a_radar_are_places_and_give_their_directions():
    sample = of(beams.point_cloud(cloud(points(scale=17.0))))
    np.testing.assert_allclose(sample.directions, beam_directions(), atol=1e-7)
    assert sample.variances is None


def test_points_without_a_direction_are_no_beams():
    columns = points()
    columns["x"] = np.array([np.nan, *columns["x"][1:]])
    for axis in "xyz":
        columns[axis] = np.array([*columns[axis][:3], 0.0])
    assert len(of(beams.point_cloud(cloud(columns))).velocities) == 2


@pytest.mark.parametrize(
    ("message", "reason", "words"),
    [
        (lambda: cloud({k: v for k, v in points().items() if k != "velocity"}), "fields", "no field velocity"),
        (lambda: cloud(points(), fields=[]), "fields", "none at all"),
        (lambda: cloud(points(), point_step=8), "layout", "does not match"),
        (lambda: cloud(points(), width=5), "layout", "does not match"),
        (lambda: cloud(points(), height=1 << 31, row_step=0), "layout", "does not match"),
    ],
)
def test_a_point_cloud_that_contradicts_itself_is_refused_in_one_sentence(message, reason, words):
    event = refusal(beams.point_cloud(message()))
    assert event.name == f"beam_velocity.rejected.{reason}"
    assert words in event.text


@pytest.mark.parametrize(("kind", "message"), [("dvl", dvl), ("a50", a50), ("pointcloud2", lambda: cloud(points()))])
def test_replay_reads_beams_where_the_parameter_says_so(tmp_path, kind, message):
    """GIVEN a bag with beam velocities THEN they are read if their type is chosen, else the user reads why not."""
    made = message()
    rows = [*flight(), (EPOCH_NS + 10**9, "/beam_velocity", made.__msgtype__, made)]
    bag = write_bag(tmp_path / "bag", sorted(rows, key=lambda row: row[0]), store=STORE)
    with BagReader(bag) as reader:
        assert not any(isinstance(sample, BeamVelocitySample) for sample in reader.samples())
        assert any("aids.beam_velocity_source is none" in notice for notice in reader.notices)
    with BagReader(bag, parameters=update(Parameters(), {"aids.beam_velocity_source": kind})) as reader:
        (sample,) = (sample for sample in reader.samples() if isinstance(sample, BeamVelocitySample))
    np.testing.assert_allclose(sample.velocities, VELOCITIES)


def test_a_bag_without_definitions_is_read_too():
    raw = bytes(STORE.serialize_cdr(a50(), A50))
    message = Decoder(Topic("/dvl", A50, 1))(raw)
    np.testing.assert_array_equal(of(beams.a50(message)).velocities, VELOCITIES)
    assert BEAM_VELOCITY.types[1].name == A50


def test_messages_of_rclpy_are_read_as_those_of_a_bag():
    """GIVEN the same point cloud as a message of rclpy, whose data are an ``array`` THEN the same beams come out."""
    messages = pytest.importorskip("sensor_msgs.msg")
    ours = cloud(points())
    fields = [
        messages.PointField(name=f.name, offset=f.offset, datatype=f.datatype, count=f.count) for f in ours.fields
    ]
    theirs = messages.PointCloud2(
        height=1, width=4, fields=fields, point_step=ours.point_step, row_step=ours.row_step, data=ours.data.tobytes()
    )
    theirs.header.stamp.sec = 5
    sample = of(beams.point_cloud(theirs))
    np.testing.assert_array_equal(sample.velocities, of(beams.point_cloud(ours)).velocities)
    assert sample.stamp_ns == 5 * 10**9


def test_a_missing_package_is_named_with_its_cure():
    inputs = pytest.importorskip("nav_pose_estimator.ros.inputs")
    if find_spec("marine_acoustic_msgs") is not None:
        pytest.skip("marine_acoustic_msgs is installed here")
    source = BEAM_VELOCITY.source(update(Parameters(), {"aids.beam_velocity_source": "dvl"}))
    cure = (
        "marine_acoustic_msgs is not installed here; install ros-jazzy-marine-acoustic-msgs or choose another type in "
    )
    with pytest.raises(ParameterError, match=f"{cure}aids.beam_velocity_source"):
        inputs.message_class(source)
