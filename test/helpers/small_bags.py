"""Small bags with individual messages, for the tests of bag readers."""

from pathlib import Path

import numpy as np
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)
TYPES = STORE.types
EPOCH_NS = 1_700_000_000_000_000_000
IMU, MAG, FIX = "sensor_msgs/msg/Imu", "sensor_msgs/msg/MagneticField", "sensor_msgs/msg/NavSatFix"
VELOCITY, PRESSURE = "geometry_msgs/msg/TwistWithCovarianceStamped", "sensor_msgs/msg/FluidPressure"
COUNT = "std_msgs/msg/UInt32"


def header(stamp_ns: int, frame: str = "imu_link"):
    stamp = TYPES["builtin_interfaces/msg/Time"](sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    return TYPES["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)


def vector(x: float, y: float, z: float):
    return TYPES["geometry_msgs/msg/Vector3"](x=float(x), y=float(y), z=float(z))


def imu(stamp_ns: int, gyro=(0.0, 0.0, 0.0), accel=(0.0, 0.0, 9.81), frame: str = "imu_link"):
    return TYPES[IMU](
        header=header(stamp_ns, frame),
        orientation=TYPES["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
        orientation_covariance=np.full(9, -1.0),
        angular_velocity=vector(*gyro),
        angular_velocity_covariance=np.zeros(9),
        linear_acceleration=vector(*accel),
        linear_acceleration_covariance=np.zeros(9),
    )


def fix(stamp_ns: int, lat_deg: float = 48.0, lon_deg: float = 11.0, alt: float = 500.0):
    return TYPES[FIX](
        header=header(stamp_ns, "gps"),
        status=TYPES["sensor_msgs/msg/NavSatStatus"](status=0, service=1),
        latitude=lat_deg,
        longitude=lon_deg,
        altitude=alt,
        position_covariance=np.zeros(9),
        position_covariance_type=0,
    )


def velocity(stamp_ns: int, v=(0.0, 0.0, 0.0)):
    twist = TYPES["geometry_msgs/msg/Twist"](linear=vector(*v), angular=vector(0, 0, 0))
    with_covariance = TYPES["geometry_msgs/msg/TwistWithCovariance"](twist=twist, covariance=np.zeros(36))
    return TYPES[VELOCITY](header=header(stamp_ns, "enu"), twist=with_covariance)


def magnetic(stamp_ns: int):
    return TYPES[MAG](
        header=header(stamp_ns), magnetic_field=vector(2e-5, 1e-6, -4e-5), magnetic_field_covariance=np.zeros(9)
    )


def pressure(stamp_ns: int, value: float = 95000.0):
    return TYPES[PRESSURE](header=header(stamp_ns, "base"), fluid_pressure=value, variance=0.0)


def count(value: int = 9):
    return TYPES[COUNT](data=value)


def flight(seconds: float = 4.0, rate: int = 100, imu_topic: str = "/imu/data_raw"):
    """(receive time, topic, type, message) of a short recording; the IMU's values depend on their index."""
    messages = []
    for i in range(int(seconds * rate)):
        t = EPOCH_NS + i * 10**9 // rate
        messages.append((t, imu_topic, IMU, imu(t, (i * 1e-4, 0.0, 0.0), (0.0, 0.0, 9.8 + i * 1e-5))))
        if i % 20 == 7:
            messages += [(t + 1000, "/gps/fix", FIX, fix(t)), (t + 2000, "/gps/satellites", COUNT, count())]
            messages.append((t + 1500, "/gps/vel", VELOCITY, velocity(t, (1.0, 2.0, 0.0))))
        if i % 10 == 3:
            messages.append((t + 3000, "/imu/mag", MAG, magnetic(t)))
            messages.append((t + 3500, "/baro", PRESSURE, pressure(t)))
    return sorted(messages, key=lambda item: item[0])


def write_bag(
    path: Path, messages, storage=StoragePlugin.MCAP, compression: CompressionMode | None = None, store=STORE
) -> Path:
    writer = Writer(path, version=9, storage_plugin=storage)
    if compression is not None:
        writer.set_compression(compression, CompressionFormat.ZSTD)
    with writer:
        connections = {}
        for stamp, topic, kind, message in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(connections[topic], stamp, store.serialize_cdr(message, kind))
    return path
