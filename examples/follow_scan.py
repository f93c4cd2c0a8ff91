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
from sensor_msgs.msg import Image, TimeReference

LATCHED = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def seconds(message: Image | TimeReference) -> float:
    stamp = message.header.stamp
    return stamp.sec + 1e-9 * stamp.nanosec


class Follower(Node):
    """Prints when each view was taken, in simulated time, and its mean transmission."""

    def __init__(self) -> None:
        super().__init__("follower")
        self.views: dict[float, str] = {}
        self.images: dict[float, Image] = {}
        self.create_subscription(TimeReference, "/scan/views", self.on_view, LATCHED)
        self.create_subscription(Image, "/xray/image", self.on_image, LATCHED)
        print("waiting for images", flush=True)

    def on_view(self, message: TimeReference) -> None:
        self.views[seconds(message)] = message.source
        self.tell()

    def on_image(self, message: Image) -> None:
        self.images[seconds(message)] = message
        self.tell()

    def tell(self) -> None:
        """Nothing says which of two topics is heard first."""
        for time_s in sorted(self.views.keys() & self.images.keys()):
            image = self.images.pop(time_s)
            mean = np.frombuffer(image.data, dtype=np.float32).mean()
            size = f"{image.width} x {image.height}"
            print(f"{self.views[time_s]} at {time_s:.3f} s: {size}, mean {mean:.4f}")


def main() -> None:
    rclpy.init()
    try:
        rclpy.spin(Follower())
    except (KeyboardInterrupt, ExternalShutdownException):
        pass


if __name__ == "__main__":
    main()
