"""Drive the standalone robot and X-ray nodes view by view, with standard messages only.

In two other terminals:

    twinct node robots demo
    twinct node xray demo
"""

from __future__ import annotations

import numpy as np
import rclpy
from geometry_msgs.msg import Pose, PoseArray
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import Image, TimeReference

from twinct.scenario import load_scenario
from twinct.trajectory import commanded_views

LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
REPEAT_S = 2.0


def message_of(pose) -> Pose:
    """Metres and a quaternion (x, y, z, w)."""
    message = Pose()
    position, quat = pose.to_metres()
    message.position.x, message.position.y, message.position.z = map(float, position)
    orientation = message.orientation
    orientation.x, orientation.y, orientation.z, orientation.w = map(float, quat)
    return message


def stamp_of(message) -> tuple[int, int]:
    return message.header.stamp.sec, message.header.stamp.nanosec


class Driver(Node):
    """Sends a target, waits for its image, sends the next."""

    def __init__(self) -> None:
        super().__init__("driver")
        scenario = load_scenario("demo")
        geometry = commanded_views(scenario.trajectory, scenario.detector.panel)
        self.targets = list(zip(geometry.source_poses(), geometry.detector_poses(), strict=True))[
            :5
        ]
        self.view = 0
        self.taken: dict[int, tuple[int, int]] = {}
        self.image: Image | None = None
        self.publisher = self.create_publisher(PoseArray, "/scan/target", LATCHED)
        self.create_subscription(TimeReference, "/scan/views", self.on_view, LATCHED)
        self.create_subscription(Image, "/xray/image", self.on_image, LATCHED)
        self.create_timer(REPEAT_S, self.ask)
        self.ask()

    def ask(self) -> None:
        message = PoseArray()
        message.header.frame_id = "world"
        message.header.stamp.sec = 1000 + self.view
        message.poses = [message_of(pose) for pose in self.targets[self.view]]
        self.publisher.publish(message)

    def on_view(self, message: TimeReference) -> None:
        """The answer to a target has the time at which the image was taken."""
        self.taken[message.time_ref.sec - 1000] = stamp_of(message)
        self.go_on()

    def on_image(self, message: Image) -> None:
        self.image = message
        self.go_on()

    def go_on(self) -> None:
        if self.image is None or stamp_of(self.image) != self.taken.get(self.view):
            return
        mean = np.frombuffer(self.image.data, dtype=np.float32).mean()
        print(f"view {self.view}: mean {mean:.4f}")
        self.view += 1
        if self.view == len(self.targets):
            raise SystemExit
        self.ask()


def main() -> None:
    rclpy.init()
    try:
        rclpy.spin(Driver())
    except (KeyboardInterrupt, SystemExit):
        pass


if __name__ == "__main__":
    main()
