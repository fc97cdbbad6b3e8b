"""Decoding of serialized messages, for nodes and bags: a whole message, some of its fields, or columns of many.

A layout line lists the fields of a message in the order of plain CDR (OMG DDS-XTypes 1.3, section 7.4.3): a four-byte
encapsulation header, then fields aligned to their size counted from the end of that header. A field is written
``path:type*count``, where type is ``str``, a numpy code such as ``f8``, or ``xyz`` and ``xyzw`` for vectors of ``f8``;
``?`` marks a field that older distributions do not have.

All lengths in the bytes are checked: the result is a message or a ``CdrError``, whatever the bytes are.
"""

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from types import SimpleNamespace
from typing import Any, Protocol

import numpy as np

from nav_pose_estimator.errors import UserError

NS_PER_S = 1_000_000_000
_HEADER = "header.stamp.sec:i4 header.stamp.nanosec:u4 header.frame_id:str "
_POSE = "pose.pose.position:xyz pose.pose.orientation:xyzw pose.covariance:f8*36 "
_TWIST = "twist.twist.linear:xyz twist.twist.angular:xyz twist.covariance:f8*36"

LAYOUTS: dict[str, str] = {
    "sensor_msgs/msg/Imu": _HEADER + "orientation:xyzw orientation_covariance:f8*9 angular_velocity:xyz "
    "angular_velocity_covariance:f8*9 linear_acceleration:xyz linear_acceleration_covariance:f8*9",
    "sensor_msgs/msg/MagneticField": _HEADER + "magnetic_field:xyz magnetic_field_covariance:f8*9",
    "sensor_msgs/msg/FluidPressure": _HEADER + "fluid_pressure:f8 variance:f8",
    "sensor_msgs/msg/NavSatFix": _HEADER + "status.status:i1 status.service:u2 latitude:f8 longitude:f8 altitude:f8 "
    "position_covariance:f8*9 position_covariance_type:u1",
    "sensor_msgs/msg/Range": _HEADER + "radiation_type:u1 field_of_view:f4 min_range:f4 max_range:f4 range:f4 "
    "variance:f4?",
    "geometry_msgs/msg/TwistStamped": _HEADER + "twist.linear:xyz twist.angular:xyz",
    "geometry_msgs/msg/TwistWithCovarianceStamped": _HEADER + _TWIST,
    "geometry_msgs/msg/PoseWithCovarianceStamped": _HEADER + _POSE,
    "nav_msgs/msg/Odometry": _HEADER + "child_frame_id:str " + _POSE + _TWIST,
    "marine_acoustic_msgs/msg/Dvl": _HEADER + "velocity_mode:u1 dvl_type:u1 velocity:xyz velocity_covar:f8*9 "
    "altitude:f8 course_gnd:f8 speed_gnd:f8 num_good_beams:u1 sound_speed:f4 beam_ranges_valid:u1 "
    "beam_velocities_valid:u1 beam_unit_vec:f8*12 range:f8*4 range_covar:f4*4 beam_quality:f4*4 beam_velocity:f4*4 "
    "beam_velocity_covar:f4*4",
    "std_msgs/msg/UInt32": "data:u4",
    "std_msgs/msg/Float32": "data:f4",
}
_VECTORS = {"xyz": 3, "xyzw": 4}
_STRUCT = {"f8": "d", "f4": "f", "i4": "i", "u4": "I", "u2": "H", "i1": "b", "u1": "B"}
_ENCAPSULATION = 4  # bytes of the encapsulation header
_LITTLE, _BIG = b"\x00\x01", b"\x00\x00"
_ORDERS = {_LITTLE: "<", _BIG: ">"}


class CdrError(UserError):
    """The bytes are not a message of the stated type."""


class Serialized(Protocol):
    """N messages in one buffer: message i is ``data[offsets[i] : offsets[i] + lengths[i]]``."""

    @property
    def data(self) -> bytes: ...
    @property
    def offsets(self) -> np.ndarray: ...
    @property
    def lengths(self) -> np.ndarray: ...


@dataclass(frozen=True, slots=True)
class _Field:
    path: tuple[str, ...]
    code: str  # numpy code, "str", "xyz" or "xyzw"
    kind: str  # struct code
    size: int  # bytes of one number
    numbers: int  # how many of them
    is_array: bool
    is_optional: bool

    @property
    def name(self) -> str:
        return ".".join(self.path)


def _parse(line: str) -> list[_Field]:
    fields = []
    for item in line.split():
        path, code = item.rstrip("?").split(":")
        code, _, count = code.partition("*")
        base = "f8" if code in _VECTORS else "u4" if code == "str" else code
        numbers = _VECTORS.get(code, int(count or 1))
        fields.append(
            _Field(
                path=tuple(path.split(".")),
                code=code,
                kind=_STRUCT[base],
                size=int(base[1:]),
                numbers=numbers,
                is_array=bool(count),
                is_optional=item.endswith("?"),
            )
        )
    return fields


_FIELDS = {name: _parse(line) for name, line in LAYOUTS.items()}


# --- one message, whole ----------------------------------------------------------------------------------------------


@cache
def _segment(kind: str, first: int, phase: int, order: str) -> tuple[struct.Struct, list[tuple[_Field, int]], int]:
    """Fields from number ``first`` up to the next string, represented by its length, or up to an optional field.

    ``phase`` is the position after the encapsulation header, modulo 8, because CDR aligns every number to its own size.
    Returns the layout to unpack, the fields with their byte offsets, and the number of the field after them.
    """
    form, places, position = order, [], phase
    index = first
    for field in _FIELDS[kind][first:]:
        if field.is_optional and index > first:
            break
        gap = -position % field.size
        form += f"{gap}x" * (gap > 0) + f"{field.numbers}{field.kind}"
        places.append((field, position + gap - phase))
        position += gap + field.numbers * field.size
        index += 1
        if field.code == "str":
            break
    return struct.Struct(form), places, index


def _walk(kind: str, payload: bytes, order: str) -> Iterator[tuple[_Field, int, tuple]]:
    """Yield (field, offset in the payload, values); for a string the offset and the number of its characters.

    Raises ``struct.error`` where the bytes end too early.
    """
    position, index = _ENCAPSULATION, 0
    while index < len(_FIELDS[kind]):
        layout, places, index = _segment(kind, index, (position - _ENCAPSULATION) % 8, order)
        if places[0][0].is_optional and position + layout.size > len(payload):
            return
        values = layout.unpack_from(payload, position)
        used = 0
        for field, offset in places:
            is_text = field.code == "str"
            yield field, position + offset + 4 * is_text, values[used : used + field.numbers]
            used += field.numbers
        position += layout.size + (values[-1] if is_text else 0)


def decode(kind: str, payload: bytes) -> Any:
    """Decode one message to nested attributes like those of rclpy and rosbags; ``CdrError`` if it is damaged."""
    order = _byte_order(kind, payload)
    message = SimpleNamespace()
    try:
        for field, position, values in _walk(kind, payload, order):
            _assign(message, field.path, _value(field, payload, position, values))
    except struct.error:
        raise _too_short(kind, payload) from None
    return message


def _byte_order(kind: str, payload: bytes) -> str:
    order = _ORDERS.get(bytes(payload[:2]))
    if order is None or len(payload) < _ENCAPSULATION:
        raise CdrError(f"a {kind} message is not in plain CDR")
    return order


def _too_short(kind: str, payload: bytes) -> CdrError:
    return CdrError(f"a {kind} message of {len(payload)} bytes is too short")


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


# --- one message, some of its fields ---------------------------------------------------------------------------------

_STAMP = {order: struct.Struct(order + "iII") for order in "<>"}  # sec, nanosec, length of frame_id with its zero
_AFTER_STAMP = _ENCAPSULATION + 12
_HEADER_FIELDS = 3  # number of fields of a std_msgs/Header in a layout


def picker(kind: str, names: tuple[str, ...]) -> Callable[[bytes], tuple[int, tuple]]:
    """Create a function that reads the stamp [ns] and the numbers of the fields ``names`` of a message with a header.

    It does not build the message, which takes 1 instead of 68 microseconds for a sensor_msgs/Imu. It raises
    ``CdrError``.
    """
    # the alignment of all fields after the frame_id depends on its end, modulo 8
    bodies = {order: [_body(kind, names, phase, order) for phase in range(8)] for order in _STAMP}
    little, of_little = _STAMP["<"], bodies["<"]

    def pick(data: bytes) -> tuple[int, tuple]:
        try:
            if data[:2] == _LITTLE:
                sec, nanosec, length = little.unpack_from(data, _ENCAPSULATION)
                return sec * NS_PER_S + nanosec, of_little[length + 12 & 7].unpack_from(data, _AFTER_STAMP + length)
            order = _byte_order(kind, data)
            sec, nanosec, length = _STAMP[order].unpack_from(data, _ENCAPSULATION)
            return sec * NS_PER_S + nanosec, bodies[order][length + 12 & 7].unpack_from(data, _AFTER_STAMP + length)
        except struct.error:
            raise _too_short(kind, data) from None

    return pick


def _body(kind: str, names: tuple[str, ...], phase: int, order: str) -> struct.Struct:
    """Layout to unpack ``names`` after the header; it skips all other fields, up to the end of the message.

    ``name[0]`` stands for the first number of a field.
    """
    form, position = order, phase
    for field in _FIELDS[kind][_HEADER_FIELDS:]:
        gap = -position % field.size
        wanted = field.numbers if field.name in names else 1 if f"{field.name}[0]" in names else 0
        numbers = f"{wanted}{field.kind}" if wanted else ""
        form += f"{gap}x{numbers}{(field.numbers - wanted) * field.size}x"
        position += gap + field.numbers * field.size
    return struct.Struct(form)


def peek_stamp_ns(data: bytes) -> int:
    """Header stamp [ns] of any serialized message that begins with a header; 0 for an unexpected layout."""
    order = _ORDERS.get(bytes(data[:2]))
    if order is None or len(data) < _AFTER_STAMP:
        return 0
    sec, nanosec, _ = _STAMP[order].unpack_from(data, _ENCAPSULATION)
    return int(sec * NS_PER_S + nanosec)


# --- many messages ---------------------------------------------------------------------------------------------------


def columns(kind: str, batch: Serialized, names: tuple[str, ...]) -> dict[str, np.ndarray] | None:
    """Fields ``names`` of N messages: ``stamp_ns`` (N,) int64, and dotted paths to (N,) or (N, k).

    None unless all messages have the same length and string lengths, and little-endian byte order.
    """
    if not len(batch.lengths) or not _is_uniform(batch):
        return None
    length, start = int(batch.lengths[0]), int(batch.offsets[0])
    first = batch.data[start : start + length]
    if first[:2] != _LITTLE:
        return None
    try:
        places = list(_walk(kind, first, "<"))
    except struct.error:
        return None
    buffer = np.frombuffer(batch.data, np.uint8)
    if not (_gather(buffer, batch.offsets, 2) == np.frombuffer(_LITTLE, np.uint8)).all():
        return None
    found: dict[str, np.ndarray] = {}
    for field, position, value in places:
        if field.code == "str":
            lengths = _gather(buffer, batch.offsets + position - 4, 4).view("<u4")
            if not (lengths == value[0]).all():
                return None
        elif field.name in names or field.name.startswith("header.stamp"):
            values = _gather(buffer, batch.offsets + position, field.numbers * field.size).view(_numpy_code(field))
            found[field.name] = values if values.shape[1] > 1 else values[:, 0]
    if "header.stamp.sec" in found:
        # The array must be int64: NumPy 1 chooses by the value of a scalar, and would compute in int32.
        found["stamp_ns"] = found.pop("header.stamp.sec").astype(np.int64) * 10**9 + found.pop("header.stamp.nanosec")
    return found


def _is_uniform(batch: Serialized) -> bool:
    """Whether all messages are equally long and lie within the buffer."""
    length = batch.lengths[0]
    is_within = batch.offsets.min() >= 0 and batch.offsets.max() + length <= len(batch.data)
    return bool(is_within and (batch.lengths == length).all())


def _numpy_code(field: _Field) -> str:
    return "<f8" if field.code in _VECTORS else "<" + field.code


def _gather(buffer: np.ndarray, starts: np.ndarray, size: int) -> np.ndarray:
    """Bytes (N, size) from the offsets ``starts`` (N,)."""
    # one opaque item per window: numpy copies it whole, three times as fast as its bytes
    windows = np.ndarray((len(buffer) - size + 1,), np.dtype((np.void, size)), buffer, strides=(1,))
    return windows[starts].view(np.uint8).reshape(len(starts), size)
