"""A recording is imported without what the import does not need, or the extra is named."""

import subprocess
import sys

import pytest

from twinct.scan import ScanStore

ROS = ("rclpy", "geometry_msgs", "sensor_msgs", "std_msgs", "diagnostic_msgs", "trajectory_msgs")
ROBOTS = ("mujoco", "mink", "daqp", "ruckig", "ompl")

pytestmark = pytest.mark.process


def imported(recording, out, absent):
    """The end of ``twinct import`` where some modules cannot be imported."""
    script = (
        f"import sys; sys.modules |= dict.fromkeys({absent!r}); "
        "from twinct.cli import run_command; sys.exit(run_command(sys.argv[1:]))"
    )
    command = [sys.executable, "-c", script, "import", str(recording), "--out", str(out)]
    return subprocess.run(command, capture_output=True, text=True)


def test_a_recording_of_a_gantry_needs_the_mcap_libraries_alone(take, tmp_path):
    scan = take(tmp_path / "scan", "cell={kind: gantry}")
    done = imported(scan.folder / "scan.mcap", tmp_path / "again", (*ROS, *ROBOTS))
    assert done.returncode == 0, done.stderr
    assert ScanStore(tmp_path / "again" / "scan.zarr").acquired == 4


@pytest.mark.parametrize("absent", [ROS, ROBOTS])
def test_a_recording_of_arms_needs_neither_ros_nor_mujoco(taken, tmp_path, absent):
    done = imported(taken.folder / "scan.mcap", tmp_path / "again", absent)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("absent", "extra"),
    [(("mcap",), "record"), (("mcap_ros2",), "record"), (("zstandard",), "record")],
)
def test_a_missing_extra_is_named(taken, tmp_path, absent, extra):
    done = imported(taken.folder / "scan.mcap", tmp_path / "again", absent)
    assert done.returncode == 2 and f"twinct[{extra}]" in done.stderr, done.stderr
    assert not (tmp_path / "again").exists()
