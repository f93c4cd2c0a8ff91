"""A spine of 400 mm, scanned by two arms on rails of 2 m: planned, and run in this process.

    python benchmarks/bench_rails.py                      # scenarios/spine_rails.yaml
    python benchmarks/bench_rails.py --views 40 --voxel-mm 4

The scan is checked against what it should be: every view within the tolerances, every clearance
kept, the carriages within their limits, and nothing of it possible without rails. The result is one
line of JSON.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np

from twinct.core.errors import TrajectoryError
from twinct.runs import simulate
from twinct.scan import SimulationBuilder
from twinct.scenario import Cell, Scenario, load_scenario

SCENARIO = Path(__file__).parents[1] / "scenarios" / "spine_rails.yaml"


def without_rails(scenario: Scenario) -> int:
    """Return the number of problems that the plan of arms without rails has; 0 if it exists."""
    changes = {"cell.source_arm.rail": None, "cell.detector_arm.rail": None}
    try:
        _ = SimulationBuilder(scenario.with_(changes)).plan
    except TrajectoryError as error:
        return len(error.problems)
    return 0


def main(views: int, voxel_mm: float) -> tuple[dict[str, float], bool]:
    part = {"kind": "volume", "phantom": "trunk", "voxel_mm": voxel_mm, "seed": 1, "centre": False}
    parts = [{"name": "patient", "shape": part, "material": "bone"}]
    scenario = load_scenario(SCENARIO, {"trajectory.views": views, "specimen.parts": parts})
    assert isinstance(scenario.cell, Cell)
    builder = SimulationBuilder(scenario)
    cell, began = builder.cell, time.process_time()
    plan = builder.plan
    assert plan is not None
    planned_s = time.process_time() - began
    scan = simulate(scenario, builder=builder)
    poses = zip(
        (*scan.commanded.source, *scan.commanded.detector),
        (*scan.executed.source, *scan.executed.detector),
        strict=True,
    )
    off_mm = max(asked.distance_mm(reached) for asked, reached in poses)
    rails = [cell.arm_joints[0].start, cell.arm_joints[1].start]
    travel = 1000 * plan.joints[:, rails]
    inside = bool((np.abs(travel) <= 1000).all())
    found = {
        "views": len(scan.executed),
        "processor seconds to plan": round(planned_s, 1),
        "scan, s": round(plan.duration_s, 1),
        "largest distance from a target, mm": round(off_mm, 3),
        "smallest clearance, mm": round(float(np.min(plan.clearance_mm)), 1),
        "travel of the source's carriage, mm": round(float(np.ptp(travel[:, 0]))),
        "travel of the panel's carriage, mm": round(float(np.ptp(travel[:, 1]))),
        "problems without rails": without_rails(scenario),
    }
    good = (
        len(scan.executed) == views
        and off_mm <= scenario.motion.tolerance_mm
        and float(np.min(plan.clearance_mm)) >= scenario.motion.clearance_mm
        and inside
        and found["problems without rails"] > 0
    )
    return found, good


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Arms on rails")
    parser.add_argument("--views", type=int, default=200)
    parser.add_argument("--voxel-mm", type=float, default=1.25)
    args = parser.parse_args()
    result, is_good = main(args.views, args.voxel_mm)
    print(json.dumps(result))
    sys.exit(not is_good)
