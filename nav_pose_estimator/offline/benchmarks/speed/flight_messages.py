"""Samples of a flight back into serialized messages, for bags that benchmark and tests make."""

import math
from typing import Any

import numpy as np

from nav_pose_estimator.engine.samples import GnssFix, GnssVelocity, ImuSample, MagSample, PressureSample, Sample


def imu_bytes(sample: ImuSample) -> bytes:
    """A sensor_msgs/Imu in plain CDR: header with frame ``imu_link``, then 37 doubles."""
    seconds, nanoseconds = divmod(sample.stamp_ns, 10**9)
    head = np.array([seconds, nanoseconds, 9], "<u4").tobytes() + b"imu_link\0"
    body = np.zeros(37)
    body[3] = 1.0
    body[13:16], body[25:28] = sample.gyro, sample.accel
    return b"\x00\x01\x00\x00" + head + b"\0" * (-len(head) % 8) + body.tobytes()


def message_of(sample: Sample, store: Any) -> tuple[str, str, bytes]:
    """(topic, type, bytes) of a sample, with rosbags' type ``store``."""
    if isinstance(sample, ImuSample):
        return "/imu/data_raw", "sensor_msgs/msg/Imu", imu_bytes(sample)
    types = store.types
    stamp = types["builtin_interfaces/msg/Time"](sec=sample.stamp_ns // 10**9, nanosec=sample.stamp_ns % 10**9)
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="base_link")
    vector = types["geometry_msgs/msg/Vector3"]
    if isinstance(sample, MagSample):
        topic, kind = "/imu/mag", "sensor_msgs/msg/MagneticField"
        message = types[kind](header, vector(*sample.field), np.zeros(9))
    elif isinstance(sample, GnssFix):
        topic, kind = "/gps/fix", "sensor_msgs/msg/NavSatFix"
        status = types["sensor_msgs/msg/NavSatStatus"](status=sample.status, service=1)
        place = math.degrees(sample.lat), math.degrees(sample.lon), sample.alt
        message = types[kind](header, status, *place, np.zeros(9), 0)
    elif isinstance(sample, GnssVelocity):
        topic, kind = "/gps/vel", "geometry_msgs/msg/TwistWithCovarianceStamped"
        twist = types["geometry_msgs/msg/Twist"](vector(*sample.vel_enu), vector(0.0, 0.0, 0.0))
        message = types[kind](header, types["geometry_msgs/msg/TwistWithCovariance"](twist, np.zeros(36)))
    elif isinstance(sample, PressureSample):
        topic, kind = "/baro", "sensor_msgs/msg/FluidPressure"
        message = types[kind](header, sample.pressure, 0.0)
    else:
        raise TypeError(f"no message is known for {type(sample).__name__}")
    return topic, kind, bytes(store.serialize_cdr(message, kind))
