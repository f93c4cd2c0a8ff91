from __future__ import annotations

from pathlib import Path

import pytest
import trimesh

from twinct.cell import CellModel, build_cell
from twinct.geometry import Pose
from twinct.scenario import Cell, Detector, load_scenario

PAPER_CELL = load_scenario(Path(__file__).parents[2] / "scenarios" / "paper.yaml").cell
assert isinstance(PAPER_CELL, Cell)


@pytest.fixture(scope="session")
def head() -> trimesh.Trimesh:
    mesh = trimesh.creation.icosphere(subdivisions=3)
    mesh.apply_scale((72.0, 90.0, 110.0))
    return mesh


@pytest.fixture(scope="session")
def cell(head: trimesh.Trimesh) -> CellModel:
    return build_cell(PAPER_CELL, head, Pose.identity(), Detector().panel)
