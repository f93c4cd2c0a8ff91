"""Random cells: plans judged by a referee that shares no code with the planner's distances.

    python benchmarks/bench_cells.py FOLDER --from 0 --to 40

FOLDER holds checkouts of the repositories in ``vendor_arms.yaml``. Each number draws a cell afresh:
two vendors' arms, or a built-in one, on the floor, under the ceiling, on a rail or a turntable; a
head; boxes that stand about; tubes of usual size or described by shapes. ``place`` seeks places for
a path of 20 views; its plan is looked at every 5 ms: distances of all pairs by Coal, ranges and
speeds of joints by differences. One JSON line a cell, then a summary. Cells without places that
hold all views, or without a plan, are told and not judged.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import trimesh
from bench_any_arm import LONG_MM, arms, missing, reach_mm
from bench_vendor_arms import Arm
from bench_vendor_arms import cell_of as vendor_cell

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))

from coal_distances import CoalDistances

from twinct.core.errors import InputError, TrajectoryError
from twinct.geometry import Floats, Panel, Pose
from twinct.geometry.wire import PosePairs
from twinct.robots.cell import CellModel, build_cell
from twinct.robots.cell.vendor import write_arm
from twinct.robots.motion import MotionPlan, plan_motion
from twinct.robots.motion.branches import matrices
from twinct.robots.reach import Bounds, SearchLimit, TargetPoses, place
from twinct.scenario import Cell, Motion
from twinct.trajectory import ArcTrajectory, commanded_views

STEP_S = 0.005
VIEWS, SECONDS = 20, 15.0
BUILT_IN = ("ur10e", "lbr_iiwa14")
ROUNDING = 1e-6
"""Angle or length, rad or m, by which a range may be exceeded."""

SPEED_ROUNDING = 1e-6
"""Share by which a speed from differences may exceed a limit."""

C_TOOL = {
    "parts": [
        {"shape": {"kind": "c_shape", "size_mm": [180, 90, 120], "wall_mm": 15},
         "position_mm": [0, 0, 60]},
        {"shape": {"kind": "cylinder", "radius_mm": 45, "height_mm": 100},
         "position_mm": [0, 0, 75]},
    ],
    "tip_mm": [15, 0, 120],
    "tip_rotation_deg": [0, 0, 0],
}  # fmt: skip
"""A tube in a fork, its focal spot beside the flange's axis."""


def drawn_arm(rng: np.random.Generator, folder: Path, scratch: Path, side: str) -> dict[str, Any]:
    """Draw an arm: keys of its section, with ``name``, ``reach`` and ``sod`` for this program."""
    known = [*BUILT_IN, *(one["name"] for one in arms())]
    name = str(rng.choice(known))
    if name in BUILT_IN:
        reach = 1300.0 if name == "ur10e" else 820.0
        return {"name": name, "reach": reach, "keys": {"model": name}}
    one = next(arm for arm in arms() if arm["name"] == name)
    written = write_arm(folder / one["file"], one.get("arguments", {}), scratch / side)
    panel = Panel(120, 160, 2.0, 2.0)
    probe = vendor_cell(Arm(name, "", 1000.0, keys=missing(written.lacking, LONG_MM)), written.file)
    reach = reach_mm(build_cell(probe, None, Pose.identity(), panel))
    keys = {"file": str(written.file), **missing(written.lacking, reach)}
    light = one.get("payload_kg", 9.0) < 9.0 or reach < LONG_MM
    return {"name": name, "reach": reach, "keys": keys, "light": light}


def drawn_cell(
    rng: np.random.Generator, folder: Path, scratch: Path
) -> tuple[dict[str, Any], dict[str, Any], float]:
    """Draw a cell: its section as plain data, what to tell about it, and the distance SOD, mm."""
    both = [drawn_arm(rng, folder, scratch, side) for side in ("source", "detector")]
    shortest = min(arm["reach"] for arm in both)
    sod = 300.0 if shortest > LONG_MM else 250.0
    told: dict[str, Any] = {"arms": [arm["name"] for arm in both]}
    section: dict[str, Any] = {}
    for side, arm, sign in zip(("source", "detector"), both, (1, -1), strict=True):
        aside = sign * (0.55 * min(arm["reach"], 1800.0) + 150.0)
        hangs = bool(rng.random() < 0.25)
        mass = (
            {"source": 2.0, "detector": 1.5} if arm.get("light") else {"source": 8, "detector": 4}
        )
        keys = arm["keys"] | {"tool_mass_kg": float(mass[side]), "standoff_mm": 150.0}
        keys["base_position_mm"] = [aside, 0.0, 700.0 if hangs else -500.0]
        keys["base_rotation_deg"] = [180.0 if hangs else 0.0, 0.0, 180.0 if sign > 0 else 0.0]
        carrier = str(rng.choice(["none", "rail", "turntable"], p=[0.6, 0.25, 0.15]))
        if carrier == "rail":
            keys["rail"] = {"range_mm": [-600, 600]}
        elif carrier == "turntable":
            keys["turntable"] = {"range_deg": [-120, 120]}
        if side == "source" and rng.random() < 0.5:
            keys["tool"] = C_TOOL
            told["c_tool"] = True
        told[side] = ("hangs " if hangs else "") + carrier
        section[f"{side}_arm"] = keys
    boxes = []
    for index in range(int(rng.integers(0, 4))):
        angle, far = rng.uniform(0, 2 * np.pi), rng.uniform(900, 1500)
        size = rng.uniform(100, 500, 3).tolist()
        at = [far * np.cos(angle), far * np.sin(angle), float(rng.uniform(-700, 700))]
        shape = {"kind": "box", "size_mm": size}
        if rng.random() < 0.3:
            shape = {"kind": "c_shape", "size_mm": size, "wall_mm": 20}
        boxes.append({"name": f"box {index}", "shape": shape, "position_mm": at})
    section |= {"objects": boxes, "floor_z_mm": -1400.0, "table": {"top_z_mm": -600.0}}
    return section, told | {"objects": len(boxes)}, sod


def pairs_of(model: mujoco.MjModel) -> np.ndarray:
    """Return all pairs of solid shapes that can move against each other and are not excluded."""
    out = {frozenset((int(s) >> 16, int(s) & 0xFFFF)) for s in model.exclude_signature}
    solid = np.flatnonzero(model.geom_contype | model.geom_conaffinity)
    body, weld = model.geom_bodyid, model.body_weldid
    return np.array(
        [
            (a, b)
            for k, a in enumerate(solid)
            for b in solid[k + 1 :]
            if weld[body[a]] != weld[body[b]] and frozenset((int(body[a]), int(body[b]))) not in out
        ]
    )


def judged(cell: CellModel, plan: MotionPlan, never: np.ndarray) -> dict[str, Any]:
    """Look at a plan every 5 ms."""
    model, data = cell.model, mujoco.MjData(cell.model)
    coal = CoalDistances(model)
    pairs = pairs_of(model)
    pairs = pairs[~np.array([tuple(pair) in set(map(tuple, never.tolist())) for pair in pairs])]
    times = np.arange(0, plan.duration_s + STEP_S, STEP_S)
    joints: Floats = plan.at(times)[:, 0]
    low, high = cell.joint_ranges.T
    beyond = np.maximum(joints - high, low - joints)
    outside = int((beyond > ROUNDING).any(axis=1).sum())
    speeds = np.abs(np.diff(joints, axis=0)) / STEP_S
    most = cell.speed_limits * cell.speed_scales * (1 + SPEED_ROUNDING)
    fast = int((speeds > most).any(axis=1).sum())
    least = np.inf
    for row in joints:
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        least = min(least, coal.smallest(data, pairs))
    return {
        "duration_s": round(plan.duration_s, 1), "instants": len(times), "outside": outside,
        "beyond": float(f"{beyond.max():.2g}"), "fast": fast, "least_mm": round(1e3 * least, 2),
        "planned_mm": round(float(plan.clearance_mm.min()), 2),
    }  # fmt: skip


def figures(number: int, folder: Path) -> dict[str, Any]:
    """Return everything about one cell."""
    rng, began = np.random.default_rng([62, number]), time.process_time()
    found: dict[str, Any] = {"cell": number}
    with tempfile.TemporaryDirectory() as scratch:
        try:
            section, told, sod = drawn_cell(rng, folder, Path(scratch))
            found |= told
            cell = Cell.model_validate(section)
            panel, head = Panel(120, 160, 2.0, 2.0), trimesh.creation.icosphere(subdivisions=2)
            head.apply_scale(np.multiply((72.0, 90.0, 110.0), sod / 300))
            motion = Motion(trigger="settled" if rng.random() < 0.5 else "on_entry")
            arc = ArcTrajectory(
                kind="arc", views=VIEWS, longitude_range_deg=float(rng.uniform(30, 100)),
                centre_longitude_deg=float(rng.uniform(-20, 20)),
                latitude_deg=float(rng.uniform(-10, 10)), sod_mm=sod, sdd_mm=2 * sod,
            )  # fmt: skip
            views = commanded_views(arc, panel)
            sides = views.source_poses(), views.detector_poses()
            poses = TargetPoses(matrices(sides[0]), matrices(sides[1]))

            def build(one: Cell) -> CellModel:
                return build_cell(one, head, Pose.identity(), panel)

            bounds = Bounds((-1800, 1800), (-1800, 1800), (-1100, 900), (120, 200))
            placed = place(
                cell, build, motion, poses, roll_free=(True, True), bounds=bounds, seed=number,
                limit=SearchLimit(SECONDS, time.process_time),
            )  # fmt: skip
            found |= {"held": int(placed.after.sum())}
            targets = [PosePairs.at(s, d) for s, d in zip(*sides, strict=True)]
            model = build(placed.cell)
            plan = plan_motion(model, motion, targets, roll_free=(True, True))
        except (InputError, TrajectoryError) as error:
            return found | {"refused": str(error)[:200], "s": round(time.process_time() - began)}
        known = {tuple(pair) for pair in model.pairs.tolist()}
        never = np.array([p for p in pairs_of(model.model).tolist() if tuple(p) not in known])
        # Pairs that the planner leaves out are those of distant objects, which are judged too, and
        # shapes of a tool that never part from the wrist.
        own = [p for p in never.tolist() if _of_tool_and_wrist(model, p)]
        found |= judged(model, plan, np.array(own).reshape(-1, 2))
    return found | {"s": round(time.process_time() - began)}


def _of_tool_and_wrist(cell: CellModel, pair: list[int]) -> bool:
    model = cell.model
    bodies = [int(model.geom_bodyid[geom]) for geom in pair]
    tools = [b for b in bodies if model.body(b).name in ("source", "detector")]
    if len(tools) != 1:
        return False
    other = next(b for b in bodies if b != tools[0])
    last = int(model.body_weldid[tools[0]])
    return int(model.body_weldid[other]) == int(model.body_weldid[model.body_parentid[last]])


def main() -> None:
    """Judge each cell, and print what was found."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--from", type=int, default=0, dest="first")
    parser.add_argument("--to", type=int, default=40)
    args = parser.parse_args()
    told = []
    for number in range(args.first, args.to):
        told.append(figures(number, args.folder))
        print(json.dumps(told[-1]), flush=True)
    plans = [one for one in told if "least_mm" in one]
    bad = [one["cell"] for one in plans if one["least_mm"] <= 0 or one["outside"] or one["fast"]]
    print(json.dumps({"cells": len(told), "planned": len(plans), "broken": bad}))


if __name__ == "__main__":
    main()
