"""What needs no ROS, no gVXR and no MuJoCo imports without them; so does the whole command line."""

from __future__ import annotations

import subprocess
import sys

import pytest

BLOCKED = (
    *("mujoco", "mink", "ruckig", "ompl", "gvxrPython3", "spekpy", "rclpy", "sensor_msgs", "itk"),
    *("ctsimu", "ray", "pandas", "pyarrow", "optuna", "viser", "mjviser", "imageio_ffmpeg"),
)
MODULES = (
    "twinct",
    "twinct.robots.cell",
    "twinct.cli.commands",
    "twinct.workers.cluster",
    "twinct.ctsimu",
    "twinct.ctsimu.export",
    "twinct.ctsimu.suite",
    "twinct.evaluation",
    "twinct.exchange",
    "twinct.core.extras",
    "twinct.robots.gantry",
    "twinct.workers",
    "twinct.runs",
    "twinct.recon",
    "twinct.report",
    "twinct.link",
    "twinct.scan",
    "twinct.scenario",
    "twinct.specimen",
    "twinct.study.results",
    "twinct.trajectory",
    "twinct.uncertainty",
    "twinct.viewer.locate",
    "twinct.xray",
)


@pytest.mark.process
def test_modules_import_without_the_extras() -> None:
    code = f"import sys\nfor name in {BLOCKED!r}:\n    sys.modules[name] = None\n" + "\n".join(
        f"import {module}" for module in MODULES
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
