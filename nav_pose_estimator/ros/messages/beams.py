"""Conversion of beam velocities: marine_acoustic_msgs/Dvl, dvl_msgs/DVL of Water Linked, sensor_msgs/PointCloud2.

Drivers often fill the fields with something else than their definition. In most of them ``beam_velocities_valid`` of a
Dvl is the validity of the 3-D velocity, which is false exactly when single beams would help. It is therefore applied to
the 3-D velocity only, and beams are judged by their values and ranges. ``num_good_beams`` is ignored, and a variance of
-1 or 0 means unknown.
"""

import math
from typing import Any

import numpy as np

from nav_pose_estimator.engine.samples import BeamVelocitySample, Vector3
from nav_pose_estimator.engine.solutions import Event, Level
from nav_pose_estimator.ros.messages.convert import Converted, stamp_ns, vector

_WATER = 2  # velocity_mode of a Dvl: relative to the water, not to the ground
_BEAMS_OF_A50 = 4
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}  # sensor_msgs/PointField
_AXES = ("x", "y", "z")
_MOST_BYTES = 1 << 24  # largest point cloud that is read


def dvl(message: Any) -> Converted:
    """marine_acoustic_msgs/Dvl: four beams with directions, in axes with z along the line of sight and x forward."""
    stamp = stamp_ns(message)
    if message.velocity_mode == _WATER:
        return _refused(stamp, "water", "the sensor measures relative to the water (velocity_mode 2), not the ground")
    variances = np.array(message.beam_velocity_covar, float)
    sample = BeamVelocitySample(
        stamp,
        _vectors(message.beam_unit_vec),
        np.array(message.beam_velocity, float),
        np.where(variances > 0.0, variances, math.nan),
        _valid_velocity(message.velocity, message.beam_velocities_valid),
        np.array(message.range, float) if message.beam_ranges_valid else None,
    )
    return (sample,)


def a50(message: Any) -> Converted:
    """dvl_msgs/DVL of Water Linked's A50 and A125: numbered beams without directions, stamped on reception."""
    found = sorted(message.beams, key=lambda beam: beam.id)
    first = 1 if found and found[0].id > 0 and found[-1].id == _BEAMS_OF_A50 else 0
    places = [int(beam.id) - first for beam in found]
    if not found or len(set(places)) < len(places) or not all(0 <= place < _BEAMS_OF_A50 for place in places):
        return _refused(stamp_ns(message), "beams", f"its beams are numbered {[int(beam.id) for beam in found]}")
    velocities = np.full(_BEAMS_OF_A50, math.nan)
    ranges, valid = np.zeros(_BEAMS_OF_A50), np.zeros(_BEAMS_OF_A50, bool)
    for place, beam in zip(places, found, strict=True):
        velocities[place], ranges[place], valid[place] = beam.velocity, beam.distance, bool(beam.valid)
    sample = BeamVelocitySample(
        stamp_ns(message),
        np.full((_BEAMS_OF_A50, 3), math.nan),
        velocities,
        velocity=_valid_velocity(message.velocity, message.velocity_valid),
        ranges=ranges,
        valid=valid,
    )
    return (sample,)


def point_cloud(message: Any) -> Converted:
    """sensor_msgs/PointCloud2: x, y, z of a point or direction, ``velocity`` along it, optionally ``variance``."""
    stamp = stamp_ns(message)
    offered = {field.name: field for field in message.fields}
    missing = [name for name in (*_AXES, "velocity") if name not in offered]
    if missing:
        have = ", ".join(list(offered)[:20]) or "none at all"
        return _refused(stamp, "fields", f"the point cloud has no field {missing[0]} (its fields: {have})")
    names = (*_AXES, "velocity", *(["variance"] if "variance" in offered else []))
    columns = _columns(message, [offered[name] for name in names])
    if columns is None:
        return _refused(stamp, "layout", "the length of the point cloud's data does not match its fields and width")
    points, rest = columns[:, :3], columns[:, 3:]
    lengths = np.sqrt(np.square(points).sum(axis=1))
    seen = np.isfinite(lengths) & (lengths > 0.0)
    variances = None
    if rest.shape[1] > 1:
        variances = np.where(rest[seen, 1] > 0.0, rest[seen, 1], math.nan)
    return (BeamVelocitySample(stamp, points[seen] / lengths[seen, None], rest[seen, 0], variances),)


def _columns(message: Any, fields: list[Any]) -> np.ndarray | None:
    """Columns (N, k) of a point cloud as float64; None where the message is inconsistent."""
    width, height, step, row_step = (
        int(value) for value in (message.width, message.height, message.point_step, message.row_step)
    )
    data = np.frombuffer(bytes(message.data), np.uint8)
    sizes = [np.dtype(_NUMBERS.get(int(field.datatype), "V0")).itemsize for field in fields]
    is_whole = all(size and int(field.offset) + size <= step for field, size in zip(fields, sizes, strict=True))
    if not is_whole or step * width > row_step or row_step * height > min(len(data), _MOST_BYTES):
        return None
    rows = data[: row_step * height].reshape(height, row_step)[:, : step * width].reshape(-1, step)
    order = ">" if message.is_bigendian else "<"
    columns = [
        np.ascontiguousarray(rows[:, int(field.offset) : int(field.offset) + size])
        .view(order + _NUMBERS[int(field.datatype)])[:, 0]
        .astype(float)
        for field, size in zip(fields, sizes, strict=True)
    ]
    return np.column_stack(columns)


def _vectors(field: Any) -> np.ndarray:
    """Vectors (n, 3) of a message, from a flat array of numbers or from vector messages."""
    if isinstance(field, np.ndarray) and field.dtype != object:
        return field.reshape(-1, 3)
    return np.array([vector(one) for one in field]).reshape(-1, 3)


def _valid_velocity(field: Any, is_valid: bool) -> Vector3 | None:
    velocity = vector(field)
    return velocity if is_valid and all(map(math.isfinite, velocity)) and any(velocity) else None


def _refused(stamp: int, reason: str, why: str) -> tuple[Event]:
    return (Event(stamp, f"beam_velocity.rejected.{reason}", Level.WARN, f"beam velocities not used: {why}"),)
