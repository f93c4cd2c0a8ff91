"""Arms of vendors as they are: written by ``twinct arm``, placed, checked, planned and run.

    python benchmarks/bench_any_arm.py FOLDER [--only ur30 ...] [--seed 0] [--seconds 15]

FOLDER holds checkouts of the public repositories in ``vendor_arms.yaml``, which also has the list
from which ten arms are drawn by seed; ``xacro`` is needed. Two arms of a kind scan 60 views on an
arc of 120 deg, or of 90 deg if ``place`` finds no places that hold all views of the longer one.
What a file lacks is stated by size: guesses, as a user would look it up. Nothing else is stated: no
flange, and no pairs of links. The places are those of ``place``; processor seconds are of this
process. One JSON line an arm, then a summary.
"""

from __future__ import annotations

import argparse
import json
import random
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
import yaml
from bench_vendor_arms import HEAD_SEMI_AXES_MM, LARGE, MOTION, SMALL, VIEWS, Arm, cell_of, followed

from twinct.cli.commands.place import SECONDS
from twinct.core.errors import InputError, TrajectoryError
from twinct.geometry import Panel, Pose
from twinct.geometry.wire import PosePairs
from twinct.robots.cell import CellModel, build_cell, mujoco
from twinct.robots.cell.vendor import write_arm
from twinct.robots.motion import plan_motion
from twinct.robots.motion.branches import matrices
from twinct.robots.reach import Bounds, SearchLimit, TargetPoses, place
from twinct.scenario import Cell
from twinct.trajectory import ArcTrajectory, commanded_views

ARMS = Path(__file__).with_name("vendor_arms.yaml")
ABSENT = ("ur15", "ur8long")
DRAWN = 12
LONG_MM, LIGHT_KG = 1000.0, 9.0
"""Reach and payload from which an arm carries 8 and 4 kg, on a larger circle; else 2 and 1.5 kg."""

ARCS_DEG = (120.0, 90.0)

TORQUES_NM = (
    (LONG_MM, SMALL),
    (1900.0, LARGE),
    (2600.0, (6000.0, 6000.0, 4000.0, 600.0, 600.0, 400.0)),
    (np.inf, (15000.0, 15000.0, 9000.0, 2000.0, 2000.0, 1200.0)),
)
"""Torque limits up to some reach, mm: guesses, where neither file nor vendor states them."""


def arms() -> list[dict[str, Any]]:
    """Return the named arms, then those drawn."""
    data = yaml.safe_load(ARMS.read_text())
    drawn = random.Random(data["seed"]).sample(data["listed"], DRAWN)
    return data["named"] + [arm for arm in drawn if arm["name"] not in ABSENT]


def reach_mm(model: CellModel) -> float:
    """Return the distance that the flange of the source arm has from its first axis, mostly."""
    data, rng, far = mujoco.MjData(model.model), np.random.default_rng(0), []
    site, first = model.site_ids[0], int(model.model.jnt_bodyid[0])
    for _ in range(2000):
        data.qpos[:] = rng.uniform(*model.joint_ranges.T)
        mujoco.mj_kinematics(model.model, data)
        far.append(np.linalg.norm(data.site_xpos[site] - data.xpos[first]))
    return 1000 * float(np.quantile(far, 0.99))


def missing(lacking: Mapping[str, tuple[str, ...]], reach: float) -> dict[str, Any]:
    """Return guesses for the keys that a file needs; torques grow with the arm's size."""
    keys: dict[str, Any] = {}
    if "link_density_kg_m3" in lacking:
        keys["link_density_kg_m3"] = 1500.0
    if names := lacking.get("joint_torque_nm"):
        torques = next(nm for far, nm in TORQUES_NM if reach < far)
        keys["joint_torque_nm"] = torques[: len(names)]
    if "joint_speed_deg_s" in lacking:
        keys["joint_speed_deg_s"] = 120.0
    return keys


def figures(one: dict[str, Any], folder: Path, seed: int, most_s: float) -> dict[str, Any]:
    """Return everything about one arm."""
    found: dict[str, Any] = {"arm": one["name"]}
    panel, head = Panel(120, 160, 2.0, 2.0), trimesh.creation.icosphere(subdivisions=3)
    with tempfile.TemporaryDirectory() as scratch:
        began = time.process_time()
        try:
            written = write_arm(
                folder / one["file"], one.get("arguments", {}), Path(scratch) / "arm"
            )
            found["write_s"] = round(time.process_time() - began, 1)
            found["lacking"] = sorted(written.lacking)
            probe = Arm(one["name"], "", 1000.0, keys=missing(written.lacking, LONG_MM))
            reach = reach_mm(build_cell(cell_of(probe, written.file), None, Pose.identity(), panel))
            long = reach > LONG_MM
            found["reach_mm"] = round(reach)
            heavy = long and one.get("payload_kg", LIGHT_KG) >= LIGHT_KG
            sod_mm, tool_kg = 300.0 if long else 250.0, (8.0, 4.0) if heavy else (2.0, 1.5)
            keys = missing(written.lacking, reach)
            arm = Arm(one["name"], "", reach, {}, keys, sod_mm, tool_kg)
            head.apply_scale(np.multiply(HEAD_SEMI_AXES_MM, sod_mm / 300))
            cell = cell_of(arm, written.file)

            def build(section: Cell) -> CellModel:
                return build_cell(section, head, Pose.identity(), panel)

            found["notes"] = len(build(cell).notes)
            far = 1.1 * min(reach, 2000.0)
            bounds = Bounds((-far, far), (-far, far), (-1100, 400), (100, 200))
            views = placed = None
            for arc_deg in ARCS_DEG:
                arc = ArcTrajectory(
                    kind="arc", views=VIEWS, longitude_range_deg=arc_deg, sod_mm=sod_mm,
                    sdd_mm=2 * sod_mm,
                )  # fmt: skip
                views = commanded_views(arc, panel)
                poses = TargetPoses(
                    matrices(views.source_poses()), matrices(views.detector_poses())
                )
                began = time.process_time()
                placed = place(
                    cell, build, MOTION, poses, roll_free=(False, False), bounds=bounds, seed=seed,
                    limit=SearchLimit(most_s, time.process_time),
                )  # fmt: skip
                seconds = max(found.get("place_s", 0.0), round(time.process_time() - began, 1))
                found |= {"arc_deg": arc_deg, "place_s": seconds, "held": int(placed.after.sum())}
                if placed.after.all():
                    break
            assert views is not None and placed is not None
            found |= {"places": placed.alone, "cells": placed.judged, "stopped": placed.stopped}
            targets = [
                PosePairs.at(s, d)
                for s, d in zip(views.source_poses(), views.detector_poses(), strict=True)
            ]
            model, began = build(placed.cell), time.process_time()
            plan = plan_motion(model, MOTION, targets, roll_free=(False, False))
            found["plan_s"] = round(time.process_time() - began, 1)
        except (InputError, TrajectoryError) as error:
            return found | {"refused": str(error)[:400]}
        return found | followed(model, plan)


def main() -> None:
    """Try each arm, and print what happened."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", nargs="*", default=[arm["name"] for arm in arms()])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=SECONDS, help="of place, for each arc")
    args = parser.parse_args()
    all_found = []
    for arm in arms():
        if arm["name"] in args.only:
            all_found.append(figures(arm, args.folder, args.seed, args.seconds))
            print(json.dumps(all_found[-1]), flush=True)
    usable = [found["arm"] for found in all_found if found.get("exposed") == VIEWS]
    longest = max((found.get("place_s", 0.0) for found in all_found), default=0.0)
    print(json.dumps({"arms": len(all_found), "usable": len(usable), "place_s_largest": longest}))


if __name__ == "__main__":
    main()
