"""What the planner says of single poses of both tools, against a referee.

    python benchmarks/bench_referee.py [--arm ur10e lbr_iiwa14] [--scenario FILE]

Views are drawn at random about the isocentre until the referee has so many that can be held.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import mujoco
import numpy as np
from bench_planner import PANEL
from bench_trajectories import MOTION, cell_of, simulated
from referee import Referee

from twinct.cell import CellModel
from twinct.errors import TrajectoryError
from twinct.geometry import Floats, Pose
from twinct.motion import find_way
from twinct.motion.plan import timed
from twinct.motion.way import Way, kept_mm
from twinct.scenario import Cell
from twinct.trajectory import ArcTrajectory, on_sphere
from twinct.trajectory.orbit import orbit_views
from twinct.views import PosePairs, Target

IIWA_BASE_MM = 650.0
"""From the isocentre to the foot of each ``lbr_iiwa14``, which is shorter than a UR10e."""


def drawn(rng: np.random.Generator) -> Target:
    """A view from anywhere between latitudes -50 and 50, with the isocentre moved a little."""
    latitude = np.arcsin(rng.uniform(-1, 1) * np.sin(np.radians(50)))
    sod = rng.uniform(250, 350)
    section = ArcTrajectory(
        kind="arc",
        views=1,
        isocentre_mm=tuple(rng.uniform(-50, 50, 3)),
        sod_mm=sod,
        sdd_mm=sod + rng.uniform(250, 350),
    )
    source = on_sphere(rng.uniform(-np.pi, np.pi), latitude, sod)
    return PosePairs.from_geometry(orbit_views(section, PANEL, source[None])).targets()[0]


def right(cell: CellModel, way: Way, referee: Referee) -> bool:
    """Whether forward kinematics, limits and all distances agree with a way's view."""
    joints: Floats = way.joints[-1]
    gap_mm = referee.gap_mm(joints)
    data = mujoco.MjData(cell.model)
    data.qpos[:] = joints
    mujoco.mj_kinematics(cell.model, data)
    low, high = cell.joint_ranges.T
    asked = (way.targets[0].source, way.targets[0].detector)
    for site, pose in zip(cell.site_ids, asked, strict=True):
        turned = data.site_xmat[site].reshape(3, 3)
        here = Pose.from_matrix(data.site_xpos[site] * 1000, turned)
        if (
            here.distance_mm(pose) > MOTION.ik.position_tolerance_mm + 1e-6
            or here.angle_deg(pose) > MOTION.ik.rotation_tolerance_deg + 1e-6
        ):
            return False
    return bool((joints >= low).all() and (joints <= high).all() and gap_mm >= MOTION.clearance_mm)


def compare(
    cell: CellModel, roll_free: tuple[bool, bool], positives: int, simulations: int
) -> dict[str, object]:
    """Verdicts of both on the same views."""
    rng = np.random.default_rng(0)
    referee = Referee(cell, kept_mm(MOTION), MOTION.ik)
    asked = held = more = wrong = followed = 0
    missed: list[str] = []
    bad: list[object] = []
    while held < positives:
        target = drawn(rng)
        asked += 1
        can = referee.holds(target.source, target.detector, roll_free) is not None
        held += can
        try:
            way = find_way(cell, MOTION, [target], roll_free=roll_free)
        except TrajectoryError as error:
            if can:
                missed.append(str(error))
            continue
        more += not can
        if not right(cell, way, referee):
            wrong += 1
        elif followed < simulations:
            told = simulated(cell, timed(cell, MOTION, way))
            gap = told.get("clearance_every_step_mm", 0.0)
            if not isinstance(gap, float) or gap < MOTION.clearance_mm:
                bad.append(told)
            followed += 1
        if asked % 50 == 0:
            print(asked, held, len(missed), flush=True)
    return {
        "asked": asked,
        "held_by_the_referee": held,
        "of_these_refused": len(missed),
        "refusals": missed,
        "held_by_the_planner_alone": more,
        "wrong": wrong,
        "simulated": followed,
        "of_these_bad": bad,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--arm", nargs="+", default=["ur10e", "lbr_iiwa14"])
    parser.add_argument("--scenario", type=Path, help="whose cell, instead of the default ones")
    parser.add_argument("--positives", type=int, default=500)
    parser.add_argument("--simulations", type=int, default=100)
    args = parser.parse_args()
    if args.scenario:
        cells = {str(args.scenario): cell_of(args.scenario)}
    else:
        cells = {arm: cell_of(None if arm == "ur10e" else _with(arm)) for arm in args.arm}
    for name, cell in cells.items():
        free = cell.cell.source_arm.model == "ur10e"
        told = compare(cell, (free, free), args.positives, args.simulations)
        print(json.dumps({"arm": name} | told, indent=2), flush=True)


def _with(arm: str) -> Cell:
    return Cell.model_validate(
        {
            "source_arm": {"model": arm, "base_position_mm": (IIWA_BASE_MM, 0, 0)},
            "detector_arm": {"model": arm, "base_position_mm": (-IIWA_BASE_MM, 0, 0)},
        }
    )


if __name__ == "__main__":
    main()
