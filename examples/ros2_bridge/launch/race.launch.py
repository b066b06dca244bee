"""Launch the planner and, unless ``simulator:=false``, a race in place of the cars."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

PACKAGE = "pcs_racing_ros"


def generate_launch_description() -> LaunchDescription:
    shipped = Path(get_package_share_directory(PACKAGE)) / "config" / "parameters.yaml"
    common = {"package": PACKAGE, "parameters": [LaunchConfiguration("parameters")]}
    return LaunchDescription(
        [
            DeclareLaunchArgument("parameters", default_value=str(shipped)),
            DeclareLaunchArgument("simulator", default_value="true"),
            Node(
                executable="simulator",
                condition=IfCondition(LaunchConfiguration("simulator")),
                **common,
            ),
            Node(executable="planner", **common),
        ]
    )
