"""The motion figures of the paper's trajectory in the default cell.

    python benchmarks/bench_motion.py [--views 399] [--trigger on_entry settled] [--save FILE]

Prints, for each trigger, the pose errors (Table 1), clearance, torques, speeds and the real-time
factor. Processor time is given too: on a busy machine it tells more than the clock.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np
import trimesh

from twinct.geometry import Pose
from twinct.geometry.wire import PosePairs, targets_of
from twinct.robots.cell import build_cell
from twinct.robots.motion import RobotSimulation, plan_motion
from twinct.scenario import Cell, Detector, Motion, load_scenario
from twinct.trajectory import SinusoidTrajectory, commanded_views

HEAD_SEMI_AXES_MM = (72.0, 90.0, 110.0)
"""A skull's size with its jaw."""

FINE_IK = {"position_tolerance_mm": 0.01, "rotation_tolerance_deg": 0.01}


def paper_targets(views: int) -> list[PosePairs]:
    panel = Detector().panel
    geometry = commanded_views(SinusoidTrajectory(kind="sinusoid", views=views), panel)
    return targets_of(geometry)


def measure(views: int, trigger: str, scheme: str) -> dict[str, object]:
    head = trimesh.creation.icosphere(subdivisions=4)
    head.apply_scale(HEAD_SEMI_AXES_MM)
    targets = paper_targets(views)
    motion = Motion.model_validate(
        {
            "scheme": scheme,
            "trigger": trigger,
            "ik": FINE_IK if trigger == "settled" else {},
            "tool_speed_mm_s": 125 if trigger == "on_entry" else None,
        }
    )
    start = time.perf_counter()
    paper = load_scenario(Path(__file__).parents[1] / "scenarios" / "paper.yaml").cell
    assert isinstance(paper, Cell)
    cell = build_cell(paper, head, Pose.identity(), Detector().panel)
    built = time.perf_counter()
    plan = plan_motion(cell, motion, targets)
    planned = time.perf_counter()
    simulation = RobotSimulation(cell, motion, plan)
    torque, speed = np.zeros(len(cell.joint_names)), np.zeros(len(cell.joint_names))
    reached = []
    clock, processor = time.perf_counter(), time.process_time()
    for view, target in enumerate(targets):
        reached.append(simulation.move(view, target))
        torque = np.maximum(torque, simulation.watch.torque_share)
        speed = np.maximum(speed, simulation.watch.speed_share)
    clock, processor = time.perf_counter() - clock, time.process_time() - processor
    errors = {}
    for side in ("source", "detector"):
        pairs = [
            (getattr(r.executed, side)[0], getattr(t, side)[0])
            for r, t in zip(reached, targets, strict=True)
        ]
        errors[side] = {
            "position_mm": _spread([a.distance_mm(b) for a, b in pairs]),
            "rotation_deg": _spread([a.angle_deg(b) for a, b in pairs]),
        }
    return {
        "scheme": scheme,
        "trigger": trigger,
        "views": views,
        "reached": len(reached),
        "pose_error": errors,
        "clearance_mm": {
            "plan": float(plan.clearance_mm.min()),
            "every_step": min(r.clearance_mm for r in reached),
        },
        "largest_joint_step_rad": float(np.abs(np.diff(plan.joints, axis=0)).max()),
        "largest_share_of_torque_limit": float(torque.max()),
        "largest_share_of_published_speed": float(speed.max()),
        "predicted_s": float(plan.exposures_s[-1]),
        "simulated_s": simulation.time_s,
        "real_time_factor": simulation.time_s / clock,
        "real_time_factor_by_processor_time": simulation.time_s / processor,
        "us_per_step": processor / simulation.time_s * cell.model.opt.timestep * 1e6,
        "seconds": {"build": built - start, "plan": planned - built, "simulate": clock},
    }


def _spread(values: list[float]) -> dict[str, float]:
    array = np.array(values)
    return {"mean": float(array.mean()), "std": float(array.std()), "max": float(array.max())}


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--views", type=int, default=399)
    parser.add_argument("--trigger", nargs="+", default=["on_entry", "settled"])
    parser.add_argument("--scheme", choices=["planned", "reactive"], default="planned")
    parser.add_argument("--save", help="write the figures as JSON")
    args = parser.parse_args()
    figures = [measure(args.views, trigger, args.scheme) for trigger in args.trigger]
    print(json.dumps(figures, indent=2))
    if args.save:
        with open(args.save, "w", encoding="utf-8") as file:
            json.dump(figures, file, indent=2)


if __name__ == "__main__":
    main()
