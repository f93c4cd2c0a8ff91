"""Objects of the room: where they stand, what the arms keep from them, and bad input by name."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh

from twinct.core.errors import InputError, ScenarioError
from twinct.geometry import Pose
from twinct.robots.cell import BodyPlaces, CellModel, Clearance, apart, build_cell, overlaps
from twinct.robots.motion.collision_check import CollisionCheck
from twinct.robots.motion.feasible import Feasible
from twinct.runs.checks import check_sight
from twinct.scan import SimulationBuilder
from twinct.scenario import Cell, Detector, Scenario, load_scenario, stage_digests

BASE = {
    "trajectory": {"kind": "arc", "views": 3},
    "specimen": {
        "parts": [{"shape": {"kind": "sphere", "radius_mm": 50, "mesh_resolution_mm": 4}}]
    },
}
SPHERE = {"kind": "sphere", "radius_mm": 100}


def box(name: str = "monitor", **more: object) -> dict[str, object]:
    return {"name": name, "shape": {"kind": "box", "size_mm": [200, 200, 200]}, **more}


def cell_with(head: trimesh.Trimesh, *objects: dict[str, object], **more: object) -> CellModel:
    section = Cell.model_validate({"objects": objects, **more})
    return build_cell(section, head, Pose.identity(), Detector().panel)


@pytest.mark.parametrize(
    ("shape", "half"),
    [
        ({"kind": "box", "size_mm": [100, 200, 300]}, (50, 100, 150)),
        (SPHERE, (100,) * 3),
        ({"kind": "cylinder", "radius_mm": 60, "height_mm": 400}, (60, 60, 200)),
        ({"kind": "capsule", "radius_mm": 60, "length_mm": 400}, (60, 60, 260)),
    ],
)
def test_an_object_is_where_it_is_told(
    head: trimesh.Trimesh, shape: dict[str, object], half: tuple[int, ...]
) -> None:
    standing = {"position_mm": [0, 900, 100], "rotation_deg": [0, 0, 90], "colour": "#ff000080"}
    model = cell_with(head, {"name": "lamp", "shape": shape, **standing}).model
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    geom = model.geom("object_0").id
    assert data.geom_xpos[geom] * 1000 == pytest.approx([0, 900, 100])
    assert model.geom_aabb[geom, 3:] * 1000 == pytest.approx(half)
    assert data.geom_xmat[geom].reshape(3, 3)[:, 0] == pytest.approx([0, 1, 0], abs=1e-9)
    assert model.geom_rgba[geom] == pytest.approx((1, 0, 0, 128 / 255), abs=1e-6)


def two_balls(path: Path, radius: float = 60.0) -> Path:
    """A file of two balls, 400 mm apart along x."""
    balls = [
        trimesh.creation.icosphere(2, radius).apply_translation((x, 0, 0)) for x in (-200, 200)
    ]
    trimesh.util.concatenate(balls).export(path)
    return path


def test_each_piece_of_a_mesh_is_an_obstacle_and_the_gap_between_is_free(
    head: trimesh.Trimesh, tmp_path: Path
) -> None:
    shape = {"kind": "mesh", "path": str(two_balls(tmp_path / "balls.stl"))}
    stand = {"name": "stand", "shape": shape, "position_mm": [0, 900, 0]}
    cell = cell_with(head, stand)
    places = BodyPlaces(cell)
    body = places.names.index("object stand")
    assert len(places.seen(body)) == 1  # the whole mesh; its hulls are invisible
    assert not overlaps(cell_with(head, stand, zones=[_zone(0, 900, 0)]))
    hit = overlaps(cell_with(head, stand, zones=[_zone(200, 900, 0)]))
    assert [o.second.name for o in hit] == ["object 'stand'"]


def test_arms_stand_within_the_walls_of_a_room_that_is_one_mesh(
    head: trimesh.Trimesh, tmp_path: Path
) -> None:
    """One convex hull of the walls would hold both arms, the table and the specimen."""
    outside = trimesh.creation.box((5000, 5000, 2600))
    walls = trimesh.boolean.difference([outside, trimesh.creation.box((4800, 4800, 2700))])
    walls.export(file := tmp_path / "walls.stl")
    shape = {"kind": "mesh", "path": str(file)}
    room = {"name": "walls", "shape": shape, "position_mm": [0, 0, 100]}
    assert not overlaps(cell_with(head, room))
    found = overlaps(cell_with(head, room, box("shelf", group="staff", position_mm=[2400, 0, 100])))
    assert [(o.first.name, o.second.name) for o in found] == [("object 'shelf'", "object 'walls'")]


def _zone(*at: float) -> dict[str, object]:
    return {
        "name": "z",
        "shape": {"kind": "sphere", "radius_mm": 60},
        "position_mm": at,
    }


def test_fixed_bodies_and_objects_must_stand_apart_unless_of_one_group(
    head: trimesh.Trimesh,
) -> None:
    at = {"position_mm": [0, 900, -800]}
    together = [box("rack", **at), box("screen", **at)]
    assert not overlaps(cell_with(head, *together))
    found = overlaps(cell_with(head, together[0], box("nurse", group="staff", **at)))
    assert {o.first.key for o in found} == {"cell.objects.1"}
    wrong = cell_with(
        head, box("on the pillar", position_mm=[750, 0, -600]), box("bone", position_mm=[0, 0, 0])
    )
    with pytest.raises(ScenarioError, match="object 'on the pillar' reaches .* the source arm's"):
        apart(wrong)
    with pytest.raises(ScenarioError, match=r"cell.objects.1: object 'bone' reaches .* specimen"):
        apart(wrong)
    apart(cell_with(head, box("smoke", position_mm=[0, 0, 0], collides=False)))


def test_the_arms_keep_the_gap_of_an_objects_group(head: trimesh.Trimesh) -> None:
    near = box(position_mm=[750, 350, 0], group="staff")
    plain = cell_with(head, near)
    wide = cell_with(head, near, group_clearance_mm={"staff": 60, "patient": 500})
    joints = _home(plain)
    gaps = [_gap(cell, joints) for cell in (plain, wide)]
    assert gaps[0] - gaps[1] == pytest.approx(60, abs=1e-6)
    least = gaps[0] - 3  # kept without the group's gap, and not with it
    assert [_verdicts(cell, joints, least) for cell in (plain, wide)] == [
        (True, True, True),
        (False, False, False),
    ]
    assert _verdicts(wide, joints, gaps[1] - 1) == (True, True, True)


def _home(cell: CellModel) -> np.ndarray:
    """Arms at a pose whose smallest distance is that to the object."""
    rng, best, joints = np.random.default_rng(0), np.inf, np.zeros(len(cell.joint_names))
    clearance, data = Clearance(cell), mujoco.MjData(cell.model)
    for trial in rng.uniform(-2, 2, (400, len(joints))):
        data.qpos[:] = trial
        mujoco.mj_kinematics(cell.model, data)
        gap = clearance.at(data)
        if "object monitor" in gap.bodies and 5 < gap.distance_mm < best:
            best, joints = gap.distance_mm, trial
    assert np.isfinite(best)
    return joints


def _gap(cell: CellModel, joints: np.ndarray) -> float:
    return Clearance(cell).over(joints[None]).distance_mm


def _verdicts(cell: CellModel, joints: np.ndarray, least_mm: float) -> tuple[bool, bool, bool]:
    quick = CollisionCheck(cell)
    quick.keep(least_mm)
    room = Feasible(cell)
    return (
        quick.clear(joints),
        bool(room.clear(joints[None], least_mm)[0]),
        bool(room.straight(joints[None], joints[None] + 1e-6, least_mm)[0]),
    )


def scenario_with(*objects: dict[str, object], **more: object) -> Scenario:
    return load_scenario({**BASE, "cell": {"objects": list(objects), **more}})


def test_bad_input_is_named(tmp_path: Path) -> None:
    for objects, told in [
        ([box(), box()], r"cell: monitor: two objects have the same name"),
        ([box(shape={"kind": "box", "size_mm": [1, -2, 3]})], r"objects\.0\.shape.*size_mm"),
        ([box(shape={"kind": "box", "size_mm": [1, 0, 3]})], r"objects\.0\.shape.*size_mm"),
        ([box(colour="red")], r"cell\.objects\.0\.colour"),
        ([box(group="visitors")], r"cell\.objects\.0\.group.*patient"),
        ([{"name": "", "shape": SPHERE}], r"cell\.objects\.0\.name"),
        ([box(shape={"kind": "mesh", "path": "/no/such.stl"})], r"/no/such\.stl"),
    ]:
        with pytest.raises(ScenarioError, match=told):
            scenario_with(*objects)


def built(*objects: dict[str, object]) -> SimulationBuilder:
    return SimulationBuilder(scenario_with(*objects))


def test_check_names_an_unknown_material() -> None:
    with pytest.raises(InputError, match=r"cell\.objects\.0\.material.*carbn"):
        check_sight(built(box("plate", material="carbn", position_mm=[0, 900, 0])))


def test_an_unknown_material_and_a_mesh_in_metres_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"cell\.objects\.1\.material.*carbn") as refused:
        _ = built(box(), box("plate", material="carbn")).beam_objects
    assert len(refused.value.problems) == 1
    path = tmp_path / "stand.stl"
    trimesh.creation.box((1.2, 0.5, 0.3)).export(path)
    metres = box("stand", shape={"kind": "mesh", "path": str(path)})
    with pytest.raises(InputError, match=r"objects\.0: object 'stand'.*unit_mm: 1000"):
        _ = built(metres).cell
    opened = trimesh.creation.box((500, 500, 500))
    opened.update_faces(np.arange(len(opened.faces) - 1))
    opened.export(path)
    with pytest.raises(InputError, match=r"object 'stand'"):
        _ = built(metres).cell


def test_colours_change_no_digest_and_places_do() -> None:
    first = stage_digests(scenario_with(box(position_mm=[0, 900, 0])))
    red = stage_digests(scenario_with(box(position_mm=[0, 900, 0], colour="#ff0000")))
    moved = stage_digests(scenario_with(box(position_mm=[0, 901, 0])))
    seen = stage_digests(scenario_with(box(position_mm=[0, 900, 0], material="lead")))
    assert first == red
    assert first["plan"] != moved["plan"]
    assert first["plan"] == seen["plan"]
    assert first["images"] != seen["images"]
