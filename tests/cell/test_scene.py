"""What stands in the room, and what may touch what."""

from __future__ import annotations

import errno
from pathlib import Path
from unittest.mock import Mock

import mujoco
import numpy as np
import pytest
import trimesh
from coal_distances import COAL_M, CoalDistances

from twinct.core.errors import InputError, MemoryShortageError, ScenarioError, StorageError
from twinct.geometry import Pose
from twinct.robots.cell import (
    CellModel,
    Clearance,
    build_cell,
    build_gantry,
    paint_specimen,
    render_cell,
    whole_camera,
)
from twinct.robots.cell.render import _add_names, _corners, _shown
from twinct.robots.cell.scene import _compile
from twinct.robots.cell.solids import VISUAL_GROUP
from twinct.scenario import Cell, Detector, GantryCell
from twinct.specimen.colours import BONE, METAL, PLASTIC, SKIN, WATER, colour_of
from twinct.specimen.materials import material

ROUNDING_M = 1e-6
"""GJK's own tolerance, with room."""


def body_pairs(cell: CellModel) -> set[frozenset[str]]:
    return {frozenset(cell.body_of_geom(int(g)) for g in pair) for pair in cell.pairs}


def test_tools_weigh_what_the_scenario_says(cell: CellModel) -> None:
    assert cell.model.body("source").mass[0] == pytest.approx(8.0)
    assert cell.model.body("detector").mass[0] == pytest.approx(4.0)


def test_tool_sites_lie_the_standoff_from_the_flange(head: trimesh.Trimesh) -> None:
    section = Cell.model_validate(
        {"source_arm": {"standoff_mm": 180}, "detector_arm": {"standoff_mm": 120}}
    )
    model = build_cell(section, head, Pose.identity(), Detector().panel).model
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for side, standoff in (("source", 0.180), ("detector", 0.120)):
        flange, site = model.site(f"{side}_flange").id, model.site(side).id
        axis = data.site_xmat[flange].reshape(3, 3)[:, 2]
        np.testing.assert_allclose(
            data.site_xpos[site] - data.site_xpos[flange], standoff * axis, atol=1e-12
        )


def test_panel_housing_follows_the_panel(cell: CellModel) -> None:
    np.testing.assert_allclose(cell.model.geom("detector_panel").size * 2, [0.34, 0.26, 0.024])


def test_holder_ends_at_the_specimens_lowest_point(head: trimesh.Trimesh) -> None:
    world_from_specimen = Pose.from_euler((20, -10, 30), (90, 0, 0))
    cell = build_cell(Cell(), head, world_from_specimen, Detector().panel)
    data = mujoco.MjData(cell.model)
    mujoco.mj_kinematics(cell.model, data)
    post = cell.model.geom("holder_post")
    top = data.geom_xpos[post.id][2] + post.size[1]
    lowest = world_from_specimen.apply(head.vertices)[:, 2].min() / 1000
    assert top == pytest.approx(lowest, abs=1e-9)


def test_pairs_are_those_of_bodies_that_are_not_adjacent(cell: CellModel) -> None:
    pairs = body_pairs(cell)
    for first, second in (
        ("detector", "table"),
        ("detector", "specimen"),
        ("detector", "source"),
        ("source", "holder"),
        ("detector", "floor"),
        ("detector", "detector_forearm"),
        ("detector_wrist_1", "detector_wrist_3"),
        ("source_forearm", "detector_forearm"),
    ):
        assert frozenset((first, second)) in pairs
    for first, second in (
        ("detector", "detector_wrist_3"),  # bolted together
        ("detector", "detector_wrist_2"),  # the tool is part of the last link
        ("source_base", "source_shoulder"),
        ("source_upper_arm", "source_forearm"),
        ("table", "floor"),  # neither can move
        ("table", "specimen"),
    ):
        assert frozenset((first, second)) not in pairs


def test_bounds_lie_below_and_the_smallest_distance_is_the_smallest(cell: CellModel) -> None:
    rng = np.random.default_rng(3)
    data = mujoco.MjData(cell.model)
    clearance, referee = Clearance(cell), CoalDistances(cell.model)
    for _ in range(8):
        data.qpos[:] = rng.uniform(-2, 2, cell.model.nq)
        mujoco.mj_kinematics(cell.model, data)
        exact = np.array([referee.between(data, int(a), int(b)) for a, b in cell.pairs])
        bounds = clearance.lower_bounds(data)
        apart = exact > 0  # of shapes that overlap, both tell the depth in their own way
        assert (bounds[apart] <= exact[apart] + COAL_M).all()
        assert bounds.max() > 0.5  # they do tell far from near
        smallest = clearance.at(data).distance_mm / 1000
        assert smallest == pytest.approx(exact.min(), abs=COAL_M) or max(smallest, exact.min()) <= 0


def test_smallest_distance_over_a_motion_is_that_of_every_instant(cell: CellModel) -> None:
    rng = np.random.default_rng(4)
    data = mujoco.MjData(cell.model)
    clearance = Clearance(cell)
    interior = 0
    for _ in range(5):
        time = np.linspace(0, 1, 120)[:, None]
        start, speed, turn = rng.uniform(-1, 1, (3, cell.model.nq)) * [[2], [0.4], [0.4]]
        joints = start + speed * time + turn * np.sin(3 * time)
        each = []
        for q in joints:
            data.qpos[:] = q
            mujoco.mj_kinematics(cell.model, data)
            each.append(clearance.at(data).distance_mm)
        interior += 0 < int(np.argmin(each)) < len(each) - 1
        assert clearance.over(joints).distance_mm == pytest.approx(min(each), abs=2e-3)
    assert interior  # not only at the ends, where it looks first


@pytest.mark.parametrize("room", ["plain", "operating"])
@pytest.mark.parametrize(("aside", "held"), [(100, True), (800, False)])
def test_a_specimen_beside_the_table_has_no_post(
    head: trimesh.Trimesh, room: str, aside: float, held: bool
) -> None:
    data = {"room": room, "table": {"moved_mm": [aside, 0]}}
    cell = build_cell(Cell.model_validate(data), head, Pose.identity(), Detector().panel)
    names = {cell.model.body(k).name for k in range(cell.model.nbody)}
    assert ("holder" in names) == held
    if room == "plain":
        assert cell.model.geom("table_top").pos[0] == pytest.approx(aside / 1000)


@pytest.mark.parametrize(
    ("section", "message"),
    [
        ({"table": {"top_z_mm": -50}}, "table.top_z_mm = -50 mm reaches into the specimen"),
        ({"table": {"top_z_mm": -1190}}, "lies in the floor"),
        ({"detector_arm": {"standoff_mm": 30}}, "standoff_mm = 30 mm leaves no room"),
    ],
)
def test_what_cannot_be_built_is_named(
    head: trimesh.Trimesh, section: dict[str, object], message: str
) -> None:
    with pytest.raises(ScenarioError, match=message):
        build_cell(Cell.model_validate(section), head, Pose.identity(), Detector().panel)


def test_render_writes_a_picture(cell: CellModel, tmp_path: Path) -> None:
    from PIL import Image

    path = tmp_path / "cell.png"
    render_cell(cell, path, np.zeros(12), width=160, height=100)
    pixels = np.asarray(Image.open(path))
    assert pixels.shape == (100, 160, 3)
    assert pixels.std() > 20


def test_a_gantry_holds_source_and_panel_at_the_poses(
    head: trimesh.Trimesh, tmp_path: Path
) -> None:
    poses = [
        Pose.from_euler((300, -20, 10), (5, -90, 0)),
        Pose.from_euler((-250, 0, 40), (9, 80, 7)),
    ]
    room = build_gantry(GantryCell(kind="gantry"), head, Pose.identity(), Detector().panel, *poses)
    data = mujoco.MjData(room.model)
    mujoco.mj_kinematics(room.model, data)
    for side, pose in zip(("source", "detector"), poses, strict=True):
        site = room.model.site(side).id
        np.testing.assert_allclose(data.site_xpos[site] * 1000, pose.position, atol=1e-9)
        np.testing.assert_allclose(data.site_xmat[site].reshape(3, 3), pose.rotation, atol=1e-12)
    render_cell(room, tmp_path / "gantry.png", width=160, height=100)
    assert room.model.stat.extent == pytest.approx(poses[0].distance_mm(poses[1]) / 1000 + 0.2)


def test_a_picture_on_a_full_disk_is_told(
    cell: CellModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    pixels = np.zeros((2, 2, 3), np.uint8)
    monkeypatch.setattr("twinct.robots.cell.render.room_pictures", lambda *_: iter([pixels]))
    monkeypatch.setattr("PIL.Image.Image.save", full)
    with pytest.raises(StorageError, match=r"room\.png: the disk is full"):
        render_cell(cell, tmp_path / "room.png")


def test_drawing_that_fails_with_little_memory_tells_of_it(
    cell: CellModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mujoco.Renderer", Mock(side_effect=RuntimeError("no EGL device")))
    for left, told in (
        (3 * 2**28, r"only 0\.75 GiB of memory are left, by the limit"),
        (2**33, ""),
    ):
        monkeypatch.setattr("twinct.core.memory.available_bytes", lambda left=left: (left, "limit"))
        with pytest.raises(InputError, match=f"cannot draw.*no EGL device.*{told}$"):
            render_cell(cell, tmp_path / "room.png")


def test_pictures_name_what_one_sees_through() -> None:
    spec = mujoco.MjSpec()
    for name, opacity in (("zone Überwachung", 0.28), ("object bed", 1.0), ("object place", 0.1)):
        body = spec.worldbody.add_body(name=name)
        sphere = mujoco.mjtGeom.mjGEOM_SPHERE
        body.add_geom(type=sphere, size=[0.1, 0, 0], rgba=[1, 0, 0, opacity], group=VISUAL_GROUP)
    model = spec.compile()
    scene = mujoco.MjvScene(model, maxgeom=10)
    _add_names(scene, model, mujoco.MjData(model))
    assert [scene.geoms[i].label for i in range(scene.ngeom)] == ["Uberwachung", "place"]


def test_a_model_is_not_compiled_with_little_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """MuJoCo's compiler may free twice what it could not allocate, which ends the process."""
    monkeypatch.setattr("twinct.core.files.boundary.available_bytes", lambda: (2**27, "limit"))
    with pytest.raises(MemoryShortageError, match=r"model of the room needs 0\.188 GiB"):
        _compile(Mock())


def test_a_camera_knows_how_much_of_the_panel_other_bodies_hide(head: trimesh.Trimesh) -> None:
    towards = [Pose.from_euler([x, 0, 0], [0, turn, 0]) for x, turn in ((-300, 90), (200, -90))]
    cell = GantryCell(kind="gantry")
    room = build_gantry(cell, head, Pose.identity(), Detector().panel, *towards)
    data = mujoco.MjData(room.model)
    mujoco.mj_forward(room.model, data)
    eyes = [(-1.0, 0.0, 0.0), (0.5, -2.0, 0.5)]  # behind source and head, and beside them
    behind, beside = (_shown(room.model, data, "detector", np.array(eye)) for eye in eyes)
    assert behind < 0.8
    assert beside == 1


@pytest.mark.parametrize("base_z_mm", [0, 1400])
def test_a_picture_shows_arms_of_any_height(head: trimesh.Trimesh, base_z_mm: float) -> None:
    base = {"base_position_mm": [850, 0, base_z_mm], "base_rotation_deg": [180, 0, 0]}
    section = Cell.model_validate({"source_arm": base if base_z_mm else {}})
    room = build_cell(section, head, Pose.identity(), Detector().panel)
    joints = np.tile(np.radians([0, -120, 120, 0, 90, 0]), 2)
    aspect, camera = 1.6, whole_camera(room, joints, 1.6)
    data = mujoco.MjData(room.model)
    data.qpos[:] = joints
    mujoco.mj_forward(room.model, data)
    a, e = np.radians([camera.azimuth, camera.elevation])
    forward = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    right = np.cross(forward, [0, 0, 1]) / np.cos(e)
    seen = _corners(room.model, data) - (camera.lookat - camera.distance * forward)
    half = np.tan(np.radians(room.model.vis.global_.fovy) / 2) * (seen @ forward)
    assert np.all(abs(seen @ right) < aspect * half)
    assert np.all(abs(seen @ np.cross(right, forward)) < half)


def test_the_specimen_has_the_colour_of_its_material(head: trimesh.Trimesh) -> None:
    names = "bone", "aluminium", "soft_tissue", "water", "pmma", "Bone, Cortical (ICRP)"
    colours = [colour_of(material(name)) for name in names]
    assert colours == [BONE, METAL, SKIN, WATER, PLASTIC, BONE]
    room = build_cell(Cell(), head, Pose.identity(), Detector().panel)
    paint_specimen(room, METAL)
    drawn = room.model.geom_matid[room.model.geom("specimen_look").id]
    assert room.model.mat_rgba[drawn][:3].tolist() == pytest.approx(METAL)
