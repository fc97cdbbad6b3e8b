"""Launch file of the composed estimator with the topics of MAVROS, optionally with output to the autopilot:

ros2 launch nav_pose_estimator mavros.launch.py autopilot:=mavros mavros:=/drone1/mavros namespace:=drone1
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

_TOPICS = {
    "imu/data_raw": "/imu/data_raw",
    "imu/mag": "/imu/mag",
    "baro": "/imu/static_pressure",
    "gps/fix": "/global_position/raw/fix",
    "gps/vel": "/global_position/raw/gps_vel",
    "gps/satellites": "/global_position/raw/satellites",
    "autopilot/odometry": "/odometry/out",
    "autopilot/gps_input": "/gps_input/gps_input",
}


def generate_launch_description() -> LaunchDescription:
    """Launch the estimator. MAVROS has its own launch files; read docs/autopilot.md before setting ``autopilot``."""
    config = [FindPackageShare("nav_pose_estimator"), "config"]
    text = {"value_type": str}
    frames = {
        f"ros.frames.{name}": ParameterValue([LaunchConfiguration("frame_prefix"), name], **text)
        for name in ("map", "odom", "base_link")
    }
    return LaunchDescription(
        [
            DeclareLaunchArgument("namespace", default_value="", description="Of the vehicle, without a slash"),
            DeclareLaunchArgument("frame_prefix", default_value="", description="Of map, odom and base_link: drone1/"),
            DeclareLaunchArgument("mavros", default_value="/mavros", description="Where the topics of MAVROS begin"),
            DeclareLaunchArgument("autopilot", default_value="none", description="none, mavros or mavros_gps"),
            DeclareLaunchArgument("autopilot_when", default_value="denied", description="denied or always"),
            DeclareLaunchArgument("state_file", default_value="", description="Of this vehicle, to go on in flight"),
            DeclareLaunchArgument("respawn", default_value="true", description="Start again when it ends"),
            Node(
                package="nav_pose_estimator",
                executable="pose_estimator",
                namespace=LaunchConfiguration("namespace"),
                parameters=[
                    PathJoinSubstitution([*config, "nav_pose_estimator.yaml"]),
                    PathJoinSubstitution([*config, "driver_mavros.yaml"]),
                    {
                        "ros.output.autopilot": ParameterValue(LaunchConfiguration("autopilot"), **text),
                        "ros.output.autopilot_when": ParameterValue(LaunchConfiguration("autopilot_when"), **text),
                        "ros.state.file": ParameterValue(LaunchConfiguration("state_file"), **text),
                        **frames,
                    },
                ],
                remappings=[(ours, [LaunchConfiguration("mavros"), theirs]) for ours, theirs in _TOPICS.items()],
                output="screen",
                respawn=LaunchConfiguration("respawn"),
                respawn_delay=0.5,
            ),
        ]
    )
