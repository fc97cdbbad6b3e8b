"""What the nodes subscribe to: the sensors of the message table, and what one node receives from another."""

from typing import Any

from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.ros import navigator_watch
from nav_pose_estimator.ros.messages import convert, installed, message_table
from nav_pose_estimator.ros.messages.message_table import Source

ATTITUDE = Source("imu/data", "sensor_msgs/msg/Imu", convert.imu_attitude)
"""The attitude that another node estimates."""
NAVIGATOR = Source("odometry/filtered", "nav_msgs/msg/Odometry", navigator_watch.odometry)
"""All that another node estimates, for who learns from it."""
ODOMETRY = Source("odometry/filtered", "nav_msgs/msg/Odometry", convert.odometry_velocity)
"""The velocity that another node estimates."""
PREDICTION = Source("outage/velocity_error", "geometry_msgs/msg/TwistWithCovarianceStamped", convert.velocity_error)
"""The velocity error that another node predicts in an outage."""


def imu(parameters: Parameters) -> Source:
    """The IMU, which no estimator can do without."""
    (source,) = message_table.sources(parameters, (message_table.IMU,))
    return source


def of_navigator(parameters: Parameters) -> list[Source]:
    """All sensors of the navigator except the IMU."""
    return message_table.sources(parameters)[1:]


def magnetometer(parameters: Parameters) -> Source:
    """The magnetometer, for a node that wants no other sensor."""
    (source,) = message_table.sources(parameters, (message_table.MAGNETOMETER,))
    return source


def body_velocity(parameters: Parameters) -> Source:
    """A velocity measured in the vehicle, for the attitude filter."""
    (source,) = message_table.sources(parameters, (message_table.BODY_VELOCITY,))
    return source


def message_class(source: Source) -> Any:
    """The rclpy message class of ``source``; ``ParameterError`` where its package is not installed."""
    wanted = f"{source.topic} is set to {source.type.replace('/msg/', '/')}"
    other = f"choose another type in {source.parameter}" if source.parameter else ""
    return installed.message_class(source.type, wanted, other)
