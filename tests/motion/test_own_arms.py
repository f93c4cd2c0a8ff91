"""An arm from a URDF file plans and moves like any other."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from twinct.core.errors import TrajectoryError
from twinct.geometry import Pose
from twinct.geometry.wire import PosePairs, targets_of
from twinct.robots.cell import CellModel, build_cell
from twinct.robots.motion import RobotSimulation, TimeLaw, plan_motion
from twinct.robots.motion.strength import TORQUE_SHARE, Strength
from twinct.scenario import Cell, Detector, Motion
from twinct.trajectory import ArcTrajectory, commanded_views

URDF = Path(__file__).parents[1] / "cell" / "six_axis.urdf"
BRANCHES = ((-30, 45, 150, -30, -100, -90), (-150, -45, -150, 30, 100, 90))
"""Two ways of the source arm to hold the middle view, as rough as by hand, deg."""


def room(*homes: tuple[float, ...] | None, **keys: object) -> CellModel:
    arm = {"file": URDF, "base": "base_link", **keys}
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


@pytest.mark.parametrize("branch", BRANCHES)
def test_the_search_begins_at_home(
    targets: list[PosePairs], branch: tuple[float, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("twinct.robots.motion.follow.RESTARTS", 1)
    homes = branch, (*branch[:5], -branch[5])
    planned = plan_motion(room(*homes), Motion(scheme="reactive"), targets)
    assert np.abs(np.degrees(planned.joints[1]) - np.hstack(homes)).max() < 15


def test_a_light_configuration_is_chosen_where_the_shortest_way_is_too_heavy() -> None:
    """On rails the least motion stretches the arms so far that a shoulder cannot hold them."""
    arc = ArcTrajectory(kind="arc", views=12, longitude_range_deg=60)
    wide = targets_of(commanded_views(arc, Detector().panel))
    cell = room(None, None, tool_mass_kg=22.0, rail={"range_mm": [-600, 600]})
    found = plan_motion(cell, Motion(), wide)
    assert Strength(cell).holding(found.joints).max() < TORQUE_SHARE
    laws = TimeLaw(cell, Motion()).shares(found.at(np.linspace(0, found.duration_s, 200)))
    assert laws["torque"].max() < 1.01
    heavy = room(None, None, tool_mass_kg=60.0, rail={"range_mm": [-600, 600]})
    told = "views 0 to 11: source arm: in each .* source_shoulder needs 1.. % of its torque limit"
    with pytest.raises(TrajectoryError, match=told) as caught:
        plan_motion(heavy, Motion(), wide)
    assert not caught.value.views, "they are within reach"
