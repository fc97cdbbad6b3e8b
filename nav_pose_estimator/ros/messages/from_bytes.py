"""Direct conversion of the most frequent messages from bytes to samples, with the same results as :mod:`convert`.

Functions of columns (:func:`cdr.columns`) return None where the messages must be converted one by one.
"""

import numpy as np

from nav_pose_estimator.engine.samples import ImuBlock, ImuSample, MagSample, PressureSample
from nav_pose_estimator.ros.messages import covariance
from nav_pose_estimator.ros.messages.cdr import picker
from nav_pose_estimator.ros.messages.convert import Converted, fix, gnss_velocity, imu_sample

FIX_FIELDS = "latitude", "longitude", "altitude", "status.status", "position_covariance_type", "position_covariance"
VELOCITY_FIELDS = "twist.twist.linear", "twist.covariance"
IMU_FIELDS = (
    "angular_velocity",
    "angular_velocity_covariance[0]",
    "linear_acceleration",
    "linear_acceleration_covariance[0]",
)
_pick_imu = picker("sensor_msgs/msg/Imu", IMU_FIELDS)


def imu(data: bytes) -> Converted:
    """Convert a serialized sensor_msgs/Imu; ``CdrError`` if it is damaged."""
    stamp, (wx, wy, wz, gyro_cov, fx, fy, fz, accel_cov) = _pick_imu(data)
    sample = ImuSample(stamp, (wx, wy, wz), (fx, fy, fz))
    if gyro_cov == -1.0 or accel_cov == -1.0 or fx == fy == fz == 0.0:
        return imu_sample(sample, gyro_cov == -1.0, accel_cov == -1.0)
    return (sample,)


def imu_block(found: dict[str, np.ndarray]) -> ImuBlock | None:
    """Convert columns of sensor_msgs/Imu; None if a message lacks its gyroscope or accelerometer part."""
    halves = found["angular_velocity_covariance"], found["linear_acceleration_covariance"]
    force = found["linear_acceleration"]
    if (halves[0][:, 0] == -1.0).any() or (halves[1][:, 0] == -1.0).any() or not force.any(axis=1).all():
        return None
    return ImuBlock(found["stamp_ns"], found["angular_velocity"], force)


def fixes(found: dict[str, np.ndarray]) -> list[Converted]:
    """Convert columns of sensor_msgs/NavSatFix."""
    return [fix(*row) for row in zip(*(found[name].tolist() for name in ("stamp_ns", *FIX_FIELDS)), strict=True)]


def gnss_velocities(found: dict[str, np.ndarray]) -> list[Converted]:
    """Convert columns of geometry_msgs/TwistWithCovarianceStamped."""
    numbers = zip(*(found[name].tolist() for name in ("stamp_ns", *VELOCITY_FIELDS)), strict=True)
    return [gnss_velocity(stamp, tuple(velocity), cov) for stamp, velocity, cov in numbers]


def magnetic_fields(found: dict[str, np.ndarray]) -> list[Converted]:
    """Convert columns of sensor_msgs/MagneticField."""
    stamps, fields = found["stamp_ns"].tolist(), found["magnetic_field"].tolist()
    return [(MagSample(stamp, tuple(field)),) for stamp, field in zip(stamps, fields, strict=True)]


def pressures(found: dict[str, np.ndarray]) -> list[Converted] | None:
    """Convert columns of sensor_msgs/FluidPressure; None if their variances differ or are unusable."""
    variances = found["variance"]
    if (variances != variances[0]).any():
        return None
    variance, flaw = covariance.read_variance(variances[0])
    if flaw:
        return None
    stamps, values = found["stamp_ns"].tolist(), found["fluid_pressure"].tolist()
    return [(PressureSample(stamp, value, variance),) for stamp, value in zip(stamps, values, strict=True)]
