"""How fast ways are found in the default cell: candidates, whole plans, detours.

    python benchmarks/bench_planner.py [--detours 40]

Prints processor seconds, which on a busy machine tell more than the clock. The cell is there
before.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from twinct.core.errors import TrajectoryError
from twinct.geometry import Floats, Pose
from twinct.geometry.wire import PosePairs
from twinct.robots.cell import CellModel, build_cell
from twinct.robots.motion.branches import Branches, matrices
from twinct.robots.motion.feasible import Feasible
from twinct.robots.motion.path_planner import SEARCHES, Detours
from twinct.robots.motion.path_search import find_joint_path, required_gap_mm
from twinct.scenario import Cell, Detector, InverseKinematics, Motion
from twinct.trajectory import ArcTrajectory, SinusoidTrajectory, commanded_views, on_sphere
from twinct.trajectory.orbit import orbit_views

HEAD_SEMI_AXES_MM = (72.0, 90.0, 110.0)
PANEL = Detector().panel
MOTION = Motion(trigger="settled")


def default_cell() -> CellModel:
    head = trimesh.creation.icosphere(subdivisions=4)
    head.apply_scale(HEAD_SEMI_AXES_MM)
    return build_cell(Cell(), head, Pose.identity(), PANEL)


def paper(views: int) -> PosePairs:
    section = SinusoidTrajectory(kind="sinusoid", views=views)
    return PosePairs.from_geometry(commanded_views(section, PANEL))


def on(longitude_deg: Floats, latitude_deg: Floats) -> PosePairs:
    section = ArcTrajectory(kind="arc", views=len(longitude_deg))
    sources = on_sphere(np.radians(longitude_deg), np.radians(latitude_deg), section.sod_mm)
    return PosePairs.from_geometry(orbit_views(section, PANEL, sources))


def spiral(views: int) -> PosePairs:
    """A spherical spiral from latitude -20 to 30, three times to and fro over 160 degrees."""
    share = np.linspace(0, 1, views)
    return on(80 * np.sin(6 * np.pi * share), -20 + 50 * share)


def timed(work: Callable[[], object]) -> tuple[float, object]:
    begin = time.process_time()
    try:
        found = work()
    except TrajectoryError as error:
        found = str(error)
    return time.process_time() - begin, found


def judged(cell: CellModel, poses: Floats, arm: int) -> dict[str, float]:
    """Candidates of one arm, solved and judged."""
    side = ("source", "detector")[arm]
    branches, room = Branches(cell, arm, InverseKinematics()), Feasible(cell, side)
    begin = time.process_time()
    found = branches.of(poses)
    joints = np.zeros((len(found.joints), len(cell.joint_names)))
    joints[:, cell.arm_joints[arm]] = found.joints
    clear = room.clear(joints, required_gap_mm(MOTION))
    seconds = time.process_time() - begin
    return {
        "candidates": len(joints),
        "clear_share": float(clear.mean()),
        "a_minute_and_core": 60 * len(joints) / seconds,
    }


def detours(cell: CellModel, number: int) -> dict[str, object]:
    """Between clear configurations of random views, straight where that is not clear."""
    rng = np.random.default_rng(0)
    views = on(rng.uniform(-90, 90, 300), rng.uniform(-25, 25, 300))
    room = Feasible(cell)
    of_arms = [
        Branches(cell, arm, MOTION.ik).of(matrices(list(poses)))
        for arm, poses in enumerate((views.source, views.detector))
    ]
    joints = []
    for view in range(len(views)):
        both = [found.joints[found.pose == view] for found in of_arms]
        pairs = np.array([np.hstack([a, b]) for a in both[0] for b in both[1]])
        if len(pairs) and (clear := room.clear(pairs, required_gap_mm(MOTION))).any():
            good = pairs[clear]
            joints.append(good[rng.integers(len(good))])
    planner = Detours(cell, room, np.ptp(cell.joint_ranges, axis=1) > 3 * np.pi, 0)
    seconds, found = [], 0
    for a, b in zip(joints[:-1], joints[1:], strict=True):
        if len(seconds) == number:
            break
        if room.straight(a[None], b[None], required_gap_mm(MOTION))[0]:
            continue
        begin = time.process_time()
        ways = (planner.between(a, b, required_gap_mm(MOTION), k) for k in range(len(SEARCHES)))
        found += any(way is not None for way in ways)
        seconds.append(time.process_time() - begin)
    return {
        "asked": len(seconds),
        "found": found,
        "median_s": float(np.median(seconds)),
        "p95_s": float(np.percentile(seconds, 95)),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--detours", type=int, default=40)
    args = parser.parse_args()
    cell = default_cell()
    rng = np.random.default_rng(1)
    random = np.tile(np.eye(4), (600, 1, 1))
    random[:, :3, :3] = Rotation.random(600, rng=rng).as_matrix()
    random[:, :3, 3] = (850, 0, 0) + rng.uniform(-900, 900, (600, 3))
    path = paper(399)
    figures: dict[str, object] = {
        "along_the_paper": judged(cell, matrices(list(path.source)), 0),
        "at_random": judged(cell, random, 0),
    }
    print(json.dumps(figures, indent=2), flush=True)  # noqa: T201
    for name, poses, free in (
        ("paper, 399 views, fixed roll", path, (False, False)),
        ("paper, 399 views, both rolls free", path, (True, True)),
        ("spiral, 200 views", spiral(200), (False, False)),
        ("spiral, 200 views, both rolls free", spiral(200), (True, True)),
    ):
        seconds, way = timed(
            lambda p=poses, f=free: find_joint_path(cell, MOTION, p.targets(), roll_free=f)
        )
        told = way if isinstance(way, str) else f"{len(getattr(way, 'joints'))} knots"  # noqa: B009
        print(f"{name}: {seconds:.1f} s, {told}", flush=True)  # noqa: T201
    print(json.dumps({"detours": detours(cell, args.detours)}, indent=2))  # noqa: T201


if __name__ == "__main__":
    main()
