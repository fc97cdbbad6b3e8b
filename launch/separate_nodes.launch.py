"""Attitude filter, navigator and learner as three processes: ros2 launch nav_pose_estimator separate_nodes.launch.py"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    """Launch three processes. Each runs without the others, and is restarted half a second after it ends.

    With a state file the navigator resumes in flight. All select UDP instead of the shared memory of Fast DDS by
    themselves (docs/getting_started.md).
    """
    shipped = PathJoinSubstitution([FindPackageShare("nav_pose_estimator"), "config", "nav_pose_estimator.yaml"])
    own = {"use_sim_time": LaunchConfiguration("use_sim_time")}
    state = {"ros.state.file": ParameterValue(LaunchConfiguration("state_file"), value_type=str)}
    nodes = [
        Node(
            package="nav_pose_estimator",
            executable=executable,
            namespace=LaunchConfiguration("namespace"),
            parameters=[LaunchConfiguration("params_file"), {**own, **more}],
            output="screen",
            respawn=LaunchConfiguration("respawn"),
            respawn_delay=0.5,
        )
        for executable, more in (("attitude_node", {}), ("sins_node", state), ("anfis_node", {}))
    ]
    return LaunchDescription(
        [
            DeclareLaunchArgument("namespace", default_value="", description="Of the vehicle, without a slash"),
            DeclareLaunchArgument("params_file", default_value=shipped, description="YAML with parameters"),
            DeclareLaunchArgument("state_file", default_value="", description="Of this vehicle; wins over params_file"),
            DeclareLaunchArgument("use_sim_time", default_value="false", description="Time from /clock"),
            DeclareLaunchArgument("respawn", default_value="true", description="Start again when one ends"),
            *nodes,
        ]
    )
