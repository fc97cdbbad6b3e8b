"""Serialization of many sensor_msgs/PointCloud2 of one size at once, with beams as of a Doppler radar."""

from typing import Any

import numpy as np

from nav_pose_estimator.offline.bags.cdr_packing import typestore

KIND = "sensor_msgs/msg/PointCloud2"
_FLOAT32 = 7  # sensor_msgs/PointField
_COLUMNS = ("x", "y", "z", "velocity")
_STAMP, _TAIL = 4, 1  # bytes before the stamp, and after the data (is_dense)


def pack_beams(stamps_ns: list[int], directions: np.ndarray, velocities: np.ndarray, frame: str) -> np.ndarray:
    """Messages (N, length) uint8 with a point for each of k beams: its direction x, y, z and its ``velocity``.

    ``directions`` (N, k, 3), ``velocities`` (N, k) [m/s], NaN for a lost beam. The fields are in single precision.
    """
    points = np.concatenate([directions, velocities[..., None]], axis=-1).astype("<f4").reshape(len(stamps_ns), -1)
    data = np.ascontiguousarray(points).view(np.uint8)
    row = np.frombuffer(bytes(typestore().serialize_cdr(_empty(velocities.shape[1], frame), KIND)), np.uint8)
    rows = np.tile(row, (len(stamps_ns), 1))
    seconds, nanoseconds = np.divmod(np.asarray(stamps_ns, np.int64), 1_000_000_000)
    stamp = np.column_stack([seconds, nanoseconds]).astype("<u4")
    rows[:, _STAMP : _STAMP + 8] = stamp.view(np.uint8)
    rows[:, -_TAIL - data.shape[1] : -_TAIL] = data
    return rows


def _empty(beams: int, frame: str) -> Any:
    """A cloud of ``beams`` points with zeros, as a template."""
    types = typestore().types
    step = 4 * len(_COLUMNS)
    fields = [types["sensor_msgs/msg/PointField"](name, 4 * i, _FLOAT32, 1) for i, name in enumerate(_COLUMNS)]
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](0, 0), frame)
    data = np.zeros(step * beams, np.uint8)
    return types[KIND](header, 1, beams, fields, False, step, step * beams, data, False)
