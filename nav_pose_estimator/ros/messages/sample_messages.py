"""Conversion of samples to messages of drivers: the inverse of :mod:`convert`, for simulated sensors."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from geometry_msgs.msg import TwistStamped, TwistWithCovarianceStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import FluidPressure, Imu, MagneticField, NavSatFix, PointCloud2, PointField, Range
from std_msgs.msg import UInt32

from nav_pose_estimator.core.numerics.rotation import quat_to_matrix
from nav_pose_estimator.engine.samples import (
    Airspeed,
    BeamVelocitySample,
    BodyVelocity,
    GnssFix,
    GnssVelocity,
    ImuSample,
    MagSample,
    PressureSample,
    RangeToGround,
    Sample,
    SatelliteCount,
    stamp_of,
)
from nav_pose_estimator.ros.messages.message_table import INPUTS
from nav_pose_estimator.ros.messages.outgoing import fill_stamp
from nav_pose_estimator.ros.messages.satellites import MAVLINK_UNKNOWN

_COVARIANCE_UNKNOWN, _COVARIANCE_KNOWN = 0, 3  # sensor_msgs/NavSatFix


def to_message(sample: Sample) -> Any:
    """Create the message of ``sample``, with its stamp."""
    kind, fill = _MESSAGES[type(sample)]
    message = kind()
    fill(message, sample)
    stamp = stamp_of(sample)
    if stamp is not None:
        fill_stamp(message.header.stamp, stamp)
        message.header.frame_id = "imu_link" if isinstance(sample, (ImuSample, MagSample)) else "gps"
    return message


def truth_message(stamp_ns: int, position: np.ndarray, vel_n: np.ndarray, q_nb: np.ndarray) -> Odometry:
    """Create the message of the true pose in map and the true velocity in base_link."""
    message = Odometry(child_frame_id="base_link")
    message.header.frame_id = "map"
    fill_stamp(message.header.stamp, stamp_ns)
    _vector(message.pose.pose.position, position)
    q = message.pose.pose.orientation
    q.w, q.x, q.y, q.z = map(float, q_nb)
    _vector(message.twist.twist.linear, quat_to_matrix(q_nb).T @ vel_n)
    return message


def _imu(message: Imu, sample: ImuSample) -> None:
    message.orientation_covariance[0] = -1.0  # no orientation
    _vector(message.angular_velocity, sample.gyro)
    _vector(message.linear_acceleration, sample.accel)


def _mag(message: MagneticField, sample: MagSample) -> None:
    _vector(message.magnetic_field, sample.field)


def _fix(message: NavSatFix, sample: GnssFix) -> None:
    message.status.status, message.status.service = sample.status, 1
    message.latitude, message.longitude = math.degrees(sample.lat), math.degrees(sample.lon)
    message.altitude = float(sample.alt)
    message.position_covariance_type = _COVARIANCE_UNKNOWN if sample.cov_enu is None else _COVARIANCE_KNOWN
    if sample.cov_enu is not None:
        message.position_covariance[:] = sample.cov_enu.ravel()


def _twist(message: TwistWithCovarianceStamped, velocity: Any, cov: np.ndarray | None) -> None:
    _vector(message.twist.twist.linear, velocity)
    if cov is not None:
        whole = np.zeros((6, 6))
        whole[:3, :3] = cov
        message.twist.covariance[:] = whole.ravel()


def _velocity(message: TwistWithCovarianceStamped, sample: GnssVelocity) -> None:
    _twist(message, sample.vel_enu, sample.cov_enu)


def _body_velocity(message: TwistWithCovarianceStamped, sample: BodyVelocity) -> None:
    _twist(message, sample.velocity, sample.cov)


def _beams(message: PointCloud2, sample: BeamVelocitySample) -> None:
    points = np.column_stack([sample.directions, sample.velocities]).astype(np.float32)
    message.height, message.width, message.point_step, message.row_step = 1, len(points), 16, 16 * len(points)
    message.fields = [
        PointField(name=name, offset=4 * i, datatype=PointField.FLOAT32, count=1)
        for i, name in enumerate(("x", "y", "z", "velocity"))
    ]
    message.data = points.astype("<f4").tobytes()


def _count(message: UInt32, sample: SatelliteCount) -> None:
    message.data = MAVLINK_UNKNOWN if sample.count is None else int(sample.count)


def _pressure(message: FluidPressure, sample: PressureSample) -> None:
    message.fluid_pressure, message.variance = float(sample.pressure), float(sample.variance or 0.0)


def _airspeed(message: TwistStamped, sample: Airspeed) -> None:
    message.twist.linear.x = float(sample.speed)


def _range(message: Range, sample: RangeToGround) -> None:
    message.range, message.field_of_view = float(sample.distance), float(sample.field_of_view)
    message.variance = sample.sd**2 if sample.sd > 0.0 else 0.0


def _vector(target: Any, values: Any) -> None:
    target.x, target.y, target.z = map(float, values)


_MESSAGES: dict[type, tuple[Any, Callable[[Any, Any], None]]] = {
    ImuSample: (Imu, _imu),
    MagSample: (MagneticField, _mag),
    GnssFix: (NavSatFix, _fix),
    GnssVelocity: (TwistWithCovarianceStamped, _velocity),
    SatelliteCount: (UInt32, _count),
    PressureSample: (FluidPressure, _pressure),
    Airspeed: (TwistStamped, _airspeed),
    RangeToGround: (Range, _range),
    BodyVelocity: (TwistWithCovarianceStamped, _body_velocity),
    BeamVelocitySample: (PointCloud2, _beams),
}
TOPICS: dict[type, tuple[str, Any]] = {
    entry.sample: (entry.topic, _MESSAGES[entry.sample][0]) for entry in INPUTS if entry.sample in _MESSAGES
}
"""Topic and message class by type of sample."""
