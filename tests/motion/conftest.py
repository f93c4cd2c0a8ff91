from __future__ import annotations

import pytest

from twinct.geometry.wire import PosePairs, targets_of
from twinct.robots.cell import CellModel
from twinct.robots.motion import MotionPlan, plan_motion
from twinct.scenario import Detector, Motion
from twinct.trajectory import SinusoidTrajectory, commanded_views

VIEWS = 24

AS_IN_THE_PAPER = Motion(scheme="planned", tool_speed_mm_s=125)
"""As in scenarios/paper.yaml."""


@pytest.fixture(scope="session")
def paper_targets() -> list[PosePairs]:
    """All 399 views of the paper."""
    panel = Detector().panel
    geometry = commanded_views(SinusoidTrajectory(kind="sinusoid", views=399), panel)
    return targets_of(geometry)


@pytest.fixture(scope="session")
def targets(paper_targets: list[PosePairs]) -> list[PosePairs]:
    """The first views of the paper: the arms are stretched furthest there."""
    return paper_targets[:VIEWS]


@pytest.fixture(scope="session")
def plan(cell: CellModel, targets: list[PosePairs]) -> MotionPlan:
    return plan_motion(cell, AS_IN_THE_PAPER, targets)
