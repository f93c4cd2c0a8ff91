"""A gantry keeps away from the objects of its room, at its views and between them."""

from __future__ import annotations

import numpy as np
import pytest

from twinct.core.errors import TrajectoryError
from twinct.geometry import Pose
from twinct.robots.cell import GantryClearance
from twinct.runs.checks import check_physics, findings
from twinct.scan import SimulationBuilder
from twinct.scenario import Detector, GantryCell, Scenario, parse_scenario

BALL_MM = 40.0


def scenario(*objects: dict[str, object], views: int = 8) -> Scenario:
    return parse_scenario(
        {
            "trajectory": {"kind": "circle", "views": views},
            "cell": {"kind": "gantry", "objects": objects},
            "specimen": {"parts": [{"shape": {"kind": "sphere", "radius_mm": 20}}]},
        }
    )


def ball(*at: float, **more: object) -> dict[str, object]:
    shape = {"kind": "sphere", "radius_mm": BALL_MM}
    return {"name": "lamp", "shape": shape, "position_mm": at, **more}


def test_a_way_through_an_object_is_refused_with_its_views() -> None:
    builder = SimulationBuilder(scenario(ball(0, 350, 0)))
    with pytest.raises(TrajectoryError, match=r"object lamp .*motion.clearance_mm = 10 mm") as hit:
        check_physics(builder)
    # Of 8 views, source and panel pass y = 350 mm at two, and the turns before and after reach it.
    assert set(hit.value.views) >= {2, 6} and len(hit.value.views) < 8
    assert "cell.objects" in str(hit.value)


@pytest.mark.parametrize(
    "objects", [(), (ball(0, 350, 0, collides=False),), (ball(0, 0, 700),)], ids=len
)
def test_free_ways_and_objects_that_do_not_collide_are_accepted(objects: tuple) -> None:
    builder = SimulationBuilder(scenario(*objects))
    check_physics(builder)
    told = findings(builder)
    assert ("smallest clearance" in told) == any(one.get("collides", True) for one in objects)


def test_an_object_between_two_views_is_found() -> None:
    """At 4 views, 90 deg apart, nothing is near a ball at 45 deg; the way meets it."""
    corner = 310 * np.cos(np.pi / 4)
    built = scenario(ball(corner, corner, 0), views=4)
    poses = [(source, panel) for source, panel, *_ in SimulationBuilder(built).commanded_poses]
    assert isinstance(built.cell, GantryCell)
    room = GantryClearance(built.cell, built.detector.panel, poses[0])
    assert min(room.at(pair).distance_mm for pair in poses) > 10
    assert min(gap.distance_mm for gap in room.over(poses, 10.0)) < 10
    with pytest.raises(TrajectoryError, match="on the way"):
        check_physics(SimulationBuilder(built))


def test_gaps_are_those_of_the_housings_at_any_pose() -> None:
    """The tube's front is a window 20 mm before the focal spot, on the axis towards the panel."""
    cell = GantryCell.model_validate({"kind": "gantry", "objects": [ball(0, 0, 0)]})
    rng, panel = np.random.default_rng(62), Detector().panel
    away = Pose.from_euler((0, 0, 5000), (0, 0, 0))
    room = GantryClearance(cell, panel, (away, away))
    for turn in rng.uniform(-180, 180, (5, 3)):
        source = Pose.from_euler((0, 0, 0), turn) @ Pose.from_euler((0, 0, -300), (0, 0, 0))
        gap = room.at((source, away))
        assert gap.bodies == ("source", "object lamp")
        assert gap.distance_mm == pytest.approx(300 - 20 - BALL_MM, abs=0.01)


def test_a_described_tool_collides_in_place_of_the_housing() -> None:
    """A mast, 300 mm tall, on the tube meets a ball above it that the usual housing misses."""
    mast = {"shape": {"kind": "box", "size_mm": [40, 600, 40]}, "position_mm": [0, 0, 50]}
    tool = {"parts": [mast], "tip_mm": [0, 0, 100]}
    lamp = ball(310, 0, 320)
    for keys, least in (({}, 100.0), ({"source_tool": tool}, -np.inf)):
        cell = {"kind": "gantry", "objects": [lamp], **keys}
        plain = scenario(lamp, views=4)
        built = plain.model_copy(update={"cell": GantryCell.model_validate(cell)})
        builder = SimulationBuilder(built)
        poses = [(source, panel) for source, panel, *_ in builder.commanded_poses]
        room = GantryClearance(built.cell, built.detector.panel, poses[0])
        gap = min(room.at(pair).distance_mm for pair in poses)
        assert gap > least and (least > 0 or gap < 10)
