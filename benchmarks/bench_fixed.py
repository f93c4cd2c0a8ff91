"""Random bases, zones and objects inside and outside the fixed bodies of the default cell.

    python benchmarks/bench_fixed.py                # 200 that overlap, 200 that are free
    python benchmarks/bench_fixed.py --each 20 --seed 1

An oracle of its own decides which is which: two convex bodies overlap if a linear programme finds a
point in both. Bodies count as overlapping if they still do after they shrink by 2 %, and as free if
they stay so after they grow by 2 %; others are drawn again. The result is one line of JSON.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections import Counter
from pathlib import Path

import mujoco
import numpy as np
import scipy
import trimesh

from twinct.core.errors import ScenarioError
from twinct.geometry import Floats, Pose
from twinct.robots.cell import CellModel, apart, build_cell
from twinct.scenario import Cell, Detector, RoomObject, SourceArm, Zone

HEAD_SEMI_AXES_MM = (72.0, 90.0, 110.0)
SHARE = 0.02


def head() -> trimesh.Trimesh:
    mesh = trimesh.creation.icosphere(subdivisions=2)
    mesh.apply_scale(HEAD_SEMI_AXES_MM)
    return mesh


def drawn(kind: str, rng: np.random.Generator, wedge: Path) -> tuple[Cell, str]:
    """Return a random cell, and the prefix of the names of the bodies that were drawn."""
    at = tuple(np.round(rng.uniform((-900, -900, -1000), (900, 900, 400)), 1).tolist())
    if kind == "base":
        return Cell(source_arm=SourceArm(base_position_mm=at)), "source_"
    size = np.round(rng.uniform(40, 300, 3), 1).tolist()
    shapes = [
        {"kind": "box", "size_mm": size},
        {"kind": "sphere", "radius_mm": size[0]},
        {"kind": "cylinder", "radius_mm": size[0], "height_mm": size[1]},
        {"kind": "capsule", "radius_mm": size[0], "length_mm": size[1]},
        {"kind": "mesh", "path": str(wedge), "unit_mm": size[0]},
    ]
    shape = shapes[rng.integers(3 if kind == "zone" else len(shapes))]
    turned = np.round(rng.uniform(-180, 180, 3), 1).tolist()
    body = {"name": "drawn", "shape": shape, "position_mm": at, "rotation_deg": turned}
    if kind == "zone":
        return Cell(zones=(Zone.model_validate(body),)), "zone drawn"
    group = ("patient", "staff", "furniture")[rng.integers(3)]
    return Cell(objects=(RoomObject.model_validate({**body, "group": group}),)), "object drawn"


def pieces(cell: CellModel) -> list[tuple[str, Floats]]:
    """Return body name and vertices, mm, of all solid shapes that do not move."""
    model, data, found = cell.model, mujoco.MjData(cell.model), []
    mujoco.mj_kinematics(model, data)
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        if model.body_weldid[body] or not model.geom_contype[geom]:
            continue
        size, kind = model.geom_size[geom], model.geom_type[geom]
        if kind == mujoco.mjtGeom.mjGEOM_BOX:
            points = trimesh.creation.box(2 * size).vertices
        elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
            points = trimesh.creation.cylinder(size[0], 2 * size[1], sections=64).vertices
        elif kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
            capsule = trimesh.creation.capsule(2 * size[1], size[0])
            points = capsule.vertices - capsule.bounds.mean(axis=0)
        elif kind == mujoco.mjtGeom.mjGEOM_SPHERE:
            points = trimesh.creation.icosphere(3, size[0]).vertices
        else:
            mesh = int(model.geom_dataid[geom])
            first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
            points = model.mesh_vert[first : first + count]
        placed = points @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
        found.append((model.body(body).name, 1000 * placed))
    return found


def meet(one: Floats, other: Floats, scale: float) -> bool:
    """Tell whether the convex hulls of two sets of points have a point in common."""
    one, other = (m.mean(axis=0) + scale * (m - m.mean(axis=0)) for m in (one, other))
    if (one.min(axis=0) > other.max(axis=0)).any() or (other.min(axis=0) > one.max(axis=0)).any():
        return False
    equal = np.zeros((5, len(one) + len(other)))
    equal[:3] = np.vstack([one, -other]).T
    equal[3, : len(one)] = equal[4, len(one) :] = 1
    solved = scipy.optimize.linprog(
        np.zeros(equal.shape[1]), A_eq=equal, b_eq=[0, 0, 0, 1, 1], method="highs"
    )
    return solved.status == 0


def judged(cell: CellModel, mine: str) -> bool | None:
    """Return True if what was drawn overlaps others, False if it is free, None if in between."""
    both = [
        (a, b)
        for name, a in pieces(cell)
        for other, b in pieces(cell)
        if name.startswith(mine)
        and not other.startswith(mine)
        # Zones may cross the floor, and bases are bolted to it.
        and (other != "floor" or mine.startswith("object"))
    ]
    if any(meet(a, b, 1 - SHARE) for a, b in both):
        return True
    return None if any(meet(a, b, 1 + SHARE) for a, b in both) else False


def refused(cell: CellModel, mine: str) -> str:
    """Return "" if the cell is accepted, else whether the refusal names what was drawn."""
    try:
        apart(cell)
    except ScenarioError as error:
        name = "the source arm's" if mine == "source_" else mine.replace("drawn", "'drawn'")
        return "named" if all(name in problem for problem in error.problems) else "unnamed"
    return ""


def main(each: int, seed: int, folder: Path) -> dict[str, int]:
    wedge = folder / "wedge.stl"  # half a cube, and a small cube apart from it
    half = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]).convex_hull
    cube = trimesh.creation.box(
        (0.3, 0.3, 0.3), trimesh.transformations.translation_matrix((1, 1, 1))
    )
    trimesh.util.concatenate([half, cube]).export(wedge)
    rng, counts = np.random.default_rng(seed), Counter[str]()
    shape, panel = head(), Detector().panel
    wanted = {True: each, False: each}
    while any(wanted.values()):
        kind = ("base", "zone", "object")[sum(counts.values()) % 3]
        section, mine = drawn(kind, rng, wedge)
        cell = build_cell(section, shape, Pose.identity(), panel)
        truth = judged(cell, mine)
        if truth is None or not wanted[truth]:
            counts["drawn again"] += 1
            continue
        wanted[truth] -= 1
        told = refused(cell, mine)
        counts[f"{'overlapping' if truth else 'free'}, {told or 'accepted'}"] += 1
    return dict(counts)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Random bases, zones and objects")
    parser.add_argument("--each", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        found = main(args.each, args.seed, Path(folder))
    print(json.dumps(found))
    good = found.get("overlapping, named"), found.get("free, accepted")
    sys.exit(good != (args.each, args.each))
