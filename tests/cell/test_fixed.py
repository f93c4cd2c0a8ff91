"""Fixed bodies are judged against each other: refused by name where they overlap, else accepted."""

from __future__ import annotations

import pytest
import trimesh

from twinct.core.errors import ScenarioError
from twinct.geometry import Pose
from twinct.robots.cell import CellModel, apart, build_cell, overlaps
from twinct.scan import SimulationBuilder
from twinct.scenario import Cell, Detector, DetectorArm, SourceArm, load_scenario


def cell_with(head: trimesh.Trimesh, **parts: object) -> CellModel:
    return build_cell(Cell.model_validate(parts), head, Pose.identity(), Detector().panel)


def zone(name: str, *at: float) -> dict[str, object]:
    return {"name": name, "shape": {"kind": "sphere", "radius_mm": 100}, "position_mm": list(at)}


def test_a_base_inside_the_head_is_refused_by_name(head: trimesh.Trimesh) -> None:
    cell = cell_with(head, source_arm={"base_position_mm": [60, 0, 60]})
    with pytest.raises(ScenarioError) as refused:
        apart(cell)
    told = "\n".join(refused.value.problems)
    at = "cell.source_arm.base_position_mm = [60, 0, 60]"
    for piece, other in [("base", "the specimen"), ("pillar", "the table"), ("pillar", "holder")]:
        assert any(
            problem.startswith(at) and f"the source arm's {piece} reaches" in problem
            for problem in refused.value.problems
            if other in problem
        ), told


def test_two_arms_in_one_place_and_a_base_below_the_floor(head: trimesh.Trimesh) -> None:
    one = SourceArm(base_position_mm=(750.0, 0.0, -150.0))
    other = DetectorArm(base_position_mm=(750.0, 100.0, -150.0))
    cell = build_cell(
        Cell(source_arm=one, detector_arm=other), head, Pose.identity(), Detector().panel
    )
    pairs = {(o.first.name, o.second.name) for o in overlaps(cell)}
    assert ("the detector arm's pillar", "the source arm's pillar") in pairs
    sunk = cell_with(head, source_arm={"base_position_mm": [750, 0, -1300]})
    assert [(o.first.name, o.second.name) for o in overlaps(sunk)] == [
        ("the source arm's base", "the floor")
    ]


def test_zones_may_cross_each_other_and_the_floor_but_nothing_else(head: trimesh.Trimesh) -> None:
    fine = [zone("nurse", 0, 900, -1150), zone("doctor", 0, 950, -1150)]
    assert not overlaps(cell_with(head, zones=fine))
    wrong = cell_with(head, zones=[zone("nurse", 750, 0, -600), zone("belt", 0, 0, -500)])
    told = {(o.first.key, o.second.name) for o in overlaps(wrong)}
    assert told == {
        ("cell.zones.0", "the source arm's pillar"),
        ("cell.zones.1", "the table"),
        ("cell.zones.1", "the specimen's holder"),
    }


def test_bodies_that_touch_do_not_overlap(head: trimesh.Trimesh) -> None:
    touching = {"name": "shelf", "shape": {"kind": "box", "size_mm": [100, 100, 100]}}
    top = -450.0
    assert not overlaps(cell_with(head, zones=[touching | {"position_mm": [200, 0, top + 50]}]))
    assert overlaps(cell_with(head, zones=[touching | {"position_mm": [200, 0, top + 49]}]))


def test_a_scenario_with_such_a_base_cannot_be_planned() -> None:
    scenario = load_scenario(
        {
            "trajectory": {"kind": "arc", "views": 3},
            "specimen": {"parts": [{"shape": {"kind": "sphere", "radius_mm": 50}}]},
            "cell": {"source_arm": {"base_position_mm": [200, 0, -300]}},
        }
    )
    with pytest.raises(ScenarioError, match="the source arm's pillar reaches .* into the table"):
        _ = SimulationBuilder(scenario).plan
