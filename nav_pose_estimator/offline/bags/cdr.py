"""Decoding the few message types that an estimator reads: one at a time, or all messages of a batch at once.

A layout line lists the fields of a message in CDR order (OMG DDS-XTypes 1.3, plain CDR): ``path:type*count``, where
type is ``str``, or a numpy code such as ``f8``. Other types are read with rosbags and the definition in the bag.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np

from nav_pose_estimator.offline.bags.raw_messages import BagError, RawBatch, Topic

_HEADER = "header.stamp.sec:i4 header.stamp.nanosec:u4 header.frame_id:str "
_POSE = "pose.pose.position:xyz pose.pose.orientation:xyzw pose.covariance:f8*36 "
_TWIST = "twist.linear:xyz twist.angular:xyz "

LAYOUTS: dict[str, str] = {
    "sensor_msgs/msg/Imu": _HEADER + "orientation:xyzw orientation_covariance:f8*9 angular_velocity:xyz "
    "angular_velocity_covariance:f8*9 linear_acceleration:xyz linear_acceleration_covariance:f8*9",
    "sensor_msgs/msg/MagneticField": _HEADER + "magnetic_field:xyz magnetic_field_covariance:f8*9",
    "sensor_msgs/msg/FluidPressure": _HEADER + "fluid_pressure:f8 variance:f8",
    "sensor_msgs/msg/NavSatFix": _HEADER + "status.status:i1 status.service:u2 latitude:f8 longitude:f8 altitude:f8 "
    "position_covariance:f8*9 position_covariance_type:u1",
    "geometry_msgs/msg/TwistStamped": _HEADER + _TWIST,
    "geometry_msgs/msg/TwistWithCovarianceStamped": _HEADER + "twist.twist.linear:xyz twist.twist.angular:xyz "
    "twist.covariance:f8*36",
    "geometry_msgs/msg/PoseWithCovarianceStamped": _HEADER + _POSE,
    "nav_msgs/msg/Odometry": _HEADER + "child_frame_id:str " + _POSE + "twist.twist.linear:xyz "
    "twist.twist.angular:xyz twist.covariance:f8*36",
    "std_msgs/msg/UInt32": "data:u4",
}
_VECTORS = {"xyz": 3, "xyzw": 4}
_STRUCT = {"f8": "d", "i4": "i", "u4": "I", "u2": "H", "i1": "b", "u1": "B"}
LITTLE_ENDIAN = b"\x00\x01"


@dataclass(frozen=True, slots=True)
class _Field:
    path: tuple[str, ...]
    code: str  # numpy code, "str", "xyz" or "xyzw"
    kind: str  # struct code
    size: int  # bytes of one number
    numbers: int  # how many of them
    is_array: bool


def _parse(line: str) -> list[_Field]:
    fields = []
    for item in line.split():
        path, code = item.split(":")
        code, _, count = code.partition("*")
        base = "f8" if code in _VECTORS else "u4" if code == "str" else code
        numbers = _VECTORS.get(code, int(count or 1))
        fields.append(_Field(tuple(path.split(".")), code, _STRUCT[base], int(base[1:]), numbers, bool(count)))
    return fields


_FIELDS = {name: _parse(line) for name, line in LAYOUTS.items()}


@cache
def _segment(kind: str, first: int, phase: int, order: str) -> tuple[struct.Struct, list[tuple[_Field, int]], int]:
    """Fields from number ``first`` up to the next string, which is there as its length.

    Returns how to unpack them from a place ``phase`` (mod 8) beyond the encapsulation header, the fields with the byte
    at which each begins, and the number of the field after them. CDR aligns every number to its own size.
    """
    form, places, position = order, [], phase
    index = first
    for field in _FIELDS[kind][first:]:
        gap = -position % field.size
        form += f"{gap}x" * (gap > 0) + f"{field.numbers}{field.kind}"
        places.append((field, position + gap - phase))
        position += gap + field.numbers * field.size
        index += 1
        if field.code == "str":
            break
    return struct.Struct(form), places, index


def _walk(kind: str, payload: bytes, order: str) -> Iterator[tuple[_Field, int, tuple]]:
    """(field, its offset in the payload, its values); for a string the offset of its characters and their number."""
    position, index = 4, 0
    while index < len(_FIELDS[kind]):
        layout, places, index = _segment(kind, index, (position - 4) % 8, order)
        values = layout.unpack_from(payload, position)
        used = 0
        for field, offset in places:
            is_text = field.code == "str"
            yield field, position + offset + 4 * is_text, values[used : used + field.numbers]
            used += field.numbers
        position += layout.size + (values[-1] if is_text else 0)


def decode(kind: str, payload: bytes) -> Any:
    """One message as nested attributes, as rclpy or rosbags would give it. ``BagError`` if it is damaged."""
    if len(payload) < 4 or payload[0] != 0 or payload[1] not in (0, 1):
        raise BagError(f"a {kind} message is not in plain CDR")
    order = "<" if payload[1] == 1 else ">"
    message = SimpleNamespace()
    try:
        for field, position, values in _walk(kind, payload, order):
            _assign(message, field.path, _value(field, payload, position, values))
    except struct.error:
        raise BagError(f"a {kind} message of {len(payload)} bytes is too short") from None
    return message


def _value(field: _Field, payload: bytes, position: int, values: tuple) -> Any:
    if field.code == "str":
        return payload[position : position + max(values[0] - 1, 0)].decode("utf-8", "replace")
    if field.code in _VECTORS:
        return SimpleNamespace(**dict(zip(field.code, values, strict=True)))
    return np.array(values) if field.is_array else values[0]


def _assign(message: Any, path: tuple[str, ...], value: Any) -> None:
    for name in path[:-1]:
        if not hasattr(message, name):
            setattr(message, name, SimpleNamespace())
        message = getattr(message, name)
    setattr(message, path[-1], value)


def columns(kind: str, batch: RawBatch, names: tuple[str, ...]) -> dict[str, np.ndarray] | None:
    """Fields ``names`` of all messages: ``stamp_ns`` (N,) and dotted paths -> (N,) or (N, k).

    None unless every message has the length, the string lengths and the byte order of the first.
    """
    length = int(batch.lengths[0])
    if not (batch.lengths == length).all():
        return None
    buffer = np.frombuffer(batch.data, np.uint8)
    first = batch.payload(0)
    if first[:2] != LITTLE_ENDIAN:
        return None
    try:
        places = list(_walk(kind, first, "<"))
    except struct.error:
        return None
    if not (_gather(buffer, batch.offsets, 2) == np.frombuffer(LITTLE_ENDIAN, np.uint8)).all():
        return None
    found: dict[str, np.ndarray] = {}
    for field, position, value in places:
        name = ".".join(field.path)
        if field.code == "str":
            lengths = _gather(buffer, batch.offsets + position - 4, 4).view("<u4")
            if not (lengths == value[0]).all():
                return None
        elif name in names or name.startswith("header.stamp"):
            values = _gather(buffer, batch.offsets + position, field.numbers * field.size).view(_numpy_code(field))
            found[name] = values if values.shape[1] > 1 else values[:, 0]
    if "header.stamp.sec" in found:
        # An array, not only a scalar, has to be int64: NumPy 1 goes by the value of a scalar and would stay with int32.
        found["stamp_ns"] = found.pop("header.stamp.sec").astype(np.int64) * 10**9 + found.pop("header.stamp.nanosec")
    return found


def _numpy_code(field: _Field) -> str:
    return "<f8" if field.code in _VECTORS else "<" + field.code


def _gather(buffer: np.ndarray, starts: np.ndarray, size: int) -> np.ndarray:
    """(N, size) bytes from the places ``starts`` (N,)."""
    windows = np.lib.stride_tricks.sliding_window_view(buffer, size)
    return np.ascontiguousarray(windows[starts])


class Decoder:
    """Messages of one topic: the layouts above, else rosbags with the definition that the bag carries."""

    def __init__(self, topic: Topic) -> None:
        """Raises ``BagError`` for a type that neither this module nor the bag describes."""
        self._topic = topic
        self._store = None if topic.type in LAYOUTS else _typestore(topic)

    def __call__(self, payload: bytes) -> Any:
        """One message."""
        if self._store is None:
            return decode(self._topic.type, payload)
        try:
            return self._store.deserialize_cdr(payload, self._topic.type)
        except Exception as error:  # generated code raises whatever the damaged bytes lead to
            raise BagError(f"a {self._topic.type} message is damaged ({error})") from None


def _typestore(topic: Topic) -> Any:
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    if topic.type not in store.types:
        if not topic.definition:
            raise BagError(f"{topic.name} is of type {topic.type}, which the bag does not describe")
        try:
            types = get_types_from_msg(topic.definition, topic.type)
            store.register({name: fields for name, fields in types.items() if name not in store.types})
        except Exception as error:  # whatever the grammar of the definitions stumbles over
            raise BagError(f"{topic.name}: the definition of {topic.type} cannot be read ({error})") from None
    return store
