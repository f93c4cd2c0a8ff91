"""Forbidden zones: bodies that the arms keep clear of, and nothing else."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import trimesh

from twinct.core.errors import ScenarioError
from twinct.geometry import Pose
from twinct.robots.cell import Clearance, apart, build_cell
from twinct.scenario import Cell, Detector, load_scenario, stage_digests

BASE = {
    "trajectory": {"kind": "arc", "views": 3},
    "specimen": {
        "parts": [{"shape": {"kind": "sphere", "radius_mm": 50, "mesh_resolution_mm": 4}}]
    },
}
SHAPES = {
    "box": {"kind": "box", "size_mm": [100, 200, 300]},
    "sphere": {"kind": "sphere", "radius_mm": 100},
    "cylinder": {"kind": "cylinder", "radius_mm": 60, "height_mm": 400},
    "capsule": {"kind": "capsule", "radius_mm": 60, "length_mm": 400},
}


def cell_with(**zones: dict[str, object]) -> Cell:
    listed = [{"name": name, **zone} for name, zone in zones.items()]
    cell = load_scenario({**BASE, "cell": {"zones": listed}}).cell
    assert isinstance(cell, Cell)
    return cell


@pytest.mark.parametrize(
    ("kind", "half"),
    [
        ("box", (50, 100, 150)),
        ("sphere", (100,) * 3),
        ("cylinder", (60, 60, 200)),
        ("capsule", (60, 60, 260)),
    ],
)
def test_a_zone_is_where_it_is_told(
    head: trimesh.Trimesh, kind: str, half: tuple[int, ...]
) -> None:
    zone = {"shape": SHAPES[kind], "position_mm": [0, 900, 100], "rotation_deg": [0, 0, 90]}
    built = build_cell(cell_with(nurse=zone), head, Pose.identity(), Detector().panel)
    data = mujoco.MjData(built.model)
    mujoco.mj_kinematics(built.model, data)
    geom = built.model.geom("zone_0").id
    assert data.geom_xpos[geom] * 1000 == pytest.approx([0, 900, 100])
    assert built.model.geom_aabb[geom, 3:] * 1000 == pytest.approx(half)
    turned = data.geom_xmat[geom].reshape(3, 3)
    assert turned[:, 0] == pytest.approx([0, 1, 0], abs=1e-9)
    assert 0 < built.model.geom_rgba[geom, 3] < 0.5


def test_clearance_counts_zones(head: trimesh.Trimesh) -> None:
    # All joints at zero: the arms are stretched out sideways.
    beside_the_base = {"shape": SHAPES["sphere"], "position_mm": [1150, 0, 50]}
    gaps = [
        Clearance(build_cell(cell, head, Pose.identity(), Detector().panel)).over(np.zeros((1, 12)))
        for cell in (Cell(), cell_with(nurse=beside_the_base))
    ]
    assert "zone nurse" in gaps[1].bodies
    assert gaps[1].distance_mm < gaps[0].distance_mm


def test_a_zone_that_covers_the_specimen_is_refused(head: trimesh.Trimesh) -> None:
    cell = cell_with(
        nurse={"shape": SHAPES["sphere"], "position_mm": [0, 900, 0]},
        shoulder={"shape": SHAPES["box"], "position_mm": [0, 0, -200]},
    )
    with pytest.raises(ScenarioError, match=r"cell.zones.1: zone 'shoulder' reaches 60.0 mm into"):
        apart(build_cell(cell, head, Pose.identity(), Detector().panel))


def test_names_are_unique() -> None:
    zone = {"name": "nurse", "shape": SHAPES["sphere"], "position_mm": [0, 900, 0]}
    with pytest.raises(ScenarioError, match="nurse: two zones have the same name"):
        load_scenario({**BASE, "cell": {"zones": [zone, zone]}})


def test_zones_count_for_the_plan() -> None:
    zone = {"name": "nurse", "shape": SHAPES["sphere"], "position_mm": [0, 900, 0]}
    before, none, one = (
        stage_digests(
            load_scenario({**BASE, "cell": {"zones": zones}} if zones is not None else BASE)
        )
        for zones in (None, [], [zone])
    )
    assert before == none
    assert before["plan"] != one["plan"]
    assert before["surface"] == one["surface"]
