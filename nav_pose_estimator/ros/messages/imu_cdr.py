"""Read a serialized sensor_msgs/Imu without building the message: the difference between 68 and 1 microsecond.

Plain little-endian CDR (OMG DDS-XTypes 1.3, section 7.4.3): a four-byte encapsulation header, then fields aligned to
their size counted from the end of that header. Everything after the frame_id has a fixed layout.
"""

import struct

from nav_pose_estimator.engine.samples import ImuSample
from nav_pose_estimator.ros.messages.convert import NS_PER_S, Converted, imu_sample

_ENCAPSULATION = b"\x00\x01"  # plain CDR, little endian
_HEADER = struct.Struct("<iII")  # sec, nanosec, length of frame_id with its final zero
# orientation and its covariance (13 doubles) are skipped, then rate, its covariance[0], force, its covariance[0]
_BODY = struct.Struct("<104x 3d d 64x 3d d")
_BODY_SIZE = 37 * 8


def decode_imu(data: bytes) -> Converted | None:
    """What :func:`convert.imu` makes of the message in ``data``; None for a layout that is not the expected one."""
    if len(data) < 16 or data[:2] != _ENCAPSULATION:
        return None
    sec, nanosec, length = _HEADER.unpack_from(data, 4)
    body = 4 + (12 + length + 7 & ~7)
    if not body + _BODY_SIZE <= len(data) < body + _BODY_SIZE + 8:
        return None
    wx, wy, wz, gyro_cov, fx, fy, fz, accel_cov = _BODY.unpack_from(data, body)
    sample = ImuSample(sec * NS_PER_S + nanosec, (wx, wy, wz), (fx, fy, fz))
    if gyro_cov == -1.0 or accel_cov == -1.0:
        return imu_sample(sample, gyro_cov == -1.0, accel_cov == -1.0)
    return (sample,)


def peek_stamp_ns(data: bytes) -> int:
    """The header stamp of any serialized message that begins with a header; 0 for an unexpected layout."""
    if len(data) < 16 or data[:2] != _ENCAPSULATION:
        return 0
    sec, nanosec, _ = _HEADER.unpack_from(data, 4)
    return sec * NS_PER_S + nanosec
