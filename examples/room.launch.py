"""Frames and RViz beside a scan, on a machine with ROS 2 Jazzy of its own.

    twinct urdf demo --out out/room
    ros2 launch examples/room.launch.py description:=out/room/cell.urdf

with the ROS_DOMAIN_ID that ``twinct run`` prints, and ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST.
The frames in ``/tf`` are the scan's own. ``robot_state_publisher`` only brings the description with
meshes; its frames, of which the links have other parents, go to topics of their own.
``rviz:=false`` leaves RViz out.
"""

# Packages of a system ROS, which no wheel brings.
# pyright: reportMissingImports=false

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import Command, LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

RVIZ = Path(__file__).with_name("room.rviz")


def generate_launch_description() -> LaunchDescription:
    """What ``ros2 launch`` asks for."""
    urdf = Command(["cat ", LaunchConfiguration("description")])
    return LaunchDescription(
        [
            DeclareLaunchArgument("description", description="what twinct urdf wrote: cell.urdf"),
            DeclareLaunchArgument("rviz", default_value="true"),
            Node(
                package="robot_state_publisher",
                executable="robot_state_publisher",
                parameters=[
                    {
                        "robot_description": ParameterValue(urdf, value_type=str),
                        "use_sim_time": True,
                        # The joints of a view may come a moment after later ones.
                        "ignore_timestamp": True,
                    }
                ],
                # The graph has a description already, with boxes in place of meshes.
                remappings=[
                    ("robot_description", "/room_description"),
                    ("tf", "/room_tf"),
                    ("tf_static", "/room_tf_static"),
                    ("/tf", "/room_tf"),
                    ("/tf_static", "/room_tf_static"),
                ],
            ),
            Node(
                package="rviz2",
                executable="rviz2",
                arguments=["-d", str(RVIZ)],
                parameters=[{"use_sim_time": True}],
                condition=IfCondition(LaunchConfiguration("rviz")),
            ),
        ]
    )
