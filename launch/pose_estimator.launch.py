"""Launch file of the composed estimator: ros2 launch nav_pose_estimator pose_estimator.launch.py namespace:=drone1"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    """Launch one process, which is restarted half a second after it ends, and resumes in flight with a state file.

    It selects UDP instead of the shared memory of Fast DDS by itself (docs/getting_started.md).
    """
    shipped = PathJoinSubstitution([FindPackageShare("nav_pose_estimator"), "config", "nav_pose_estimator.yaml"])
    return LaunchDescription(
        [
            DeclareLaunchArgument("namespace", default_value="", description="Of the vehicle, without a slash"),
            DeclareLaunchArgument("params_file", default_value=shipped, description="YAML with parameters"),
            DeclareLaunchArgument("state_file", default_value="", description="Of this vehicle; wins over params_file"),
            DeclareLaunchArgument("use_sim_time", default_value="false", description="Time from /clock"),
            DeclareLaunchArgument("respawn", default_value="true", description="Start again when it ends"),
            DeclareLaunchArgument("imu", default_value="imu/data_raw", description="Topic of the IMU"),
            DeclareLaunchArgument("fix", default_value="gps/fix", description="Topic of the GNSS position"),
            DeclareLaunchArgument("velocity", default_value="gps/vel", description="Topic of the GNSS velocity"),
            Node(
                package="nav_pose_estimator",
                executable="pose_estimator",
                namespace=LaunchConfiguration("namespace"),
                parameters=[
                    LaunchConfiguration("params_file"),
                    {
                        "use_sim_time": LaunchConfiguration("use_sim_time"),
                        "ros.state.file": ParameterValue(LaunchConfiguration("state_file"), value_type=str),
                    },
                ],
                remappings=[
                    ("imu/data_raw", LaunchConfiguration("imu")),
                    ("gps/fix", LaunchConfiguration("fix")),
                    ("gps/vel", LaunchConfiguration("velocity")),
                ],
                output="screen",
                respawn=LaunchConfiguration("respawn"),
                respawn_delay=0.5,
            ),
        ]
    )
