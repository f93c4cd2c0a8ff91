"""Extras that are not there, or are there and broken, are named before anything is done."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from twinct.core.errors import InputError, MissingExtraError
from twinct.core.extras import require
from twinct.core.installation import install_command

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


def test_all_missing_packages_are_named_at_once_with_one_command(monkeypatch) -> None:
    for module in ("mink", "ompl", "itk"):
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingExtraError) as caught:
        require("robots", "xray", "rtk")
    assert str(caught.value) == (
        "mink, ompl, itk-rtk are not installed: they come with twinct[robots,rtk]: "
        f"{install_command(['robots', 'rtk'])}; or use reconstruction.algorithm: sart"
    )


def test_what_is_broken_is_named_beside_what_is_missing(monkeypatch, tmp_path: Path) -> None:
    (tmp_path / "ompl.py").write_text("raise OSError('libompl is gone')")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "ompl", raising=False)
    monkeypatch.setitem(sys.modules, "itk", None)
    with pytest.raises(InputError) as caught:
        require("robots", "rtk")
    assert [p.partition(" ")[0] for p in caught.value.problems] == ["ompl", "itk-rtk"]


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
