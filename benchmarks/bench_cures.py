"""Processor seconds of refusals with their cures, in the default cell.

    python benchmarks/bench_cures.py

Each line is JSON: seconds to find that a scenario cannot be planned, to look for a remedy, and to
draw the first infeasible view; the specimen and the cell are built before. Exit code 1 where the
three take more than ``--most`` seconds.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from twinct.cli.reach import explained
from twinct.core.errors import TrajectoryError
from twinct.scan import SimulationBuilder
from twinct.scenario import load_scenario

SCENARIOS = Path(__file__).parents[1] / "scenarios"
BALL = {"specimen.parts": [{"shape": {"kind": "sphere", "radius_mm": 80}}]}
CASES: dict[str, tuple[str, dict[str, Any]]] = {
    "a full circle": (
        "demo.yaml",
        BALL | {"trajectory": {"kind": "circle", "views": 360}},
    ),
    "too far": ("demo.yaml", {"trajectory.sod_mm": 900, "trajectory.sdd_mm": 1800}),
    "too wide an arc": ("demo.yaml", {"trajectory.longitude_range_deg": 300}),
    "too much clearance": ("paper.yaml", {"motion.clearance_mm": 60}),
}


def seconds(name: str, changes: dict[str, Any], picture: Path) -> dict[str, Any]:
    builder = SimulationBuilder(load_scenario(SCENARIOS / name, changes))
    _ = builder.cell, builder.specimen.surface()
    begun = planned = time.process_time()
    try:
        with explained(builder, picture):
            try:
                _ = builder.plan
            finally:
                planned = time.process_time()
    except TrajectoryError as error:
        whole = time.process_time() - begun
        words = [problem for problem in error.problems if "cure" in problem or "arc" in problem]
        return {"planning_s": planned - begun, "whole_s": whole, "told": words}
    raise SystemExit(f"{name} {changes} is feasible")


def main(most: float) -> int:
    slow = False
    with tempfile.TemporaryDirectory() as folder:
        for name, (scenario, changes) in CASES.items():
            found = seconds(scenario, changes, Path(folder) / "view.png")
            slow |= found["whole_s"] > most
            print(json.dumps({"case": name} | found), flush=True)
    return int(slow)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Refusals with their cures")
    parser.add_argument("--most", type=float, default=5.0)
    sys.exit(main(parser.parse_args().most))
