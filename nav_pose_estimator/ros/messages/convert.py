"""Conversion of messages to samples, with all knowledge of the conventions of ROS messages and drivers.

The functions only read attributes, so that they accept messages of rclpy and of rosbags. Each returns, in order, the
samples to feed and events about data that are not used. Vectors remain in the axes of the sensor; the engine applies
mounting and FRD. NaN passes through where the engine rejects it with an event of its own.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from nav_pose_estimator.core.numerics.rotation import quat_to_matrix
from nav_pose_estimator.engine.samples import (
    Airspeed,
    AttitudeSample,
    BodyVelocity,
    DifferentialPressure,
    GnssFix,
    GnssVelocity,
    ImuSample,
    MagSample,
    NavigatorVelocity,
    PressureSample,
    RangeToGround,
    Sample,
    SetOrigin,
    SetPose,
    Vector3,
    VelocityError,
)
from nav_pose_estimator.engine.solutions import Event, Level
from nav_pose_estimator.ros.messages import covariance
from nav_pose_estimator.ros.messages.cdr import NS_PER_S
from nav_pose_estimator.ros.messages.covariance import Knowledge

Converted = tuple[Sample | Event, ...]
Adapter = Callable[[Any], Converted]

_COVARIANCE_TYPE_UNKNOWN = 0  # sensor_msgs/NavSatFix


def stamp_ns(message: Any) -> int:
    """Header stamp in integer nanoseconds; 0 if the driver did not stamp the message."""
    stamp = message.header.stamp
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)


def imu(message: Any) -> Converted:
    """sensor_msgs/Imu to :class:`ImuSample`. Its covariances are not noise densities and are not used."""
    absent = message.angular_velocity_covariance[0] == -1.0, message.linear_acceleration_covariance[0] == -1.0
    sample = ImuSample(stamp_ns(message), vector(message.angular_velocity), vector(message.linear_acceleration))
    return imu_sample(sample, *absent)


def imu_sample(sample: ImuSample, gyro_absent: bool, accel_absent: bool) -> Converted:
    """``sample``, or an event if its gyroscope or accelerometer part is marked as not measured (covariance[0] == -1).

    A specific force of exactly zero counts as not measured: no accelerometer reads zero, but drivers that publish
    gyroscope and accelerometer on separate topics leave the other part at it.
    """
    force_is_zero = sample.accel == (0.0, 0.0, 0.0)
    if not (gyro_absent or accel_absent or force_is_zero):
        return (sample,)
    which = "angular velocity" if gyro_absent else "linear acceleration"
    how = "covariance[0] is -1" if gyro_absent or accel_absent else "it is exactly zero"
    text = f"the IMU message has no {which} ({how}), but gyroscope and accelerometer are both needed; not used"
    return (Event(sample.stamp_ns, "imu.rejected.absent", Level.WARN, text),)


def imu_attitude(message: Any) -> Converted:
    """Orientation of a sensor_msgs/Imu to :class:`AttitudeSample`; an event if it has none."""
    stamp = stamp_ns(message)
    cov = covariance.read(message.orientation_covariance, 3)
    q_nb = quaternion(message.orientation)
    if cov.knowledge is Knowledge.ABSENT or q_nb is None:
        text = "imu/data has no orientation; not used"
        return (Event(stamp, "attitude.rejected.absent", Level.WARN, text),)
    return (AttitudeSample(stamp, q_nb, cov.matrix), *_flaw(stamp, "attitude", cov.flaw))


def magnetic_field(message: Any) -> Converted:
    """sensor_msgs/MagneticField [T] to :class:`MagSample`."""
    return (MagSample(stamp_ns(message), vector(message.magnetic_field)),)


def nav_sat_fix(message: Any) -> Converted:
    """sensor_msgs/NavSatFix to :class:`GnssFix`. STATUS_UNKNOWN (-2, the default of Jazzy) stays negative: no fix."""
    place = message.latitude, message.longitude, float(message.altitude)
    error = message.position_covariance_type, message.position_covariance
    return fix(stamp_ns(message), *place, int(message.status.status), *error)


def fix(
    stamp: int, lat: float, lon: float, alt: float, status: int, cov_type: int, cov: Sequence[float] | np.ndarray
) -> Converted:
    """Values of a sensor_msgs/NavSatFix to :class:`GnssFix`: ``lat``, ``lon`` [deg], ellipsoid height ``alt`` [m]."""
    read = covariance.Reading(Knowledge.UNKNOWN)
    if cov_type != _COVARIANCE_TYPE_UNKNOWN:
        read = covariance.read(cov, 3)
    sample = GnssFix(stamp, math.radians(lat), math.radians(lon), alt, status, read.matrix)
    return (sample, *_flaw(stamp, "gnss.position", read.flaw))


def twist_with_covariance(message: Any) -> Converted:
    """geometry_msgs/TwistWithCovarianceStamped, ENU, to :class:`GnssVelocity`; the angular part is ignored."""
    return gnss_velocity(stamp_ns(message), vector(message.twist.twist.linear), message.twist.covariance)


def gnss_velocity(stamp: int, velocity: Vector3, cov: Sequence[float] | np.ndarray) -> Converted:
    """Values of a geometry_msgs/TwistWithCovarianceStamped, ENU, to :class:`GnssVelocity`; ``cov`` (36,)."""
    read = covariance.read(cov, 6, block=3)
    return (GnssVelocity(stamp, velocity, read.matrix), *_flaw(stamp, "gnss.velocity", read.flaw))


def twist(message: Any) -> Converted:
    """geometry_msgs/TwistStamped, ENU, to :class:`GnssVelocity` with unknown covariance."""
    return (GnssVelocity(stamp_ns(message), vector(message.twist.linear)),)


def body_velocity(message: Any) -> Converted:
    """geometry_msgs/TwistWithCovarianceStamped in the velocity sensor's axes to :class:`BodyVelocity`."""
    stamp = stamp_ns(message)
    cov = covariance.read(message.twist.covariance, 6, block=3)
    velocity = BodyVelocity(stamp, vector(message.twist.twist.linear), cov.matrix)
    return (velocity, *_flaw(stamp, "body_velocity", cov.flaw))


def velocity_error(message: Any) -> Converted:
    """geometry_msgs/TwistWithCovarianceStamped, ENU, to :class:`VelocityError`: estimate minus truth.

    A prediction without a covariance is not used.
    """
    stamp, dv_n = stamp_ns(message), vector(message.twist.twist.linear)
    cov = covariance.read(message.twist.covariance, 6, block=3)
    if cov.matrix is None or not all(map(math.isfinite, dv_n)):
        text = "a predicted velocity error has no covariance, or is not finite; not used"
        return (Event(stamp, "outage.rejected.covariance", Level.WARN, text),)
    return (VelocityError(stamp, dv_n, cov.matrix),)


def fluid_pressure(message: Any) -> Converted:
    """sensor_msgs/FluidPressure [Pa] to :class:`PressureSample`."""
    stamp = stamp_ns(message)
    variance, flaw = covariance.read_variance(message.variance)
    return (PressureSample(stamp, float(message.fluid_pressure), variance), *_flaw(stamp, "baro", flaw))


def airspeed(message: Any) -> Converted:
    """geometry_msgs/TwistStamped: the true airspeed along x [m/s] to :class:`Airspeed`."""
    return (Airspeed(stamp_ns(message), float(message.twist.linear.x)),)


def airspeed_number(message: Any) -> Converted:
    """std_msgs/Float32, the true airspeed [m/s] without a header, to :class:`Airspeed`."""
    return (Airspeed(None, float(message.data)),)


def differential_pressure(message: Any) -> Converted:
    """sensor_msgs/FluidPressure with the pressure difference of a pitot tube [Pa] to :class:`DifferentialPressure`."""
    return (DifferentialPressure(stamp_ns(message), float(message.fluid_pressure)),)


def range_to_ground(message: Any) -> Converted:
    """sensor_msgs/Range to :class:`RangeToGround`; an event for a distance outside the limits in the message.

    REP-117: -Inf means too close, +Inf out of range, NaN an error. Limits of zero were not filled and do not apply.
    """
    stamp, distance, farthest = stamp_ns(message), float(message.range), float(message.max_range) or math.inf
    if not (max(float(message.min_range), 0.0) <= distance <= farthest and math.isfinite(distance)):
        return (Event(stamp, "range.rejected.outside"),)
    variance, flaw = covariance.read_variance(getattr(message, "variance", 0.0))  # new in 2023
    sd = math.nan if variance is None else math.sqrt(variance)
    return (RangeToGround(stamp, distance, float(message.field_of_view), sd), *_flaw(stamp, "range", flaw))


def set_pose(message: Any, frame: str = "map") -> Converted:
    """geometry_msgs/PoseWithCovarianceStamped in ``frame`` (or without frame_id) to :class:`SetPose`."""
    stamp = stamp_ns(message)
    pose, cov = message.pose.pose, covariance.read(message.pose.covariance, 6)
    position, q_nb = vector(pose.position), quaternion(pose.orientation)
    if message.header.frame_id.lstrip("/") not in ("", frame):
        text = f"set_pose is in the frame {message.header.frame_id!r}, but must be in {frame!r}; not used"
        return (Event(stamp, "set_pose.rejected.frame", Level.WARN, text),)
    if q_nb is None or not all(map(math.isfinite, position)):
        text = "set_pose holds a position that is not finite or an invalid orientation; not used"
        return (Event(stamp, "set_pose.rejected.nan", Level.WARN, text),)
    return (SetPose(stamp, position, q_nb, cov.matrix), *_flaw(stamp, "set_pose", cov.flaw))


def origin_fix(message: Any) -> Converted:
    """sensor_msgs/NavSatFix to :class:`SetOrigin`; only its position is used."""
    return (_origin(stamp_ns(message), message),)


def origin_point(message: Any) -> Converted:
    """geographic_msgs/GeoPointStamped to :class:`SetOrigin`."""
    return (_origin(stamp_ns(message), message.position),)


def _origin(stamp: int, place: Any) -> SetOrigin:
    return SetOrigin(stamp, math.radians(place.latitude), math.radians(place.longitude), float(place.altitude))


def odometry_velocity(message: Any) -> Converted:
    """Velocity of a nav_msgs/Odometry (twist in the body, REP-105), rotated by its pose, to :class:`NavigatorVelocity`.

    With an unknown covariance the velocity is marked as not valid.
    """
    stamp = stamp_ns(message)
    q_nb = quaternion(message.pose.pose.orientation)
    if q_nb is None:
        text = "an odometry message has no valid orientation; not used"
        return (Event(stamp, "navigator_velocity.rejected.orientation", Level.WARN, text),)
    velocity = quat_to_matrix(np.array(q_nb)) @ np.array(vector(message.twist.twist.linear))
    cov = covariance.read(message.twist.covariance, 6, block=3)
    known = cov.knowledge is Knowledge.KNOWN
    pose = covariance.read(message.pose.covariance, 6).matrix
    roll, pitch, yaw = (math.nan,) * 3 if pose is None else np.sqrt(np.diag(pose)[3:]).tolist()
    return (
        NavigatorVelocity(stamp, tuple(velocity.tolist()), known, q_nb, heading_sd=yaw, tilt_sd=max(roll, pitch)),
        *_flaw(stamp, "navigator_velocity", cov.flaw),
    )


def without_vertical(adapter: Adapter) -> Adapter:
    """``adapter`` for a driver that does not fill the vertical velocity (MAVROS ``raw/gps_vel``): Up becomes NaN."""

    def adapt(message: Any) -> Converted:
        return tuple(_drop_up(item) if isinstance(item, GnssVelocity) else item for item in adapter(message))

    return adapt


def from_ned(adapter: Adapter) -> Adapter:
    """``adapter`` for a driver that publishes velocities in North-East-Down."""

    def adapt(message: Any) -> Converted:
        return tuple(_ned_to_enu(item) if isinstance(item, GnssVelocity) else item for item in adapter(message))

    return adapt


def vector(value: Any) -> Vector3:
    """The components of a geometry_msgs/Vector3 or Point as floats."""
    return float(value.x), float(value.y), float(value.z)


def quaternion(value: Any) -> tuple[float, float, float, float] | None:
    """A Quaternion message as unit (w, x, y, z); None where it is not a rotation (all zero, NaN, far from unit)."""
    q = float(value.w), float(value.x), float(value.y), float(value.z)
    norm = math.sqrt(sum(c * c for c in q))
    if not 0.9 < norm < 1.1:  # false for NaN as well
        return None
    w, x, y, z = (c / norm for c in q)
    return w, x, y, z


def _ned_to_enu(velocity: GnssVelocity) -> GnssVelocity:
    north, east, down = velocity.vel_enu
    cov = velocity.cov_enu
    turned = None if cov is None else cov[np.ix_((1, 0, 2), (1, 0, 2))] * np.outer((1, 1, -1), (1, 1, -1))
    return GnssVelocity(velocity.stamp_ns, (east, north, -down), turned)


def _drop_up(velocity: GnssVelocity) -> GnssVelocity:
    east, north, _ = velocity.vel_enu
    return GnssVelocity(velocity.stamp_ns, (east, north, math.nan), velocity.cov_enu)


def _flaw(stamp: int, source: str, flaw: str) -> tuple[Event, ...]:
    if not flaw:
        return ()
    text = f"a {source} covariance is {flaw.replace('_', ' ')}; taken as unknown"
    return (Event(stamp, f"{source}.covariance.{flaw}", Level.WARN, text),)
