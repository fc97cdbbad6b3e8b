"""Conversion of satellite counts, for which sensor_msgs/NavSatFix has no field.

Each adapter returns one :class:`SatelliteCount`: a number, or None where the receiver marks it as unknown.
"""

from typing import Any

from nav_pose_estimator.engine.samples import SatelliteCount
from nav_pose_estimator.ros.messages.convert import Converted, stamp_ns

MAVLINK_UNKNOWN = 255  # value of MAVLink for an unknown count


def from_uint32(message: Any) -> Converted:
    """std_msgs/UInt32 of MAVROS: without a header, published after its fix; 255 means unknown."""
    return (SatelliteCount(None, _mavlink(message.data)),)


def from_gpsraw(message: Any) -> Converted:
    """mavros_msgs/GPSRAW ``satellites_visible`` (with PX4 those used); 255 means unknown."""
    return (SatelliteCount(stamp_ns(message), _mavlink(message.satellites_visible)),)


def from_gpsfix(message: Any) -> Converted:
    """gps_msgs/GPSFix ``status.satellites_used``; 0 together with a fix means that the driver did not fill it."""
    count = int(message.status.satellites_used)
    has_fix = message.status.status >= 0
    return (SatelliteCount(stamp_ns(message), None if count == 0 and has_fix else count),)


def from_navpvt(message: Any) -> Converted:
    """ublox_msgs/NavPVT ``num_sv``: without a header; the count belongs to the fix of the same epoch."""
    return (SatelliteCount(None, int(message.num_sv)),)


def _mavlink(count: int) -> int | None:
    return None if count == MAVLINK_UNKNOWN else int(count)
