"""Processor seconds of refusals with their cures, in the default cell.

    python benchmarks/bench_cures.py

Each line is JSON: seconds to build the room, to find that a scenario cannot be planned, to look for
a remedy, and to draw the first infeasible view. The least of ``--times`` repetitions counts. Exit
code 1 where the last three take more than ``--most`` seconds, or the search longer than room and
plan.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from twinct.core.cached import forget
from twinct.core.errors import TrajectoryError
from twinct.core.progress import Effort, counted
from twinct.runs.remedies import LEAST_WORK, SHARE, pictured, remedies
from twinct.scan import SimulationBuilder
from twinct.scenario import load_scenario

SCENARIOS = Path(__file__).parents[1] / "scenarios"
BALL = {"specimen.parts": [{"shape": {"kind": "sphere", "radius_mm": 80}}]}
NURSE = {
    "name": "nurse",
    "shape": {"kind": "capsule", "radius_mm": 200, "length_mm": 1300},
    "position_mm": [200, 700, -350],
}
CASES: dict[str, tuple[str, dict[str, Any]]] = {
    "a full circle": (
        "demo.yaml",
        BALL | {"trajectory": {"kind": "circle", "views": 360}},
    ),
    "too far": ("demo.yaml", {"trajectory.sod_mm": 900, "trajectory.sdd_mm": 1800}),
    "too wide an arc": ("demo.yaml", {"trajectory.longitude_range_deg": 300}),
    "too much clearance": ("paper.yaml", {"motion.clearance_mm": 60}),
    "a zone in the way": ("demo.yaml", {"cell.zones": [NURSE]}),
    "two arms of seven joints": ("lbr_arc.yaml", {"trajectory.longitude_range_deg": 200}),
}


def seconds(name: str, changes: dict[str, Any], picture: Path) -> dict[str, Any]:
    builder = SimulationBuilder(load_scenario(SCENARIOS / name, changes))
    forget("specimen")
    began = time.process_time()
    _ = builder.cell
    times, planning = {"room_s": time.process_time() - began}, Effort()
    _, begun = builder.specimen.surface(), time.process_time()
    try:
        with counted() as planning:
            _ = builder.plan
    except TrajectoryError as error:
        times["planning_s"] = time.process_time() - begun
        views, words = remedies(builder, error, max(SHARE * planning.units, LEAST_WORK))
        times["search_s"] = time.process_time() - begun - times["planning_s"]
        if views:
            pictured(builder, picture, views[0])
        times["whole_s"] = time.process_time() - begun
        return {"units": planning.units, **times, "told": words}
    raise SystemExit(f"{name} {changes} is feasible")


def main(most: float, times: int) -> int:
    bad = False
    with tempfile.TemporaryDirectory() as folder:
        for name, (scenario, changes) in CASES.items():
            all_found = [seconds(scenario, changes, Path(folder) / "v.png") for _ in range(times)]
            found = min(all_found, key=lambda one: one["whole_s"])
            ratio = found["search_s"] / found["planning_s"]
            bad |= found["whole_s"] > most or ratio > 1 + found["room_s"] / found["planning_s"]
            print(json.dumps({"case": name, "search/planning": ratio} | found), flush=True)
    return int(bad)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Refusals with their cures")
    parser.add_argument("--most", type=float, default=5.0)
    parser.add_argument("--times", type=int, default=3)
    args = parser.parse_args()
    sys.exit(main(args.most, args.times))
