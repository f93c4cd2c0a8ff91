"""Where rclpy is not installed, twinct.ros imports, and says what is missing when it is used."""

import subprocess
import sys

import pytest

SCRIPT = """
import sys

for name in ("rclpy", "geometry_msgs", "sensor_msgs", "std_msgs"):
    sys.modules[name] = None  # importing it fails

import twinct.ros
from twinct.errors import MissingExtraError

try:
    USE
except MissingExtraError as error:
    print(error)
"""


@pytest.mark.parametrize(
    "use", ["twinct.ros.require_ros()", "twinct.ros.RosRig", "twinct.ros.spin_robots"]
)
def test_missing_rclpy_is_named(use):
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT.replace("USE", use)], capture_output=True, text=True
    )
    assert done.stdout == (
        "rclpy is not installed: it comes with 'pip install twinct[ros]'; or use --link local\n"
    ), done.stderr
