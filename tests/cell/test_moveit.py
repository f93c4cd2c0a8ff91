"""A cell written for MoveIt, read again by the rules of its public definitions."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh
import yaml

from twinct.geometry import Pose
from twinct.robots.cell import CellModel, build_cell
from twinct.robots.cell.moveit import moveit_files, room_bodies
from twinct.robots.cell.urdf import link_names
from twinct.scenario import Cell, Detector

CELL = {
    "detector_arm": {"rail": {"range_mm": [-500, 500]}},
    "zones": [
        {
            **{"name": "nurse", "position_mm": [200, 900, -350], "rotation_deg": [0, 30, 0]},
            "shape": {"kind": "capsule", "radius_mm": 200, "length_mm": 1300},
        }
    ],
    "objects": [
        {
            **{"name": "screen", "group": "staff", "position_mm": [0, 1500, 0]},
            "shape": {"kind": "box", "size_mm": [500, 100, 400]},
        },
        {
            **{"name": "picture", "collides": False, "position_mm": [0, -1500, 0]},
            "shape": {"kind": "sphere", "radius_mm": 50},
        },
    ],
    "group_clearance_mm": {"staff": 150},
}


@pytest.fixture(scope="module")
def cell() -> CellModel:
    head = trimesh.creation.icosphere(radius=80, subdivisions=2)
    return build_cell(Cell.model_validate(CELL), head, Pose.identity(), Detector().panel)


@pytest.fixture(scope="module")
def files(cell: CellModel, tmp_path_factory) -> dict[str, str]:
    return moveit_files(cell, Pose.identity(), tmp_path_factory.mktemp("meshes"))


def objects(text: str) -> Iterator[tuple[str, list[tuple[str, list[float], np.ndarray]]]]:
    """Read a scene as moveit_core does: name, and kind, sizes and world pose of each shape."""
    lines = iter(text.splitlines())
    next(lines)  # the scene's name

    def numbers() -> list[float]:
        return [float(word) for word in next(lines).split()]

    def pose() -> np.ndarray:
        position, quat = numbers(), numbers()
        assert np.linalg.norm(quat) == pytest.approx(1)
        return Pose(np.array(position), np.array(quat)).matrix

    while (line := next(lines)) != ".":
        assert line.startswith("* ")
        whole, shapes = pose(), []
        for _ in range(int(next(lines))):
            kind, sizes = next(lines), numbers()
            if kind == "mesh":
                sizes += [x for _ in range(int(sum(sizes))) for x in numbers()]
            shapes.append((kind, sizes, whole @ pose()))
            assert len(numbers()) == 4  # colour
        assert next(lines) == "0"  # frames
        yield line[2:], shapes
    assert not list(lines)


def test_the_room_is_the_scene_and_the_arms_are_the_robot(
    cell: CellModel, files: dict[str, str]
) -> None:
    found = dict(objects(files["room.scene"]))
    names = link_names(cell)
    assert set(found) == {"floor", "table", "holder", "specimen", "zone_nurse", "object_screen"}
    robot = ElementTree.fromstring(files["arms.urdf"])
    links = {link.get("name") for link in robot.findall("link")}
    room = {names[body] for body in room_bodies(cell)}
    assert not links & room
    assert links >= set(names) - room
    parents = {joint.find("parent").get("link") for joint in robot.findall("joint")}  # type: ignore[union-attr]
    assert parents <= links
    ((_, size, place),) = found["object_screen"]
    assert size == pytest.approx([0.8, 0.4, 0.7])  # with 150 mm on each side
    assert place[:3, 3] == pytest.approx([0, 1.5, 0])
    tube, *ends = found["zone_nurse"]
    assert (tube[0], [kind for kind, _, _ in ends]) == ("cylinder", ["sphere", "sphere"])
    axis = Pose.from_euler((0, 0, 0), (0, 30, 0)).rotation[:, 2]
    apart = ends[1][2][:3, 3] - ends[0][2][:3, 3]
    assert apart == pytest.approx(tube[1][1] * axis)
    ((kind, mesh, _),) = found["specimen"]
    corners, faces = map(int, mesh[:2])
    points = np.reshape(mesh[2 : 2 + 3 * corners], (-1, 3))
    assert kind == "mesh"
    assert np.linalg.norm(points, axis=1) == pytest.approx(np.full(corners, 0.08), rel=1e-6)
    assert faces == 2 * corners - 4


def test_groups_and_pairs_are_those_of_the_plans(cell: CellModel, files: dict[str, str]) -> None:
    robot, names = ElementTree.fromstring(files["arms.srdf"]), link_names(cell)
    groups = {group.get("name"): group for group in robot.findall("group")}
    assert list(groups) == ["source_arm", "detector_arm", "both_arms"]
    chain = groups["detector_arm"].find("chain")
    assert chain is not None
    assert chain.attrib == {"base_link": "world", "tip_link": "detector"}
    off = {
        frozenset((pair.get("link1"), pair.get("link2"))): pair.get("reason")
        for pair in robot.findall("disable_collisions")
    }
    model, room = cell.model, room_bodies(cell)
    judged = {
        frozenset(names[body] for body in pair) for pair in model.geom_bodyid[cell.pairs].tolist()
    }
    assert not set(off) & judged
    solid = (model.geom_contype | model.geom_conaffinity) != 0
    arms = sorted({names[body] for body in set(model.geom_bodyid[solid].tolist()) - room})
    assert {frozenset(pair) for pair in combinations(arms, 2)} == set(off) | {
        pair for pair in judged if pair <= set(arms)
    }
    assert off[frozenset(("source_shoulder", "source_upper_arm"))] == "Adjacent"
    assert off[frozenset(("source_base", "source_pedestal"))] == "Adjacent"
    assert off[frozenset(("source_base", "detector_track"))] == "Never"
    limits = yaml.safe_load(files["joint_limits.yaml"])["joint_limits"]
    assert list(limits) == list(cell.joint_names)
    speeds = [limits[name]["max_velocity"] for name in cell.joint_names]
    assert speeds == (cell.speed_limits * cell.speed_scales).tolist()


def test_the_command_writes_the_files(tmp_path: Path) -> None:
    from twinct.cli import run_command

    scenario = Path(__file__).parents[2] / "scenarios" / "demo.yaml"
    ball = "specimen.parts=[{shape: {kind: sphere, radius_mm: 60}}]"
    out = tmp_path / "new" / "folder"
    words = ["urdf", str(scenario), "--moveit", "--out", str(out), "--set", ball]
    assert run_command(words) == 0
    names = {path.name for path in out.iterdir() if path.suffix != ".stl"}
    assert names == {"arms.urdf", "arms.srdf", "joint_limits.yaml", "room.scene"}
