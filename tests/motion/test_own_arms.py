"""An arm from a URDF file plans and moves like any other."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from twinct.geometry import Pose
from twinct.geometry.wire import PosePairs, targets_of
from twinct.robots.cell import CellModel, build_cell
from twinct.robots.motion import RobotSimulation, plan_motion
from twinct.scenario import Cell, Detector, Motion
from twinct.trajectory import ArcTrajectory, commanded_views

URDF = Path(__file__).parents[1] / "cell" / "six_axis.urdf"
BRANCHES = ((-30, 45, 150, -30, -100, -90), (-150, -45, -150, 30, 100, 90))
"""Two ways of the source arm to hold the middle view, as rough as by hand, deg."""


def room(*homes: tuple[float, ...] | None) -> CellModel:
    arm = {"file": URDF, "base": "base_link"}
    places = zip(("source_arm", "detector_arm"), (850, -850), homes, strict=True)
    section = Cell.model_validate(
        {side: {**arm, "home": home, "base_position_mm": (x, 0, -200)} for side, x, home in places}
    )
    return build_cell(section, None, Pose.identity(), Detector().panel)


@pytest.fixture(scope="module")
def targets() -> list[PosePairs]:
    arc = ArcTrajectory(kind="arc", views=3, longitude_range_deg=15)
    return targets_of(commanded_views(arc, Detector().panel))


@pytest.mark.parametrize("scheme", ["planned", "reactive"])
def test_views_are_reached(
    targets: list[PosePairs], scheme: Literal["planned", "reactive"]
) -> None:
    cell, motion = room(None, None), Motion(scheme=scheme)
    simulation = RobotSimulation(cell, motion, plan_motion(cell, motion, targets))
    for view, target in enumerate(targets):
        executed = simulation.move(view, target).executed
        assert executed.source[0].distance_mm(target.source[0]) < Motion().tolerance_mm
        assert executed.detector[0].distance_mm(target.detector[0]) < Motion().tolerance_mm
        assert simulation.watch.torque_share.max() < 1
        assert simulation.watch.speed_share.max() <= 1
        assert not simulation.watch.contacts


@pytest.mark.parametrize("branch", BRANCHES)
def test_the_search_begins_at_home(
    targets: list[PosePairs], branch: tuple[float, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("twinct.robots.motion.follow.RESTARTS", 1)
    homes = branch, (*branch[:5], -branch[5])
    planned = plan_motion(room(*homes), Motion(scheme="reactive"), targets)
    assert np.abs(np.degrees(planned.joints[1]) - np.hstack(homes)).max() < 15
