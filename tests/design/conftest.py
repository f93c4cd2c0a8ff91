from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from twinct.viewer import live_page
from twinct.viewer.server import LOOPBACK, Server, close, serve

VIEWER = str(Path(__file__).parents[1] / "viewer")

if VIEWER not in sys.path:  # the listener and the browser
    sys.path.insert(0, VIEWER)

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
def small_file(tmp_path: Path) -> Path:
    """A scenario of seconds."""
    path = tmp_path / "small.yaml"
    path.write_text(SMALL, encoding="utf-8")
    return path


@pytest.fixture
def server() -> Iterator[Server]:
    """On any port."""
    made = serve(LOOPBACK, 0)
    yield made
    close(made)


@pytest.fixture(autouse=True)
def _no_browser_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_page, "BROWSER_COMES_S", 0.0)
    monkeypatch.setattr(live_page, "BROWSER_DRAWS_S", 0.0)
