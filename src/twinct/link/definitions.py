"""Definitions of messages, as in ``.msg`` files.

A recording of the local link needs no ROS. Field names and types match ROS 2 Jazzy's interface
packages; constants and defaults are left out.
"""

from __future__ import annotations

from functools import cache

_FIELDS = {
    "builtin_interfaces/Time": "int32 sec, uint32 nanosec",
    "builtin_interfaces/Duration": "int32 sec, uint32 nanosec",
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
}
_SEPARATOR = "=" * 80


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


def _text(name: str) -> str:
    return _FIELDS[name].replace(", ", "\n")


def with_parts(name: str) -> list[str]:
    """Return a message type and all nested types, each once."""
    names = [name]
    for outer in names:
        for field in _FIELDS[outer].split(", "):
            kind = field.partition(" ")[0].partition("[")[0]
            if kind[0].isupper():
                kind = f"{outer.partition('/')[0]}/{kind}"
            if "/" in kind and kind not in names:
                names.append(kind)
    return names
