"""Both nodes of a cell, in a namespace: several cells share one graph.

    ros2 launch examples/cell.launch.py scenario:=demo cell:=cell_a

on a machine with ROS 2 Jazzy of its own, with ``twinct`` on the path. All names are then below
``/cell_a``: ``/cell_a/scan/target``, ``/cell_a/joint_states``, ``/cell_a/clock``, ``/cell_a/tf``.
"""

# Packages of a system ROS, which no wheel brings.
# pyright: reportMissingImports=false

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.substitutions import LaunchConfiguration


def generate_launch_description() -> LaunchDescription:
    """What ``ros2 launch`` asks for."""
    scenario, namespace = LaunchConfiguration("scenario"), LaunchConfiguration("cell")
    nodes = [
        ExecuteProcess(
            cmd=["twinct", "node", node, scenario, "--ros-args", "-r", ["__ns:=/", namespace]],
            name=node,
            output="screen",
        )
        for node in ("robots", "xray")
    ]
    return LaunchDescription(
        [
            DeclareLaunchArgument("scenario", description="scenario file of the cell"),
            DeclareLaunchArgument("cell", default_value="cell"),
            *nodes,
        ]
    )
