"""Which message type a topic carries and who turns it into samples: one table, chosen by ``ros.input`` parameters."""

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.ros import InputParameters
from nav_pose_estimator.engine.parameters.schema import ParameterError
from nav_pose_estimator.ros import navigator_watch
from nav_pose_estimator.ros.messages import convert, gps_umd, px4, satellites
from nav_pose_estimator.ros.messages.convert import Adapter, Converted

_IMU = {
    "imu": ("sensor_msgs", "Imu", convert.imu),
    "px4": ("px4_msgs", "SensorCombined", px4.imu),
}
_FIX = {
    "navsatfix": ("sensor_msgs", "NavSatFix", convert.nav_sat_fix),
    "gpsfix": ("gps_msgs", "GPSFix", gps_umd.fix),
    "px4": ("px4_msgs", "SensorGps", px4.fix),
}
_VELOCITY: dict[str, tuple[str, str, Adapter]] = {
    "twist_with_covariance": ("geometry_msgs", "TwistWithCovarianceStamped", convert.twist_with_covariance),
    "twist": ("geometry_msgs", "TwistStamped", convert.twist),
    "gpsfix": ("gps_msgs", "GPSFix", gps_umd.velocity),
    "px4": ("px4_msgs", "SensorGps", px4.velocity),
}
_SATELLITES = {
    "uint32": ("std_msgs", "UInt32", satellites.from_uint32),
    "gpsfix": ("gps_msgs", "GPSFix", satellites.from_gpsfix),
    "gpsraw": ("mavros_msgs", "GPSRAW", satellites.from_gpsraw),
    "navpvt": ("ublox_msgs", "NavPVT", satellites.from_navpvt),
    "px4": ("px4_msgs", "SensorGps", px4.satellites),
}


@dataclass(frozen=True)
class Input:
    """One input topic: ``package``/msg/``name`` messages, turned into samples by ``adapter``."""

    topic: str
    package: str
    name: str
    adapter: Callable[[Any], tuple[Any, ...]]  # samples and events

    def message_class(self) -> Any:
        """The rclpy message class; ``ParameterError`` where its package is not installed."""
        try:
            return getattr(importlib.import_module(f"{self.package}.msg"), self.name)
        except (ImportError, AttributeError):
            raise ParameterError(
                f"{self.topic} is set to {self.package}/{self.name}, but {self.package} is not installed here; "
                f"install ros-jazzy-{self.package.replace('_', '-')} or choose another type in ros.input"
            ) from None


def imu_input(parameters: InputParameters) -> Input:
    """The input ``imu/data_raw``."""
    return Input("imu/data_raw", *_IMU[parameters.imu])


def gnss_inputs(parameters: InputParameters, satellite_source: str) -> list[Input]:
    """``gps/satellites``, ``gps/vel`` and ``gps/fix``, as far as they are there. The count first: it judges the fix."""
    inputs = []
    if satellite_source != "none":
        inputs.append(Input("gps/satellites", *_SATELLITES[satellite_source]))
    if parameters.velocity != "none":
        package, name, adapter = _VELOCITY[parameters.velocity]
        if parameters.velocity_frame == "ned":
            adapter = convert.from_ned(adapter)
        if not parameters.vertical_velocity:
            adapter = convert.without_vertical(adapter)
        inputs.append(Input("gps/vel", package, name, adapter))
    return [*inputs, Input("gps/fix", *_FIX[parameters.fix])]


def navigator_inputs(parameters: Parameters) -> list[Input]:
    """All inputs of the navigator except the IMU."""

    def set_pose(message: Any) -> Converted:
        return convert.set_pose(message, parameters.ros.frames.map)

    return [
        *gnss_inputs(parameters.ros.input, parameters.gnss.gate.satellite_source),
        magnetometer_input(),
        Input("baro", "sensor_msgs", "FluidPressure", convert.fluid_pressure),
        Input("body_velocity", "geometry_msgs", "TwistWithCovarianceStamped", convert.body_velocity),
        Input("set_pose", "geometry_msgs", "PoseWithCovarianceStamped", set_pose),
    ]


def magnetometer_input() -> Input:
    """The input ``imu/mag``."""
    return Input("imu/mag", "sensor_msgs", "MagneticField", convert.magnetic_field)


def attitude_input() -> Input:
    """The attitude that another node estimates: ``imu/data``."""
    return Input("imu/data", "sensor_msgs", "Imu", convert.imu_attitude)


def navigator_input() -> Input:
    """All that another node estimates, for who learns from it: ``odometry/filtered``."""
    return Input("odometry/filtered", "nav_msgs", "Odometry", navigator_watch.odometry)


def prediction_input() -> Input:
    """The velocity error that another node predicts in an outage: ``outage/velocity_error``."""
    return Input("outage/velocity_error", "geometry_msgs", "TwistWithCovarianceStamped", convert.velocity_error)


def odometry_input() -> Input:
    """The velocity that another node estimates: ``odometry/filtered``."""
    return Input("odometry/filtered", "nav_msgs", "Odometry", convert.odometry_velocity)
