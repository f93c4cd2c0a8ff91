"""Topics of a scan and their message types, for both links."""

TARGET = "/scan/target"
REACHED = "/scan/reached"
STATE = "/scan/state"
PLAN = "/scan/plan"
PLAN_VIEWS = "/scan/plan_views"
COMMANDED = "/scan/commanded"
VIEWS = "/scan/views"
JOINTS = "/joint_states"
DESCRIPTION = "/robot_description"
CLOCK = "/clock"
IMAGE = "/xray/image"
CAMERA = "/xray/camera_info"
DISPLAY = "/xray/display"
DISPLAY_CAMERA = "/xray/display/camera_info"
DIAGNOSTICS = "/diagnostics"
TF = "/tf"

KINDS = {
    TARGET: "geometry_msgs/msg/PoseArray",
    REACHED: "geometry_msgs/msg/PoseArray",
    STATE: "std_msgs/msg/Float64MultiArray",
    PLAN: "trajectory_msgs/msg/JointTrajectory",
    PLAN_VIEWS: "diagnostic_msgs/msg/DiagnosticArray",
    COMMANDED: "geometry_msgs/msg/PoseArray",
    VIEWS: "sensor_msgs/msg/TimeReference",
    JOINTS: "sensor_msgs/msg/JointState",
    DESCRIPTION: "std_msgs/msg/String",
    CLOCK: "rosgraph_msgs/msg/Clock",
    IMAGE: "sensor_msgs/msg/Image",
    CAMERA: "sensor_msgs/msg/CameraInfo",
    DISPLAY: "sensor_msgs/msg/Image",
    DISPLAY_CAMERA: "sensor_msgs/msg/CameraInfo",
    DIAGNOSTICS: "diagnostic_msgs/msg/DiagnosticArray",
    TF: "tf2_msgs/msg/TFMessage",
}
"""Message type of each topic; the ROS 2 link itself does not publish ``/tf``."""
