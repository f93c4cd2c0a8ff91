"""What is built can be installed without its sources, and works."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = [pytest.mark.package, pytest.mark.process]

ROOT = Path(__file__).parents[1]


def test_the_wheel_alone_loads_builds_and_writes(tmp_path: Path) -> None:
    """Its data files are in it: arms, report template, export scripts."""
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check"]
    target, work = tmp_path / "site", tmp_path / "work"
    work.mkdir()
    copy = tmp_path / "source"
    copy.mkdir()
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, copy)
    compiled = shutil.ignore_patterns("__pycache__", "*.egg-info")
    shutil.copytree(ROOT / "src", copy / "src", ignore=compiled)
    subprocess.run(
        [*pip, "install", "--quiet", "--no-deps", "--no-build-isolation", "--target", target, copy],
        check=True,
    )
    environment = os.environ | {"PYTHONPATH": str(target)}

    def twinct(*arguments: str) -> str:
        result = subprocess.run(
            [sys.executable, "-m", "twinct", *arguments],
            capture_output=True,
            text=True,
            cwd=work,
            env=environment,
        )
        assert result.returncode == 0, result.stderr
        return result.stdout

    where = subprocess.run(
        [sys.executable, "-c", "import twinct; print(twinct.__file__)"],
        capture_output=True,
        text=True,
        cwd=work,
        env=environment,
    )
    assert where.stdout.startswith(str(target))
    assert "twinct scenario" in twinct("schema")
    scenario = work / "scenario.yaml"
    scenario.write_text(
        "trajectory: {kind: arc, views: 3, longitude_range_deg: 10}\n"
        "detector: {columns: 16, rows: 12, pixel_pitch_mm: 20}\n"
        "specimen: {parts: [{shape: {kind: sphere, radius_mm: 40, mesh_resolution_mm: 4}}]}\n"
        "reconstruction: {iterations: 1, grid: {voxels: 8, voxel_mm: 20}}\n"
    )
    twinct("run", str(scenario), "--out", "out", "--link", "local")
    assert "<html" in (work / "out" / "report.html").read_text()[:500].lower()
    twinct("export", "out", "--to", "rtk")
    assert (work / "out" / "export-rtk" / "load.py").is_file()
