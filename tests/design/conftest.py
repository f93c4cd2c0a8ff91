from __future__ import annotations

from pathlib import Path

import pytest
from pages import no_browser_is_waited_for, server

__all__ = ["no_browser_is_waited_for", "server"]

SMALL = """\
extends: demo
name: small
# A body of which nothing is the same from two sides.
specimen:
  parts:
    - shape: {kind: sphere, radius_mm: 35, mesh_resolution_mm: 4}
    - name: bump
      shape: {kind: sphere, radius_mm: 22, mesh_resolution_mm: 4}
      position_mm: [40, 30, 35]
detector: {columns: 48, rows: 32, pixel_pitch_mm: 6}
trajectory: {views: 12} # few
cell:
  objects:
    - {name: stand, shape: {kind: box, size_mm: [100, 100, 100]}, position_mm: [0, 900, -600]}
reconstruction: {iterations: 2, grid: {voxels: [20, 24, 28], voxel_mm: 6}}
"""


@pytest.fixture
def files() -> bool:
    """The page takes uploads."""
    return True


@pytest.fixture
def small_file(tmp_path: Path) -> Path:
    """A scenario of seconds."""
    path = tmp_path / "small.yaml"
    path.write_text(SMALL, encoding="utf-8")
    return path
