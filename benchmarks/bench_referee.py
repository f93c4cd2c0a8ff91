"""What the planner says of single views, against a referee that shares hardly anything with it.

    python benchmarks/bench_referee.py [--arm ur10e lbr_iiwa14] [--scenario FILE] [--results FILE]

Views are drawn about the isocentre until the referee has so many that can be held; the turns about
the beam are free for a ``ur10e`` and fixed for an ``lbr_iiwa14``. One JSON line a view and cell;
those in the file of results are not judged again.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from bench_planner import PANEL
from bench_trajectories import MOTION, cell_of, mark, simulated, told_in
from referee import Referee

from twinct.core.errors import TrajectoryError
from twinct.geometry import Pose
from twinct.geometry.wire import PosePairs, targets_of
from twinct.robots.cell import CellModel
from twinct.robots.motion import JointPath, find_joint_path
from twinct.robots.motion.path_search import required_gap_mm
from twinct.robots.motion.plan import timed
from twinct.scenario import Cell
from twinct.trajectory import ArcTrajectory, on_sphere
from twinct.trajectory.orbit import orbit_views

RESULTS = Path(__file__).parent / "results" / "referee.jsonl"

BASE_MM = {"ur10e": 850.0, "lbr_iiwa14": 650.0}
"""From the isocentre to the foot of each arm."""

WITHIN_DEG = {"ur10e": (115, 40), "lbr_iiwa14": (90, 25)}
"""Longitudes and latitudes of views: somewhat more than can be held."""


def drawn(index: int, within_deg: tuple[float, float]) -> PosePairs:
    """A view of an isocentre moved a little."""
    rng = np.random.default_rng([0, index])
    longitude, latitude = np.radians(rng.uniform(-1, 1, 2) * within_deg)
    sod = rng.uniform(250, 350)
    section = ArcTrajectory(
        kind="arc",
        views=1,
        isocentre_mm=tuple(rng.uniform(-50, 50, 3)),
        sod_mm=sod,
        sdd_mm=sod + rng.uniform(250, 350),
    )
    source = on_sphere(np.array([longitude]), np.array([latitude]), sod)
    return targets_of(orbit_views(section, PANEL, source))[0]


def right(cell: CellModel, way: JointPath, referee: Referee) -> bool:
    """Whether forward kinematics, limits and all distances agree with a way's view."""
    joints = way.joints[-1]
    low, high = cell.joint_ranges.T
    inside = (joints >= low).all() and (joints <= high).all()
    data = mujoco.MjData(cell.model)
    data.qpos[:] = joints
    mujoco.mj_kinematics(cell.model, data)
    there = []
    for site, pose in zip(cell.site_ids, way.targets[0][0], strict=True):
        turned = data.site_xmat[site].reshape(3, 3)
        here = Pose.from_matrix(data.site_xpos[site] * 1000, turned)
        there.append(here.distance_mm(pose) <= MOTION.ik.position_tolerance_mm + 1e-6)
        there.append(here.angle_deg(pose) <= MOTION.ik.rotation_tolerance_deg + 1e-6)
    return bool(inside and all(there) and referee.gap_mm(joints) >= MOTION.clearance_mm)


def judged(
    cell: CellModel, referee: Referee, target: PosePairs, free: bool, simulate: bool
) -> dict[str, Any]:
    """Both verdicts on a view."""
    held = referee.holds(*target[0], (free, free)) is not None
    try:
        way = find_joint_path(cell, MOTION, [target], roll_free=(free, free))
    except TrajectoryError as error:
        return {"held": held, "planned": False} | ({"refusal": str(error)} if held else {})
    told = {"held": held, "planned": True, "right": right(cell, way, referee)}
    return told | (simulated(cell, timed(cell, MOTION, way)) if simulate else {})


def compare(
    name: str, cell: CellModel, results: Path, positives: int, simulations: int
) -> dict[str, Any]:
    """Verdicts of both on as many views as it takes."""
    model = cell.cell.source_arm.model
    referee = Referee(cell, required_gap_mm(MOTION), MOTION.ik)
    told = [line for line in told_in(results) if line["cell"] == mark(cell)]
    while sum(line["held"] for line in told) < positives:
        target = drawn(len(told), WITHIN_DEG[model or "ur10e"])
        simulate = sum("exposed" in line for line in told) < simulations
        told.append(
            {"cell": mark(cell)} | judged(cell, referee, target, model == "ur10e", simulate)
        )
        with results.open("a") as file:
            file.write(json.dumps(told[-1]) + "\n")
    held = [line for line in told if line["held"]]
    followed = [line for line in told if "exposed" in line]
    return {
        "cell": name,
        "asked": len(told),
        "held_by_the_referee": len(held),
        "of_these_refused": [line["refusal"] for line in held if not line["planned"]],
        "planned_and_not_held": sum(line["planned"] for line in told)
        - sum(line["planned"] for line in held),
        "planned_and_wrong": sum(not line.get("right", True) for line in told),
        "simulated": len(followed),
        "of_these_exposed": sum(line["exposed"] for line in followed),
        "least_clearance_mm": min(line.get("clearance_every_step_mm", 0.0) for line in followed),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--arm", nargs="+", default=list(BASE_MM))
    parser.add_argument(
        "--scenario", type=Path, help="take the cell of this scenario, not the arms' own"
    )
    parser.add_argument("--positives", type=int, default=500)
    parser.add_argument("--simulations", type=int, default=100)
    parser.add_argument("--results", type=Path, default=RESULTS)
    args = parser.parse_args()
    if args.scenario:
        cells = {str(args.scenario): cell_of(args.scenario)}
    else:
        cells = {arm: cell_of(with_two(arm)) for arm in args.arm}
    for name, cell in cells.items():
        told = compare(name, cell, args.results, args.positives, args.simulations)
        print(json.dumps(told, indent=2), flush=True)


def with_two(arm: str) -> Cell:
    """Two arms that face each other."""
    section = {"model": arm, "base_position_mm": (BASE_MM[arm], 0, 0)}
    other = section | {"base_position_mm": (-BASE_MM[arm], 0, 0)}
    return Cell.model_validate({"source_arm": section, "detector_arm": other})


if __name__ == "__main__":
    main()
