"""Conversion of gps_msgs/GPSFix (gpsd_client, novatel and others), which has position and velocity in one message."""

import math
from typing import Any

import numpy as np

from nav_pose_estimator.engine.samples import GnssVelocity
from nav_pose_estimator.ros.messages.convert import Converted, nav_sat_fix, stamp_ns

_SIGMAS_OF_95_PERCENT = 1.96  # GPSFix gives errors at 95 % confidence


def fix(message: Any) -> Converted:
    """Position to :class:`GnssFix`; the fields have the same names as those of NavSatFix."""
    return nav_sat_fix(message)


def velocity(message: Any) -> Converted:
    """Track, speed and climb to :class:`GnssVelocity`; its covariance is known if both speed errors are given."""
    track, speed = math.radians(message.track), float(message.speed)
    vel_enu = speed * math.sin(track), speed * math.cos(track), float(message.climb)
    return (GnssVelocity(stamp_ns(message), vel_enu, _covariance(message)),)


def _covariance(message: Any) -> np.ndarray | None:
    horizontal, vertical = (float(e) / _SIGMAS_OF_95_PERCENT for e in (message.err_speed, message.err_climb))
    if not (0.0 < horizontal < math.inf and 0.0 < vertical < math.inf):
        return None
    return np.diag([horizontal**2, horizontal**2, vertical**2])
