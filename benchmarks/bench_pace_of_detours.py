"""Motion without exposures: detours in a closed room, and the moves of stop-and-shoot scans.

    python benchmarks/bench_pace_of_detours.py [--views 120]

A closed room of 2.6 m x 1.8 m x 2 m leaves the arms no straight way from view to view somewhere on
an arc of 200 deg, whose views are taken at 125 mm/s. Its plan is timed as it is, and with that
speed everywhere. Stop-and-shoot scans of two scenarios are planned and followed in simulation.
Prints simulated seconds.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from twinct.geometry.wire import targets_of
from twinct.robots.motion import RobotSimulation, timing
from twinct.robots.motion.path_search import find_joint_path
from twinct.robots.motion.plan import timed
from twinct.robots.motion.plan_check import RequestedViews, checked_plan
from twinct.scan import SimulationBuilder
from twinct.scenario import load_scenario

ROOT = Path(__file__).parents[1]
HALF_MM, TOP_MM, THICK_MM, HEIGHT_MM = (1300.0, 900.0), 800.0, 50.0, 2600.0
SETTLED = ("demo.yaml", "lbr_arc.yaml")


def box(name: str, size: tuple[float, ...], position: tuple[float, ...]) -> dict[str, Any]:
    """Return a wall or the ceiling."""
    return {"name": name, "shape": {"kind": "box", "size_mm": size}, "position_mm": position}


def closed_room() -> dict[str, Any]:
    """Return the scenario of the closed room."""
    (x, y), out = HALF_MM, THICK_MM / 2
    objects = [
        box("ceiling", (2 * x, 2 * y, THICK_MM), (0.0, 0.0, TOP_MM + out)),
        *(
            box(f"wall {sign}x", (THICK_MM, 2 * y, HEIGHT_MM), (sign * (x + out), 0.0, 100.0))
            for sign in (1, -1)
        ),
        *(
            box(f"wall {sign}y", (2 * x, THICK_MM, HEIGHT_MM), (0.0, sign * (y + out), 100.0))
            for sign in (1, -1)
        ),
    ]
    sphere = {"shape": {"kind": "sphere", "radius_mm": 80, "mesh_resolution_mm": 8}}
    return {
        "trajectory": {"kind": "arc", "views": 60, "longitude_range_deg": 200},
        "motion": {"tool_speed_mm_s": 125},
        "cell": {"objects": objects},
        "specimen": {"parts": [sphere]},
    }


def of_room() -> dict[str, float]:
    """Return the duration of the closed room's plan, and of its longest way from view to view."""
    scenario = load_scenario(closed_room())
    builder, motion = SimulationBuilder(scenario), scenario.motion
    targets = targets_of(builder.requested)
    way = find_joint_path(builder.cell, motion, targets, roll_free=builder.roll_free)
    plan = timed(builder.cell, motion, way)
    with mock.patch.object(timing, "OUT_OF_THE_WAY", np.inf):
        before = timed(builder.cell, motion, way)
    found: dict[str, float] = {}
    for name, one in (("now", plan), ("that speed everywhere", before)):
        longest = float(np.diff(one.exposures_s).max())
        found |= {f"{name}, s": one.duration_s, f"{name}, longest from view to view, s": longest}
    return found


def settled(name: str, views: int) -> dict[str, float]:
    """Return the duration of a stop-and-shoot scan, which is followed in simulation."""
    keys = (f"trajectory.views={views}", "motion.trigger=settled")
    scenario = load_scenario(ROOT / "scenarios" / name, keys)
    builder = SimulationBuilder(scenario)
    plan, robots = builder.plan, builder.robots()
    assert plan is not None and isinstance(robots, RobotSimulation)
    checked_plan(plan, builder.cell, scenario.motion, RequestedViews(plan.targets), name)
    reached = [robots.move(view, target) for view, target in enumerate(plan.targets)]
    off = [
        max(
            one.executed.source[0].distance_mm(target.source[0]),
            one.executed.detector[0].distance_mm(target.detector[0]),
        )
        for one, target in zip(reached, plan.targets, strict=True)
    ]
    return {"views": len(reached), "plan_s": plan.duration_s, "largest_error_mm": max(off)}


def main() -> None:
    """Print all figures."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--views", type=int, default=120)
    args = parser.parse_args()
    print(json.dumps({"closed room": of_room()}, indent=2), flush=True)
    for name in SETTLED * (args.views > 0):
        print(json.dumps({name: settled(name, args.views)}, indent=2), flush=True)


if __name__ == "__main__":
    main()
