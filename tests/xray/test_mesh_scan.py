"""Scans with the engine mesh, where there is no gVXR."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from twinct.runs import simulate
from twinct.scan import ScanStore
from twinct.scenario import load_scenario

SMALL = Path(__file__).parents[1] / "same_bytes" / "small.yaml"


@pytest.fixture
def without_gvxr(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Take gVXR away from this process and from all that it starts."""
    monkeypatch.setitem(sys.modules, "gvxrPython3", None)
    code = "import sys\nsys.modules['gvxrPython3'] = None\n"
    (tmp_path / "sitecustomize.py").write_text(code)
    paths = [str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(paths))


@pytest.mark.usefixtures("without_gvxr")
def test_a_scan_is_simulated_without_gvxr() -> None:
    keys = {"xray.engine": "mesh", "trajectory.views": 3, "cell": {"kind": "gantry"}}
    images = [simulate(load_scenario(SMALL, keys)).transmission for _ in range(2)]
    assert images[0].min() < 0.1 and images[0].max() == 1
    assert np.array_equal(*images)


def twinct(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "twinct", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True)


@pytest.mark.tutorial
@pytest.mark.process
@pytest.mark.usefixtures("without_gvxr")
def test_both_links_run_without_gvxr_and_give_the_same_images(tmp_path: Path) -> None:
    refused = twinct("run", SMALL, "--out", tmp_path / "refused", "--link", "local")
    assert refused.returncode == 2 and "--set xray.engine=mesh" in refused.stderr
    images = []
    for link in ("local", "ros2"):
        out = tmp_path / link
        changes = ("--set", "xray.engine=mesh", "--set", "trajectory.views=3")
        done = twinct("run", SMALL, "--out", out, "--link", link, *changes)
        assert done.returncode == 0, done.stderr
        assert "rendered by mesh" in (out / "report.html").read_text(encoding="utf-8")
        images.append(ScanStore(out / "scan.zarr").read().transmission)
    assert images[0].min() < 0.1
    assert np.array_equal(*images)
