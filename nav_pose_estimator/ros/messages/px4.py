"""Conversion of px4_msgs from uXRCE-DDS: microsecond stamps, NED world, FRD body (set ``imu.convention: frd``).

The uXRCE client converts ``timestamp`` to the clock of the companion computer; ``timestamp_sample`` is not always
converted and therefore not used. PX4 publishes neither magnetometer nor barometer by default.
"""

import math
from typing import Any

import numpy as np

from nav_pose_estimator.engine.samples import (
    Airspeed,
    DifferentialPressure,
    GnssFix,
    GnssVelocity,
    ImuSample,
    SatelliteCount,
)
from nav_pose_estimator.engine.solutions import Event, Level
from nav_pose_estimator.ros.messages.convert import Converted, imu_sample

_NS_PER_US = 1000
_RELATIVE_TIMESTAMP_INVALID = 0x7FFFFFFF  # px4_msgs/SensorCombined
_FIX_3D, _EXTRAPOLATED = 3, 8  # fix_type of px4_msgs/SensorGps
_NO_FIX, _FIX = -1, 0  # sensor_msgs/NavSatStatus


def imu(message: Any) -> Converted:
    """SensorCombined to :class:`ImuSample` in the FRD axes of the message."""
    stamp = _stamp_ns(message)
    if message.accelerometer_timestamp_relative == _RELATIVE_TIMESTAMP_INVALID:
        text = "sensor_combined reports its accelerometer as invalid; not used"
        return (Event(stamp, "imu.rejected.absent", Level.WARN, text),)
    return imu_sample(ImuSample(stamp, _triple(message.gyro_rad), _triple(message.accelerometer_m_s2)), False, False)


def fix(message: Any) -> Converted:
    """SensorGps to :class:`GnssFix` with ellipsoid height; an extrapolated position is not a fix."""
    has_fix = _FIX_3D <= message.fix_type < _EXTRAPOLATED
    lat, lon, height = _position(message)
    horizontal, vertical = float(message.eph), float(message.epv)
    known = 0.0 < horizontal < math.inf and 0.0 < vertical < math.inf
    cov = np.diag([horizontal**2, horizontal**2, vertical**2]) if known else None
    return (GnssFix(_stamp_ns(message), lat, lon, height, _FIX if has_fix else _NO_FIX, cov),)


def velocity(message: Any) -> Converted:
    """SensorGps to :class:`GnssVelocity`, from NED to ENU; an event if PX4 marks it as invalid.

    ``s_variance_m_s`` is, despite its name, the accuracy of the speed in m/s.
    """
    if not message.vel_ned_valid:
        return (Event(_stamp_ns(message), "gnss.velocity.rejected.invalid"),)
    accuracy = float(message.s_variance_m_s)
    cov = np.eye(3) * accuracy**2 if 0.0 < accuracy < math.inf else None
    vel_enu = float(message.vel_e_m_s), float(message.vel_n_m_s), -float(message.vel_d_m_s)
    return (GnssVelocity(_stamp_ns(message), vel_enu, cov),)


def satellites(message: Any) -> Converted:
    """SensorGps ``satellites_used`` to :class:`SatelliteCount`; 255 means unknown."""
    count = int(message.satellites_used)
    return (SatelliteCount(_stamp_ns(message), None if count == 255 else count),)


def airspeed(message: Any) -> Converted:
    """Airspeed ``true_airspeed_m_s`` to :class:`Airspeed`; an event if it is NaN or not positive, which means none."""
    speed = float(message.true_airspeed_m_s)
    if not speed > 0.0:  # true for NaN as well
        return (Event(_stamp_ns(message), "airspeed.rejected.absent"),)
    return (Airspeed(_stamp_ns(message), speed),)


def differential_pressure(message: Any) -> Converted:
    """DifferentialPressure ``differential_pressure_pa`` to :class:`DifferentialPressure`."""
    return (DifferentialPressure(_stamp_ns(message), float(message.differential_pressure_pa)),)


def _position(message: Any) -> tuple[float, float, float]:
    """Latitude, longitude [rad] and ellipsoid height [m]; in messages up to PX4 1.14 integers of 1e-7 deg and mm."""
    if hasattr(message, "latitude_deg"):
        degrees, height = (message.latitude_deg, message.longitude_deg), float(message.altitude_ellipsoid_m)
    else:
        degrees, height = (message.lat * 1e-7, message.lon * 1e-7), message.alt_ellipsoid * 1e-3
    return math.radians(degrees[0]), math.radians(degrees[1]), height


def _stamp_ns(message: Any) -> int:
    return int(message.timestamp) * _NS_PER_US


def _triple(values: Any) -> tuple[float, float, float]:
    x, y, z = values
    return float(x), float(y), float(z)
