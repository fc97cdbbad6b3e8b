"""Recordings that went wrong for somebody: each gives the right pose, or one sentence with the cause and the cure."""

import copy
import struct
from pathlib import Path

import numpy as np
import pytest

from changed_bags import Row, rewrite, rows, write_rows
from nav_pose_estimator.engine.samples import GnssVelocity, ImuBlock, MagSample
from nav_pose_estimator.offline.bags.raw_messages import BagError
from nav_pose_estimator.offline.bags.reader import BagReader, read_samples
from nav_pose_estimator.offline.bags.topic_map import parse_remaps
from nav_pose_estimator.offline.command_line import main
from nav_pose_estimator.offline.flights.config_file import load_parameters
from nav_pose_estimator.offline.flights.recording import load
from nav_pose_estimator.offline.simulated_bag import write_recording
from nav_pose_estimator.sim.scenarios import generate
from pieces import one_by_one
from small_bags import IMU, STORE, VELOCITY

VECTOR = "geometry_msgs/msg/Vector3Stamped"


@pytest.fixture(scope="module")
def flight(tmp_path_factory) -> Path:
    """Forty seconds of a multirotor, every sensor."""
    path = tmp_path_factory.mktemp("flight") / "bag"
    write_recording(path, generate("multirotor_light", 40.0, seed=5, imu_rate=50.0))
    return path


def config(folder: Path, text: str) -> Path:
    path = folder / "drone.yaml"
    path.write_text(f"/**: {{ros__parameters: {{{text}}}}}")
    return path


def velocities(bag: Path, text: str = "", folder: Path | None = None) -> np.ndarray:
    parameters = load_parameters(config(folder, text)) if folder else None
    return np.array([s.vel_enu for s in read_samples(bag, parameters=parameters) if isinstance(s, GnssVelocity)])


# --- ros.input in replay ---------------------------------------------------------------------------------------------


def test_a_velocity_in_ned_is_turned_where_the_parameter_says_so(tmp_path, flight):
    """GIVEN a driver that publishes North-East-Down WHEN ros.input.velocity_frame is ned THEN replay reads ENU."""

    def to_ned(row: Row) -> list[Row]:
        if row[0] == "/gps/vel":
            v = row[3].twist.twist.linear
            v.x, v.y, v.z = v.y, v.x, -v.z
        return [row]

    bag = rewrite(flight, tmp_path / "bag", to_ned)
    wanted = velocities(flight)
    assert not np.array_equal(velocities(bag), wanted)
    np.testing.assert_array_equal(velocities(bag, "ros.input.velocity_frame: ned", tmp_path), wanted)


def test_a_vertical_velocity_that_is_never_filled_is_not_used_where_the_parameter_says_so(tmp_path, flight):
    """GIVEN a driver that leaves vz at zero WHEN vertical_velocity is false THEN Up is unknown, not zero."""
    read = velocities(flight, "ros.input.vertical_velocity: false", tmp_path)
    assert np.isnan(read[:, 2]).all()
    np.testing.assert_array_equal(read[:, :2], velocities(flight)[:, :2])


def test_the_height_does_not_suffer_from_a_velocity_that_is_never_filled(tmp_path):
    """GIVEN a climbing wing and vz zero WHEN the parameter says so THEN the height is as good as with a true vz."""
    good = tmp_path / "good"
    write_recording(good, generate("fixed_wing", 60.0, seed=5, imu_rate=50.0))

    def unfilled(row: Row) -> list[Row]:
        if row[0] == "/gps/vel":
            row[3].twist.twist.linear.z = 0.0
        return [row]

    bag = rewrite(good, tmp_path / "bag", unfilled)
    told, untold = vertical_rms(bag, config(tmp_path, "ros.input.vertical_velocity: false")), vertical_rms(bag, None)
    assert told < 1.5 * vertical_rms(good, None)
    assert untold < 1.5 * vertical_rms(good, None)  # it is found out by itself


def vertical_rms(bag: Path, parameter_file: Path | None) -> float:
    from nav_pose_estimator.offline.replay.replay import replay

    parameters = load_parameters(parameter_file)
    result = replay(load(bag, parameters=parameters), parameters, [])
    track, truth = result.track, result.reference
    chosen = track.t > 30.0
    true = np.interp(track.t[chosen], truth.t, truth.position[:, 2])
    return float(np.sqrt(np.mean((track.position[chosen, 2] - true) ** 2)))


@pytest.mark.parametrize(
    ("text", "missing"), [("ros.input.velocity: none", "/gps/vel"), ("gnss.gate.satellite_source: none", "/gps/satel")]
)
def test_an_input_that_is_switched_off_is_not_read(tmp_path, flight, text, missing):
    with BagReader(flight, parameters=load_parameters(config(tmp_path, text))) as reader:
        assert not [topic for topic in reader.topics.topics.values() if topic.name.startswith(missing)]
        assert any(missing in notice and "is none: left out" in notice for notice in reader.notices)


def test_a_type_that_is_chosen_is_the_only_one_that_is_read(tmp_path, flight):
    parameters = load_parameters(config(tmp_path, "ros.input.velocity: twist"))
    with BagReader(flight, parameters=parameters) as reader:
        assert "gps/vel" not in reader.topics.topics
        assert any(
            "must be geometry_msgs/msg/TwistStamped, for ros.input.velocity is twist" in n for n in reader.notices
        )


def test_another_type_than_the_default_is_read_and_the_user_told_what_a_node_needs(tmp_path, flight):
    """GIVEN TwistStamped and default parameters WHEN read THEN the velocities are there, and the parameter is named."""
    kind = "geometry_msgs/msg/TwistStamped"

    def plain(row: Row) -> list[Row]:
        message = row[3]
        return (
            [(row[0], kind, row[2], STORE.types[kind](message.header, message.twist.twist))]
            if row[1] == VELOCITY
            else [row]
        )

    bag = rewrite(flight, tmp_path / "bag", plain)
    np.testing.assert_array_equal(velocities(bag), velocities(flight))
    with BagReader(bag) as reader:
        assert any("a node needs ros.input.velocity: twist" in notice for notice in reader.notices)


def test_what_mavros_does_not_fill_is_told(tmp_path, flight):
    def as_mavros(row: Row) -> list[Row]:
        name = "/mavros/global_position/raw/gps_vel" if row[0] == "/gps/vel" else row[0]
        return [(name, *row[1:])]

    bag = rewrite(flight, tmp_path / "bag", as_mavros)
    assert np.isnan(velocities(bag)[:, 2]).all()
    with BagReader(bag) as reader:
        assert any("ros.input.vertical_velocity: false" in notice for notice in reader.notices)


def test_exponents_in_a_parameter_file_reach_the_filter(tmp_path):
    parameters = load_parameters(config(tmp_path, "imu: {gyro_noise: 5e-4, accel_noise: 2e-2, gyro_bias_tau: 3e3}"))
    assert (parameters.imu.gyro_noise, parameters.imu.accel_noise, parameters.imu.gyro_bias_tau) == (5e-4, 2e-2, 3e3)


# --- topics of other types, of other vehicles, of halves -------------------------------------------------------------


def test_a_magnetometer_of_another_type_is_left_out_with_a_note(tmp_path, flight, capsys):
    """GIVEN imu/mag as Vector3Stamped WHEN replayed THEN it is left out, the note says so, and the exit code is 0."""

    def of_old(row: Row) -> list[Row]:
        if row[0] != "/imu/mag":
            return [row]
        return [(row[0], VECTOR, row[2], STORE.types[VECTOR](row[3].header, row[3].magnetic_field))]

    bag = rewrite(flight, tmp_path / "bag", of_old)
    assert main(["replay", str(bag), "--out", str(tmp_path / "out")]) == 0
    note = "/imu/mag is of type geometry_msgs/msg/Vector3Stamped; as /imu/mag it must be sensor_msgs/msg/MagneticField"
    assert f"note: {note}: left out" in capsys.readouterr().err
    assert not any(isinstance(sample, MagSample) for sample in read_samples(bag))


def test_a_topic_that_the_user_names_must_fit(tmp_path, flight):
    with pytest.raises(BagError, match=r"/gps/vel is of type .*; as /imu/mag it must be sensor_msgs/msg/MagneticField"):
        BagReader(flight, {"/imu/mag": "/gps/vel"})


@pytest.fixture(scope="module")
def two_drones(tmp_path_factory, flight) -> Path:
    """drone1 has everything; drone2 is half a second late, its GNSS has other names, and it has no magnetometer."""
    names = {"gps/fix": "gnss/position", "gps/vel": "gnss/velocity", "gps/satellites": "gnss/satellites"}
    messages = []
    for topic, kind, time, message in rows(flight):
        if topic.startswith("/ground_truth"):
            continue
        messages.append((f"/drone1{topic}", kind, time, message))
        name = topic[1:]
        if name != "imu/mag":
            messages.append((f"/drone2/{names.get(name, name)}", kind, time + 500_000_000, message))
    return write_rows(tmp_path_factory.mktemp("two") / "bag", messages)


def test_two_drones_in_one_bag_are_named_with_the_option_that_chooses(two_drones):
    with pytest.raises(BagError) as refusal:
        BagReader(two_drones)
    text = "the bag holds several vehicles or IMUs (/drone1, /drone2): choose one with --remap __ns:=/drone1"
    assert str(refusal.value) == text


@pytest.mark.parametrize("option", ["__ns:=/drone2", "/imu/data_raw:=/drone2/imu/data_raw"])
def test_nothing_of_the_other_drone_is_read(two_drones, option):
    """GIVEN two drones WHEN the second is chosen THEN all topics are its own, and what it has not is missing."""
    with BagReader(two_drones, parse_remaps([option])) as reader:
        topics = reader.topics.topics
    assert {topic.name.split("/")[1] for topic in topics.values()} == {"drone2"}
    assert topics["gps/fix"].name == "/drone2/gnss/position"
    assert topics["gps/vel"].name == "/drone2/gnss/velocity"
    assert "imu/mag" not in topics


def test_a_namespace_without_topics_is_refused(two_drones):
    with pytest.raises(BagError, match="there is no topic below /drone3 in the bag"):
        BagReader(two_drones, parse_remaps(["__ns:=/drone3"]))


def test_the_truth_of_nobody_in_particular_judges_no_drone(tmp_path, two_drones, flight):
    truth = [row for row in rows(flight) if row[0].startswith("/ground_truth")]
    bag = write_rows(tmp_path / "bag", rows(two_drones) + truth)
    with BagReader(bag, parse_remaps(["__ns:=/drone1"])) as reader:
        assert reader.topics.truth is None
        assert any("may be another vehicle's" in notice for notice in reader.notices)
    with BagReader(bag, parse_remaps(["__ns:=/drone1", "/ground_truth/odom:=/ground_truth/odom"])) as reader:
        assert reader.topics.truth is not None


def split(row: Row) -> list[Row]:
    """Gyroscope and accelerometer as a camera publishes them: two topics, the other half zero."""
    _, kind, time, message = row
    if kind != IMU:
        return [row]
    gyro, accel = copy.deepcopy(message), copy.deepcopy(message)
    for vector in (gyro.linear_acceleration, accel.angular_velocity):
        vector.x = vector.y = vector.z = 0.0
    return [("/camera/gyro/sample", kind, time, gyro), ("/camera/accel/sample", kind, time, accel)]


@pytest.fixture(scope="module")
def halves(tmp_path_factory, flight) -> Path:
    return rewrite(flight, tmp_path_factory.mktemp("halves") / "bag", split)


@pytest.mark.parametrize(
    ("remaps", "says"),
    [
        ({}, r"gyroscope and accelerometer are on two topics .*needed in one message: let the driver join them"),
        ({"/imu/data_raw": "/camera/gyro/sample"}, r"no linear acceleration .*both needed"),
        ({"/imu/data_raw": "/camera/accel/sample"}, r"accel/sample has an angular velocity .*which navigation needs"),
    ],
    ids=["both", "gyroscope", "accelerometer"],
)
def test_half_an_imu_is_no_imu(halves, remaps, says):
    with pytest.raises(BagError, match=says):
        load(halves, remaps)


def test_an_imu_that_starts_at_rest_is_whole(tmp_path, flight):
    """GIVEN an IMU whose rates are zero at first WHEN they come later THEN nothing is refused."""

    def late(row: Row) -> list[Row]:
        if row[1] == IMU and row[2] < first + 5 * 10**9:
            rate = row[3].angular_velocity
            rate.x = rate.y = rate.z = 0.0
        return [row]

    first = rows(flight)[0][2]
    bag = rewrite(flight, tmp_path / "bag", late)
    assert sum(len(s) for s in read_samples(bag) if isinstance(s, ImuBlock)) == sum(
        len(s) for s in read_samples(flight) if isinstance(s, ImuBlock)
    )


def test_messages_of_ros_1_are_named_with_what_converts_them(tmp_path):
    """GIVEN an mcap made of a ROS 1 bag WHEN read THEN one sentence says ROS 1 and names the converter."""

    def text(value: str) -> bytes:
        return struct.pack("<I", len(value)) + value.encode()

    def record(code: int, body: bytes) -> bytes:
        return struct.pack("<BQ", code, len(body)) + body

    magic, empty = b"\x89MCAP0\r\n", struct.pack("<I", 0)
    data = magic + record(1, text("ros1") + text("converter"))
    for i, (topic, kind) in enumerate([("/imu/data_raw", "sensor_msgs/Imu"), ("/gps/fix", "sensor_msgs/NavSatFix")], 1):
        data += record(3, struct.pack("<H", i) + text(kind) + text("ros1msg") + text("Header header\n"))
        data += record(4, struct.pack("<HH", i, i) + text(topic) + text("ros1") + empty)
    for k in range(20):
        data += record(5, struct.pack("<HIQQ", 1, k, 10**18 + k, 10**18 + k) + bytes(340))
    data += record(0x0F, empty) + record(2, struct.pack("<QQI", 0, 0, 0)) + magic
    path = tmp_path / "ros1.mcap"
    path.write_bytes(data)
    with pytest.raises(BagError, match=r"holds ROS 1 messages.*rosbags-convert --src"):
        BagReader(path)


def test_the_flight_itself_is_read_without_a_note(flight):
    with BagReader(flight) as reader:
        assert len(one_by_one(reader.samples())) > 2000
        assert reader.notices == []
