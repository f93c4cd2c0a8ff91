"""Fifteen arms of eight vendors: read, placed, planned and run.

    python benchmarks/bench_vendor_arms.py FOLDER [--only ur5e ...] [--seed 0]

FOLDER holds checkouts of the public repositories in ``ARMS``; ``xacro`` is needed. Two arms of a
kind scan 60 views on an arc of 120 deg from places that ``place`` finds; the plan is then followed
in simulation, step by step. One JSON line an arm, then a summary. Processor seconds are of this
process.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from twinct.core.errors import InputError, TargetRefusedError, TrajectoryError
from twinct.geometry import Panel, Pose
from twinct.geometry.wire import PosePairs
from twinct.robots.cell import CellModel, build_cell
from twinct.robots.cell.vendor import write_arm
from twinct.robots.motion import MotionPlan, RobotSimulation, plan_motion
from twinct.robots.motion.branches import matrices
from twinct.robots.reach import Bounds, TargetPoses, place
from twinct.scenario import Cell, Motion
from twinct.trajectory import ArcTrajectory, commanded_views

VIEWS, ARC_DEG = 60, 120.0
MOTION = Motion(scheme="planned", trigger="settled")
HEAD_SEMI_AXES_MM = (72.0, 90.0, 110.0)


@dataclass(frozen=True)
class Arm:
    """One arm.

    Attributes:
        name: name in the results.
        file: description, below the folder of checkouts.
        arguments: arguments of its macros.
        keys: keys of the scenario that the file does not state.
        reach_mm: distance to which bases are sought.
        sod_mm: distance of source and panel from the isocentre.
        tool_kg: masses of source and panel, within the payload.
    """

    name: str
    file: str
    reach_mm: float
    arguments: dict[str, str] = field(default_factory=dict)
    keys: dict[str, Any] = field(default_factory=dict)
    sod_mm: float = 300.0
    tool_kg: tuple[float, float] = (8.0, 4.0)


def supplied(torque_nm: tuple[float, ...] = ()) -> dict[str, Any]:
    """Keys of an arm whose file has no inertia, and no torque limits if some are given."""
    torques = {"joint_torque_nm": torque_nm} if torque_nm else {}
    return {"link_density_kg_m3": 1500.0, **torques}


SMALL, LARGE = (400.0, 400.0, 250.0, 50.0, 50.0, 30.0), (1500.0, 1500.0, 900.0, 200.0, 200.0, 120.0)
"""Torque limits that the vendors do not publish: guesses by the size of the arm."""

ARMS = (
    Arm("kr10r1100sixx", "kuka_experimental/kuka_kr10_support/urdf/kr10r1100sixx.xacro", 1100,
        keys=supplied(SMALL)),
    Arm("kr16_2", "kuka_experimental/kuka_kr16_support/urdf/kr16_2.xacro", 1610,
        keys={"joint_torque_nm": LARGE}),
    Arm("m10ia", "fanuc/fanuc_m10ia_support/urdf/m10ia.xacro", 1420, keys=supplied(LARGE)),
    Arm("cr7ial", "fanuc/fanuc_cr7ia_support/urdf/cr7ial.xacro", 911, keys=supplied(SMALL)),
    Arm("irb1600", "abb_experimental/abb_irb1600_support/urdf/irb1600_6_12.xacro", 1200,
        keys=supplied(LARGE)),
    Arm("irb2400", "abb/abb_irb2400_support/urdf/irb2400_12_155.xacro", 1550, keys=supplied(LARGE)),
    Arm("irb4600", "abb_experimental/abb_irb4600_support/urdf/irb4600_60_205.xacro", 2050,
        keys=supplied((6000.0, 6000.0, 4000.0, 600.0, 600.0, 400.0))),
    Arm("ur5e", "universal_robot/ur_description/urdf/ur5e.xacro", 850, tool_kg=(3.0, 2.0)),
    Arm("ur20", "universal_robot/ur_description/urdf/ur20.xacro", 1750),
    Arm("fr3", "franka_description/robots/fr3/fr3.urdf.xacro", 855, {"hand": "false"},
        {"flange": "fr3_link8"}, 250.0, (2.0, 1.5)),
    Arm("fp3", "franka_description/robots/fp3/fp3.urdf.xacro", 855, {"hand": "false"},
        {"flange": "fp3_link8"}, 250.0, (2.0, 1.5)),
    Arm("xarm6", "xarm_ros/xarm_description/urdf/xarm_device.urdf.xacro", 700, {"dof": "6"},
        {"flange": "link_eef"}, 250.0, (2.5, 1.5)),
    Arm("xarm7", "xarm_ros/xarm_description/urdf/xarm_device.urdf.xacro", 700, {"dof": "7"},
        {"flange": "link_eef"}, 250.0, (2.0, 1.5)),
    Arm("gp12", "motoman/motoman_gp12_support/urdf/gp12.xacro", 1440, keys=supplied()),
    Arm("rx160", "staubli/staubli_rx160_support/urdf/rx160.xacro", 1600),
)  # fmt: skip


def cell_of(arm: Arm, file: Path) -> Cell:
    """Return the cell before the search: both arms within their reach, beside the specimen."""
    aside = 0.6 * arm.reach_mm
    both = {"file": file, "standoff_mm": 150.0, **arm.keys}
    source = {"base_position_mm": (aside, 0.0, -400.0), "tool_mass_kg": arm.tool_kg[0]}
    detector = {"base_position_mm": (-aside, 0.0, -400.0), "tool_mass_kg": arm.tool_kg[1]}
    return Cell.model_validate(
        {
            "source_arm": both | source | {"base_rotation_deg": (0, 0, 180)},
            "detector_arm": both | detector,
            "floor_z_mm": -1500.0,
        }
    )


def figures(arm: Arm, folder: Path, seed: int) -> dict[str, Any]:
    """Return everything about one arm."""
    found: dict[str, Any] = {"arm": arm.name}
    panel, head = Panel(120, 160, 2.0, 2.0), trimesh.creation.icosphere(subdivisions=3)
    head.apply_scale(
        HEAD_SEMI_AXES_MM if arm.sod_mm >= 300 else np.multiply(HEAD_SEMI_AXES_MM, 0.8)
    )
    arc = ArcTrajectory(
        kind="arc", views=VIEWS, longitude_range_deg=ARC_DEG, sod_mm=arm.sod_mm,
        sdd_mm=2 * arm.sod_mm,
    )  # fmt: skip
    views = commanded_views(arc, panel)
    began = time.process_time()
    with tempfile.TemporaryDirectory() as scratch:
        try:
            written = write_arm(folder / arm.file, arm.arguments, Path(scratch) / "arm")
            cell = cell_of(arm, written.file)

            def build(section: Cell) -> CellModel:
                return build_cell(section, head, Pose.identity(), panel)

            found["supplied"] = len(build(cell).notes)
            began = time.process_time()
            poses = TargetPoses(matrices(views.source_poses()), matrices(views.detector_poses()))
            far = 1.1 * arm.reach_mm
            bounds = Bounds((-far, far), (-far, far), (-1100, 400), (100, 200))
            placed = place(
                cell, build, MOTION, poses, roll_free=(False, False), bounds=bounds, samples=8,
                seed=seed,
            )  # fmt: skip
            found["place_s"] = round(time.process_time() - began, 1)
            found["held"] = int(placed.after.sum())
            model = build(placed.cell)
            targets = [
                PosePairs.at(s, d)
                for s, d in zip(views.source_poses(), views.detector_poses(), strict=True)
            ]
            began = time.process_time()
            plan = plan_motion(model, MOTION, targets, roll_free=(False, False))
            found["plan_s"] = round(time.process_time() - began, 1)
        except (InputError, TrajectoryError) as error:
            if "place_s" in found:
                found["plan_s"] = round(time.process_time() - began, 1)
            return found | {"refused": str(error)[:300]}
        return found | followed(model, plan)


def followed(model: CellModel, plan: MotionPlan) -> dict[str, Any]:
    """Return what happens when the simulated arms follow a plan."""
    simulation, exposed, gap = RobotSimulation(model, MOTION, plan), 0, np.inf
    try:
        for view, target in enumerate(plan.targets):
            gap = min(gap, simulation.move(view, target).clearance_mm)
            exposed += 1
    except TargetRefusedError as error:
        return {"exposed": exposed, "refused": str(error)[:300]}
    told = {"exposed": exposed, "clearance_mm": round(float(gap), 1)}
    return told | {"scan_s": round(plan.duration_s, 1)}


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", nargs="*", default=[arm.name for arm in ARMS])
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    all_found = []
    for arm in ARMS:
        if arm.name in args.only:
            all_found.append(figures(arm, args.folder, args.seed))
            print(json.dumps(all_found[-1]), flush=True)
    done = [found for found in all_found if found.get("exposed") == VIEWS]
    seconds = [found["plan_s"] for found in done]
    summary = {
        "arms": len(all_found),
        "planned_and_run": len(done),
        "plan_s_median": float(np.median(seconds)) if seconds else None,
        "plan_s_largest": max(seconds, default=None),
    }
    print(json.dumps(summary))


if __name__ == "__main__":
    main()
