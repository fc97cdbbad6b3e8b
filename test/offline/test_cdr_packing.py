"""Packed messages are byte for byte what rosbags serializes one by one."""

import numpy as np
import pytest

from nav_pose_estimator.offline.bags.cdr_packing import pack, typestore

STAMPS = np.array([1_700_000_000_123_456_789, 1_700_000_001_000_000_000, 5])


def deserialized(kind: str, rows: np.ndarray) -> list:
    return [typestore().deserialize_cdr(row.tobytes(), kind) for row in rows]


@pytest.mark.parametrize(
    ("kind", "fields"),
    [
        (
            "sensor_msgs/msg/Imu",
            {
                "header.stamp": STAMPS,
                "header.frame_id": "imu",
                "orientation.w": 1.0,
                "orientation_covariance": np.arange(9.0),
                "angular_velocity": np.arange(9.0).reshape(3, 3),
                "linear_acceleration": np.arange(9.0).reshape(3, 3) * 1e-7,
            },
        ),
        (
            "nav_msgs/msg/Odometry",
            {
                "header.stamp": STAMPS,
                "header.frame_id": "map",
                "child_frame_id": "base_link",
                "pose.pose.position": np.eye(3),
                "pose.pose.orientation": np.arange(12.0).reshape(3, 4),
                "pose.covariance": np.arange(108.0).reshape(3, 36),
                "twist.twist": np.arange(18.0).reshape(3, 6),
            },
        ),
        (
            "sensor_msgs/msg/NavSatFix",
            {
                "header.stamp": STAMPS,
                "header.frame_id": "gps_link",
                "status.status": [-1, 0, 2],
                "status.service": 1,
                "latitude": [1.5, 2.5, np.nan],
                "position_covariance_type": np.array([0, 2, 3]),
            },
        ),
        ("geometry_msgs/msg/TwistWithCovarianceStamped", {"header.stamp": STAMPS, "twist.twist.linear": np.eye(3)}),
        ("sensor_msgs/msg/FluidPressure", {"header.stamp": STAMPS, "header.frame_id": "ä", "variance": 4.0}),
        ("std_msgs/msg/UInt32", {"data": [0, 255, 4_000_000_000]}),
        ("std_msgs/msg/Bool", {"data": [True, False, True]}),
        ("std_msgs/msg/String", {"data": "the same in all"}),
    ],
)
def test_bytes_equal_those_of_one_by_one_serialization(kind: str, fields: dict) -> None:
    rows = pack(kind, 3, fields)
    messages = deserialized(kind, rows)
    assert [bytes(typestore().serialize_cdr(m, kind)) for m in messages] == [row.tobytes() for row in rows]
    if "header.stamp" in fields:
        stamps = [message.header.stamp.sec * 10**9 + message.header.stamp.nanosec for message in messages]
        assert stamps == STAMPS.tolist()
    if "header.frame_id" in fields:
        assert messages[0].header.frame_id == fields["header.frame_id"]


def test_values_land_where_they_belong() -> None:
    twist = np.arange(18.0).reshape(3, 6)
    rows = pack("nav_msgs/msg/Odometry", 3, {"twist.twist": twist, "pose.pose.orientation": [[0.0, 0.0, 0.6, 0.8]] * 3})
    message = deserialized("nav_msgs/msg/Odometry", rows)[1]
    assert (message.twist.twist.linear.x, message.twist.twist.angular.z) == (6.0, 11.0)
    assert (message.pose.pose.orientation.z, message.pose.pose.orientation.w) == (0.6, 0.8)
    assert message.child_frame_id == ""
    counts = deserialized("std_msgs/msg/UInt32", pack("std_msgs/msg/UInt32", 3, {"data": [0, 255, 4_000_000_000]}))
    assert [count.data for count in counts] == [0, 255, 4_000_000_000]


@pytest.mark.parametrize(
    ("kind", "fields"),
    [
        ("std_msgs/msg/UInt32", {"date": 1}),
        ("sensor_msgs/msg/Imu", {"header.frame": "imu"}),
        ("sensor_msgs/msg/Imu", {"header.frame_id": 3.0}),
        ("diagnostic_msgs/msg/DiagnosticArray", {}),
    ],
)
def test_mistakes_are_not_written(kind: str, fields: dict) -> None:
    with pytest.raises(KeyError):
        pack(kind, 1, fields)
