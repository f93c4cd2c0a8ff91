"""Ways through sixty trajectories: refereed, planned, simulated at every step.

    python benchmarks/bench_trajectories.py [--scenario FILE] [--gap-minutes 10] [--results FILE]

One JSON line a trajectory and cell; those in the file of results are not done again. Of a gap that
the planner does not close, a search of its own tells whether it can be closed.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import re
import time
from pathlib import Path
from typing import Any

import numpy as np
from bench_planner import HEAD_SEMI_AXES_MM, PANEL
from referee import Referee
from roadmap import Roadmap
from sixty import Named, sixty
from trimesh.creation import icosphere

from twinct.core.errors import TargetRefusedError, TrajectoryError
from twinct.geometry import Pose
from twinct.robots.cell import CellModel, build_cell
from twinct.robots.motion import MotionPlan, RobotSimulation, plan_motion
from twinct.scenario import Cell, Motion, load_scenario

RESULTS = Path(__file__).parent / "results" / "trajectories.jsonl"

MOTION = Motion(scheme="planned", trigger="settled")


def cell_of(given: Path | Cell | None) -> CellModel:
    """A cell, that of a scenario, or the default one, with a head's ellipsoid in it."""
    section = load_scenario(given).cell if isinstance(given, Path) else given or Cell()
    if not isinstance(section, Cell):
        raise SystemExit(f"{given}: the cell has no arms")
    head = icosphere(subdivisions=4)
    head.apply_scale(HEAD_SEMI_AXES_MM)
    return build_cell(section, head, Pose.identity(), PANEL)


def mark(cell: CellModel) -> str:
    """What tells results in one cell from those in another."""
    return hashlib.sha256(cell.cell.model_dump_json().encode()).hexdigest()[:12]


def refereed(cell: CellModel, named: Named) -> list[int]:
    """Views that cannot be held at all."""
    referee, near, out = Referee(cell, MOTION.clearance_mm, MOTION.ik), None, []
    for view, target in enumerate(named.targets):
        held = referee.holds(*target[0], named.roll_free, near)
        near = near if held is None else held
        if held is None:
            out.append(view)
    return out


def simulated(cell: CellModel, plan: MotionPlan) -> dict[str, Any]:
    """What happens when the arms follow a plan."""
    simulation = RobotSimulation(cell, MOTION, plan)
    exposed, off_deg, gap_mm = 0, 0.0, np.inf
    try:
        for view, target in enumerate(plan.targets):
            reached = simulation.move(view, target)
            exposed += 1
            off = np.degrees(np.abs(reached.position - plan.joints[view]).max())
            off_deg, gap_mm = max(off_deg, float(off)), min(gap_mm, reached.clearance_mm)
    except TargetRefusedError as error:
        return {"exposed": exposed, "refused": str(error)}
    return {
        "exposed": exposed,
        "clearance_every_step_mm": round(gap_mm, 3),
        "joints_off_deg": round(off_deg, 5),
        "predicted_s": round(float(plan.exposures_s[-1]), 3),
        "simulated_s": round(simulation.time_s, 3),
    }


def figures(cell: CellModel, named: Named, gap_minutes: float) -> dict[str, Any]:
    """All about one trajectory."""
    told: dict[str, Any] = {"cell": mark(cell), "name": named.name, "views": len(named.targets)}
    out = told["out_of_reach"] = refereed(cell, named)
    begin = time.process_time()
    try:
        plan = plan_motion(cell, MOTION, named.targets, roll_free=named.roll_free)
    except TrajectoryError as error:
        told["plan_s"] = round(time.process_time() - begin, 1)
        told["problems"] = problems = list(error.problems)
        gap = re.match(r"from view (\d+) to view (\d+): no path", problems[0])
        if not out and gap and gap_minutes:
            a, b = (named.targets[int(view)] for view in gap.groups())
            search = Roadmap(cell, MOTION.clearance_mm, MOTION.ik)
            told["connected"] = search.connects(a, b, named.roll_free, 60 * gap_minutes)
            told["gap_minutes"] = gap_minutes
        return told
    told["plan_s"] = round(time.process_time() - begin, 1)
    told["waypoints"] = len(plan.time_s)
    return told | simulated(cell, plan)


def told_in(results: Path) -> list[dict[str, Any]]:
    """What a file of results holds; an empty one is made ready."""
    results.parent.mkdir(parents=True, exist_ok=True)
    results.touch()
    return [json.loads(line) for line in results.read_text().splitlines()]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument(
        "--scenario", type=Path, help="take the cell of this scenario, not the default"
    )
    parser.add_argument("--gap-minutes", type=float, default=10.0)
    parser.add_argument("--results", type=Path, default=RESULTS)
    args = parser.parse_args()
    cell = cell_of(args.scenario)
    done = {told["name"]: told for told in told_in(args.results) if told["cell"] == mark(cell)}
    for named in sixty(PANEL):
        if named.name not in done:
            done[named.name] = told = figures(cell, named, args.gap_minutes)
            with args.results.open("a") as file:
                file.write(json.dumps(told) + "\n")
            print(json.dumps(told), flush=True)
    print(json.dumps(summary(list(done.values())), indent=2))


def summary(all_told: list[dict[str, Any]]) -> dict[str, Any]:
    reachable = [told for told in all_told if not told["out_of_reach"]]
    exposed = [told for told in reachable if told.get("exposed") == told["views"]]
    ratios = [abs(t["simulated_s"] / t["predicted_s"] - 1) for t in exposed]
    return {
        "trajectories": len(all_told),
        "every_view_reachable": len(reachable),
        "planned_and_all_exposed": len(exposed),
        "gaps": [t for t in reachable if t not in exposed],
        "least_clearance_mm": min(t["clearance_every_step_mm"] for t in exposed),
        "joints_off_deg": max(t["joints_off_deg"] for t in exposed),
        "predicted_against_simulated": max(ratios),
        "refused_with_their_views": sum("problems" in t for t in all_told if t["out_of_reach"]),
    }


if __name__ == "__main__":
    main()
