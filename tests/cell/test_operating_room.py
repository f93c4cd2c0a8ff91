"""The operating room: made of objects, free of overlaps, and in the way of beam and arms."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from twinct.core.errors import ScenarioError
from twinct.geometry import Pose
from twinct.robots.cell import BodyPlaces, CellModel, build_cell, overlaps
from twinct.scenario import Cell, Detector, load_scenario
from twinct.specimen.room_bodies import beam_bodies


def room(head: trimesh.Trimesh, **more: object) -> CellModel:
    section = Cell.model_validate({"room": "operating", **more})
    return build_cell(section, head, Pose.identity(), Detector().panel)


@pytest.mark.parametrize("holder", [True, False])
def test_its_fixed_bodies_stand_apart(head: trimesh.Trimesh, holder: bool) -> None:
    """A head on a holder, and a head that lies on the mattress (its upper face at -450 mm)."""
    place = Pose.identity()
    if not holder:
        place = Pose(np.array([0, 0, -450 - float(head.bounds[0, 2]) + 5]), place.quat)
    section = Cell.model_validate({"room": "operating", "table": {"top_z_mm": -450}})
    cell = build_cell(section, head, place, Detector().panel)
    assert [o.words for o in overlaps(cell)] == []
    names = BodyPlaces(cell).names
    assert ("holder" in names, "table" in names) == (holder, False)
    expected = ("table plate", "mattress", "drape", "lamp left", "anaesthesia cart", "wall, back")
    assert {f"object {name}" for name in expected} <= set(names)


def test_what_stands_in_its_way_is_named(head: trimesh.Trimesh) -> None:
    far = room(head, source_arm={"base_position_mm": [-1750, -700, -150]})
    assert any("anaesthesia" in o.words for o in overlaps(far))
    post = {"name": "monitor post", "shape": NEAR}
    with pytest.raises(ScenarioError, match="monitor post: two objects"):
        load_scenario({**BASE, "cell": {"room": "operating", "objects": [post]}})
    with pytest.raises(ScenarioError, match="at least 450 mm above the floor"):
        load_scenario({**BASE, "cell": {"room": "operating", "table": {"top_z_mm": -800}}})


BASE = {
    "trajectory": {"kind": "arc", "views": 3},
    "specimen": {"parts": [{"shape": {"kind": "sphere", "radius_mm": 50}}]},
}


def test_the_beam_sees_plate_and_mattress_only() -> None:
    section = Cell.model_validate({"room": "operating"})
    bodies = {body.name: body for body in beam_bodies(section.keyed_objects)}
    assert set(bodies) == {"table plate", "mattress"}
    top = section.table.top_z_mm
    assert bodies["mattress"].mesh.bounds[1, 2] == pytest.approx(top)
    assert bodies["table plate"].mesh.bounds[0, 2] == pytest.approx(top - 40 - 50)


def test_a_body_beyond_all_reach_costs_no_distance(head: trimesh.Trimesh) -> None:
    far = {"name": "far", "shape": NEAR, "position_mm": [750, 5000, 0]}
    near = {"name": "near", "shape": NEAR, "position_mm": [750, 1400, 0]}
    cell = room(head, objects=[near, far])
    names = {cell.model.body(int(cell.model.geom_bodyid[geom])).name for geom in cell.pairs.ravel()}
    assert {"object near", "object mattress"} <= names
    assert "object far" not in names


def test_a_table_is_moved_with_all_its_parts() -> None:
    def tables(moved: list[float]) -> dict[str, tuple[float, ...]]:
        data = {"room": "operating", "table": {"top_z_mm": -450, "moved_mm": moved}}
        objects = Cell.model_validate(data).keyed_objects
        return {body.name: body.position_mm for _, body in objects}

    before, after = tables([0, 0]), tables([800, -50])
    parts = {name for name in before if before[name] != after[name]}
    assert parts == {name for name in before if name.startswith(("table", "mattress", "drape"))}
    for name in parts:
        shift = np.subtract(after[name], before[name])
        np.testing.assert_allclose(shift, (800, -50, 0), atol=1e-9)


NEAR = {"kind": "sphere", "radius_mm": 50}
