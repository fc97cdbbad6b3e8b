"""Where the number of satellites comes from. sensor_msgs/NavSatFix has no field for it, and it is never invented.

Each adapter gives one :class:`SatelliteCount`: a number, or None where the receiver says that it does not know.
"""

from typing import Any

from nav_pose_estimator.engine.samples import SatelliteCount
from nav_pose_estimator.ros.messages.convert import Converted, stamp_ns

MAVLINK_UNKNOWN = 255


def from_uint32(message: Any) -> Converted:
    """std_msgs/UInt32 as MAVROS publishes it: no header, after its fix, 255 for unknown."""
    return (SatelliteCount(None, _mavlink(message.data)),)


def from_gpsraw(message: Any) -> Converted:
    """mavros_msgs/GPSRAW ``satellites_visible``: 255 for unknown (PX4 puts the used ones there)."""
    return (SatelliteCount(stamp_ns(message), _mavlink(message.satellites_visible)),)


def from_gpsfix(message: Any) -> Converted:
    """gps_msgs/GPSFix ``status.satellites_used``: 0 together with a fix means that the driver did not fill it."""
    count = int(message.status.satellites_used)
    has_fix = message.status.status >= 0
    return (SatelliteCount(stamp_ns(message), None if count == 0 and has_fix else count),)


def from_navpvt(message: Any) -> Converted:
    """ublox_msgs/NavPVT ``num_sv``: no header, the count belongs to the fix of the same epoch."""
    return (SatelliteCount(None, int(message.num_sv)),)


def _mavlink(count: int) -> int | None:
    return None if count == MAVLINK_UNKNOWN else int(count)
