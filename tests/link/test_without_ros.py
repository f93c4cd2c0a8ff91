"""Where rclpy is not installed, twinct.link imports, and says what is missing when it is used."""

import os
import subprocess
import sys

import pytest

from twinct.core.installation import install_command

SCRIPT = """
import sys

for name in ("rclpy", "geometry_msgs", "sensor_msgs", "std_msgs"):
    sys.modules[name] = None  # importing it fails

import twinct.link
from twinct.core.errors import MissingExtraError

try:
    USE
except MissingExtraError as error:
    print(error)
"""


@pytest.mark.process
@pytest.mark.parametrize(
    "use", ["twinct.link.require_ros()", "twinct.link.RosRig", "twinct.link.spin_robots"]
)
def test_missing_rclpy_is_named(use):
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT.replace("USE", use)], capture_output=True, text=True
    )
    assert done.stdout.startswith("rclpy, "), done.stderr
    assert done.stdout.endswith(
        f" are not installed: they come with twinct[ros]: {install_command(['ros'])}; "
        "or use the link local (--link local)\n"
    )


@pytest.mark.process
def test_a_sourced_system_ros_is_left_aside(tmp_path):
    prefix = tmp_path / "opt" / "ros" / "jazzy"
    packages = prefix / "lib" / "python3.12" / "site-packages"
    (packages / "rclpy").mkdir(parents=True)
    (packages / "rclpy" / "__init__.py").write_text("raise SystemExit('built for another Python')")
    sourced = {
        **os.environ,
        "AMENT_PREFIX_PATH": str(prefix),
        "PYTHONPATH": os.pathsep.join([str(packages), os.environ.get("PYTHONPATH", "")]),
    }
    script = (
        "import os; from twinct.link import RosRig; import rclpy; print(rclpy.__name__);"
        "from twinct.link.environment import without_system_ros;"
        "print(any('jazzy' in v for k, v in without_system_ros(os.environ).items()"
        " if k in ('PYTHONPATH', 'LD_LIBRARY_PATH', 'AMENT_PREFIX_PATH')))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, env=sourced
    )
    assert done.stdout.split() == ["rclpy", "False"], done.stderr
