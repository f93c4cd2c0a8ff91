"""Definitions of messages, as in ``.msg`` files.

The ROS 2 wheels contain no such files, and a recording of the local link needs no ROS. Field names
and types match ROS 2 Jazzy's interface packages; constants and defaults are left out. Packages that
no wheel brings are here too: ``tf2_msgs`` of geometry2, and ``control_msgs``, whose action is taken
from FollowJointTrajectory.action of version 5 (Jazzy).
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

_FIELDS = {
    "builtin_interfaces/Time": "int32 sec, uint32 nanosec",
    "builtin_interfaces/Duration": "int32 sec, uint32 nanosec",
    "control_msgs/FollowJointTrajectory": "FollowJointTrajectory_Goal goal, "
    "FollowJointTrajectory_Result result, FollowJointTrajectory_Feedback feedback, "
    "FollowJointTrajectory_SendGoal send_goal_service, "
    "FollowJointTrajectory_GetResult get_result_service, "
    "FollowJointTrajectory_FeedbackMessage feedback_message",
    "control_msgs/FollowJointTrajectory_Feedback": "std_msgs/Header header, string[] joint_names, "
    "trajectory_msgs/JointTrajectoryPoint desired, trajectory_msgs/JointTrajectoryPoint actual, "
    "trajectory_msgs/JointTrajectoryPoint error, string[] multi_dof_joint_names, "
    "trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_desired, "
    "trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_actual, "
    "trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_error",
    "control_msgs/FollowJointTrajectory_FeedbackMessage": "unique_identifier_msgs/UUID goal_id, "
    "FollowJointTrajectory_Feedback feedback",
    "control_msgs/FollowJointTrajectory_GetResult": ""
    "FollowJointTrajectory_GetResult_Request request_message, "
    "FollowJointTrajectory_GetResult_Response response_message, "
    "FollowJointTrajectory_GetResult_Event event_message",
    "control_msgs/FollowJointTrajectory_GetResult_Event": "service_msgs/ServiceEventInfo info, "
    "FollowJointTrajectory_GetResult_Request[<=1] request, "
    "FollowJointTrajectory_GetResult_Response[<=1] response",
    "control_msgs/FollowJointTrajectory_GetResult_Request": "unique_identifier_msgs/UUID goal_id",
    "control_msgs/FollowJointTrajectory_GetResult_Response": "int8 status, "
    "FollowJointTrajectory_Result result",
    "control_msgs/FollowJointTrajectory_Goal": "trajectory_msgs/JointTrajectory trajectory, "
    "trajectory_msgs/MultiDOFJointTrajectory multi_dof_trajectory, "
    "JointTolerance[] path_tolerance, JointComponentTolerance[] component_path_tolerance, "
    "JointTolerance[] goal_tolerance, JointComponentTolerance[] component_goal_tolerance, "
    "builtin_interfaces/Duration goal_time_tolerance",
    "control_msgs/FollowJointTrajectory_Result": "int32 error_code, string error_string",
    "control_msgs/FollowJointTrajectory_SendGoal": ""
    "FollowJointTrajectory_SendGoal_Request request_message, "
    "FollowJointTrajectory_SendGoal_Response response_message, "
    "FollowJointTrajectory_SendGoal_Event event_message",
    "control_msgs/FollowJointTrajectory_SendGoal_Event": "service_msgs/ServiceEventInfo info, "
    "FollowJointTrajectory_SendGoal_Request[<=1] request, "
    "FollowJointTrajectory_SendGoal_Response[<=1] response",
    "control_msgs/FollowJointTrajectory_SendGoal_Request": "unique_identifier_msgs/UUID goal_id, "
    "FollowJointTrajectory_Goal goal",
    "control_msgs/FollowJointTrajectory_SendGoal_Response": "bool accepted, "
    "builtin_interfaces/Time stamp",
    "control_msgs/JointComponentTolerance": "string joint_name, uint16 component, "
    "float64 position, float64 velocity, float64 acceleration",
    "control_msgs/JointTolerance": "string name, float64 position, float64 velocity, "
    "float64 acceleration",
    "diagnostic_msgs/DiagnosticArray": "std_msgs/Header header, DiagnosticStatus[] status",
    "diagnostic_msgs/DiagnosticStatus": "byte level, string name, string message, "
    "string hardware_id, KeyValue[] values",
    "diagnostic_msgs/KeyValue": "string key, string value",
    "geometry_msgs/Point": "float64 x, float64 y, float64 z",
    "geometry_msgs/Pose": "Point position, Quaternion orientation",
    "geometry_msgs/PoseArray": "std_msgs/Header header, Pose[] poses",
    "geometry_msgs/Quaternion": "float64 x, float64 y, float64 z, float64 w",
    "geometry_msgs/Transform": "Vector3 translation, Quaternion rotation",
    "geometry_msgs/TransformStamped": "std_msgs/Header header, string child_frame_id, "
    "Transform transform",
    "geometry_msgs/Twist": "Vector3 linear, Vector3 angular",
    "geometry_msgs/Vector3": "float64 x, float64 y, float64 z",
    "rosgraph_msgs/Clock": "builtin_interfaces/Time clock",
    "sensor_msgs/CameraInfo": "std_msgs/Header header, uint32 height, uint32 width, "
    "string distortion_model, float64[] d, float64[9] k, float64[9] r, float64[12] p, "
    "uint32 binning_x, uint32 binning_y, RegionOfInterest roi",
    "sensor_msgs/Image": "std_msgs/Header header, uint32 height, uint32 width, string encoding, "
    "uint8 is_bigendian, uint32 step, uint8[] data",
    "sensor_msgs/JointState": "std_msgs/Header header, string[] name, float64[] position, "
    "float64[] velocity, float64[] effort",
    "sensor_msgs/RegionOfInterest": "uint32 x_offset, uint32 y_offset, uint32 height, "
    "uint32 width, bool do_rectify",
    "sensor_msgs/TimeReference": "std_msgs/Header header, builtin_interfaces/Time time_ref, "
    "string source",
    "service_msgs/ServiceEventInfo": "uint8 event_type, builtin_interfaces/Time stamp, "
    "uint8[16] client_gid, int64 sequence_number",
    "std_msgs/Float64MultiArray": "MultiArrayLayout layout, float64[] data",
    "std_msgs/Header": "builtin_interfaces/Time stamp, string frame_id",
    "std_msgs/MultiArrayDimension": "string label, uint32 size, uint32 stride",
    "std_msgs/MultiArrayLayout": "MultiArrayDimension[] dim, uint32 data_offset",
    "std_msgs/String": "string data",
    "tf2_msgs/TFMessage": "geometry_msgs/TransformStamped[] transforms",
    "trajectory_msgs/JointTrajectory": "std_msgs/Header header, string[] joint_names, "
    "JointTrajectoryPoint[] points",
    "trajectory_msgs/JointTrajectoryPoint": "float64[] positions, float64[] velocities, "
    "float64[] accelerations, float64[] effort, builtin_interfaces/Duration time_from_start",
    "trajectory_msgs/MultiDOFJointTrajectory": "std_msgs/Header header, string[] joint_names, "
    "MultiDOFJointTrajectoryPoint[] points",
    "trajectory_msgs/MultiDOFJointTrajectoryPoint": "geometry_msgs/Transform[] transforms, "
    "geometry_msgs/Twist[] velocities, geometry_msgs/Twist[] accelerations, "
    "builtin_interfaces/Duration time_from_start",
    "unique_identifier_msgs/UUID": "uint8[16] uuid",
}
_SEPARATOR = "=" * 80

ACTIONS = ("FollowJointTrajectory",)
"""Actions, whose messages begin with their names."""


class Member(NamedTuple):
    """Field of a message.

    Attributes:
        kind: its type without brackets, such as ``float64`` or ``std_msgs/Header``.
        array: brackets of an array or a sequence, such as ``[]``; else "".
        name: its name.
    """

    kind: str
    array: str
    name: str

    @property
    def nested(self) -> bool:
        """True for a message within the message."""
        return "/" in self.kind


@cache
def members(name: str) -> tuple[Member, ...]:
    """Return the fields of a message such as ``geometry_msgs/Pose``."""
    fields = []
    for definition in _FIELDS[name].split(", "):
        kind, field = definition.split()
        kind, bracket, size = kind.partition("[")
        if kind[0].isupper():
            kind = f"{name.partition('/')[0]}/{kind}"
        fields.append(Member(kind, bracket + size, field))
    return tuple(fields)


@cache
def definition(kind: str) -> str:
    """Return MCAP's ``ros2msg`` text of a message: its fields, then fields of nested types.

    Args:
        kind: message type, such as ``geometry_msgs/msg/Pose``.
    """
    name = short_name(kind)
    return f"\n{_SEPARATOR}\n".join(
        _text(part) if part == name else f"MSG: {part}\n{_text(part)}" for part in with_parts(name)
    )


def known(kind: str) -> bool:
    """Return True if a type such as ``geometry_msgs/msg/Pose`` is defined here."""
    return short_name(kind) in _FIELDS


def short_name(kind: str) -> str:
    """Return a type such as ``geometry_msgs/msg/Pose`` without its middle part."""
    package, _, name = kind.partition("/")
    return f"{package}/{name.rpartition('/')[2]}"


def full_name(name: str) -> str:
    """Return a type such as ``geometry_msgs/Pose`` with its middle part."""
    package, _, name = name.partition("/")
    return f"{package}/{'action' if name.startswith(ACTIONS) else 'msg'}/{name}"


def _text(name: str) -> str:
    return _FIELDS[name].replace(", ", "\n")


def with_parts(name: str) -> list[str]:
    """Return a message type and all nested types, each once."""
    names = [name]
    for outer in names:
        for member in members(outer):
            if member.nested and member.kind not in names:
                names.append(member.kind)
    return names
