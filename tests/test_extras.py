"""Extras that are not there, or are there and broken, are named before anything is done."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from twinct.errors import InputError, MissingExtraError
from twinct.extras import require

DEMO = Path(__file__).parents[1] / "scenarios" / "demo.yaml"


@pytest.mark.parametrize(
    ("module", "extra"),
    [("mujoco", "robots"), ("mink", "robots"), ("gvxrPython3", "xray"), ("itk", "rtk")]
    + [("rclpy", "ros"), ("sensor_msgs.msg", "ros"), ("pandas", "study"), ("ray", "cluster")]
    + [("viser", "view"), ("mjviser", "view")],
)
def test_a_missing_package_is_named_with_its_extra(monkeypatch, module: str, extra: str) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingExtraError, match=rf"not installed.*twinct\[{extra}\]"):
        require(extra)


def test_every_missing_extra_is_one_problem(monkeypatch) -> None:
    for module in ("mink", "itk"):
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(InputError) as caught:
        require("robots", "xray", "rtk")
    assert [p.partition(" ")[0] for p in caught.value.problems] == ["mink", "itk-rtk"]


@pytest.mark.process
@pytest.mark.parametrize("module", ["rclpy", "mink", "itk"])
def test_a_package_that_fails_on_import_is_bad_input_before_any_work(
    tmp_path: Path, module: str
) -> None:
    (tmp_path / module).mkdir()
    (tmp_path / module / "__init__.py").write_text("raise OSError('libspdlog.so.1.12 is gone')")
    paths = [str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])]
    out = tmp_path / "out"
    command = ["run", str(DEMO), "--out", str(out), "--set", "reconstruction.algorithm=rtk_sart"]
    done = subprocess.run(
        [sys.executable, "-m", "twinct", *command],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
    )
    assert done.returncode == 2, done.stderr
    assert "cannot be imported (OSError: libspdlog.so.1.12 is gone)" in done.stderr
    assert "plan" not in done.stderr and not out.exists()
