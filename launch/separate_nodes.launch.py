"""Attitude filter, navigator and learner as three processes: ros2 launch nav_pose_estimator separate_nodes.launch.py"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    """Each goes on without the others, and is started again two seconds after it has ended."""
    shipped = PathJoinSubstitution([FindPackageShare("nav_pose_estimator"), "config", "nav_pose_estimator.yaml"])
    nodes = [
        Node(
            package="nav_pose_estimator",
            executable=executable,
            namespace=LaunchConfiguration("namespace"),
            parameters=[LaunchConfiguration("params_file"), {"use_sim_time": LaunchConfiguration("use_sim_time")}],
            output="screen",
            respawn=LaunchConfiguration("respawn"),
            respawn_delay=2.0,
        )
        for executable in ("attitude_node", "sins_node", "anfis_node")
    ]
    return LaunchDescription(
        [
            DeclareLaunchArgument("namespace", default_value="", description="Of the vehicle, without a slash"),
            DeclareLaunchArgument("params_file", default_value=shipped, description="YAML with parameters"),
            DeclareLaunchArgument("use_sim_time", default_value="false", description="Time from /clock"),
            DeclareLaunchArgument("respawn", default_value="true", description="Start again when one ends"),
            *nodes,
        ]
    )
