from __future__ import annotations

from pathlib import Path

import pytest
import trimesh

from twinct.cell import CellModel, build_cell
from twinct.geometry import Pose
from twinct.motion import MotionPlan, plan_motion
from twinct.scenario import Cell, Detector, Motion, load_scenario
from twinct.trajectory import SinusoidTrajectory, commanded_views
from twinct.views import PosePairs, Target

PAPER_CELL = load_scenario(Path(__file__).parents[2] / "scenarios" / "paper.yaml").cell
assert isinstance(PAPER_CELL, Cell)

VIEWS = 24

AS_IN_THE_PAPER = Motion(scheme="planned", tool_speed_mm_s=125)
"""As in scenarios/paper.yaml."""


@pytest.fixture(scope="session")
def head() -> trimesh.Trimesh:
    mesh = trimesh.creation.icosphere(subdivisions=3)
    mesh.apply_scale((72.0, 90.0, 110.0))
    return mesh


@pytest.fixture(scope="session")
def cell(head: trimesh.Trimesh) -> CellModel:
    return build_cell(PAPER_CELL, head, Pose.identity(), Detector().panel)


@pytest.fixture(scope="session")
def paper_targets() -> list[Target]:
    """All 399 views of the paper."""
    panel = Detector().panel
    geometry = commanded_views(SinusoidTrajectory(kind="sinusoid", views=399), panel)
    return PosePairs.from_geometry(geometry).targets()


@pytest.fixture(scope="session")
def targets(paper_targets: list[Target]) -> list[Target]:
    """The first views of the paper: the arms are stretched furthest there."""
    return paper_targets[:VIEWS]


@pytest.fixture(scope="session")
def plan(cell: CellModel, targets: list[Target]) -> MotionPlan:
    return plan_motion(cell, AS_IN_THE_PAPER, targets)
