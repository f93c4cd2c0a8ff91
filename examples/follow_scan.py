"""Follow a scan from a ROS 2 node that knows only the standard messages.

Start it with the domain that ``twinct run`` prints:

    ROS_DOMAIN_ID=17 ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST python examples/follow_scan.py
"""

from __future__ import annotations

import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import Image

LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Follower(Node):
    """Prints the mean transmission of each view."""

    def __init__(self) -> None:
        super().__init__("follower")
        self.create_subscription(Image, "/xray/image", self.on_image, LATCHED)
        print("waiting for images", flush=True)

    def on_image(self, message: Image) -> None:
        pixels = np.frombuffer(message.data, dtype=np.float32)
        stamp = message.header.stamp
        print(f"view at {stamp.sec}: {message.width} x {message.height}, mean {pixels.mean():.4f}")


def main() -> None:
    rclpy.init()
    try:
        rclpy.spin(Follower())
    except (KeyboardInterrupt, ExternalShutdownException):
        pass


if __name__ == "__main__":
    main()
