"""Random exposures, frame times, speeds, triggers and views: what is planned is also taken.

    python benchmarks/bench_pace.py                   # 300 settings
    python benchmarks/bench_pace.py --count 60 --seed 1

For each setting, the arms of the default cell are planned for an arc of a small sphere. What the
plan accepts is simulated to the last view. Told are the settings that were planned, those of which
every view was taken, the smallest time from trigger to trigger as a share of what exposure and
detector need, and how a plan with the least time between all views compares with that time. The
arms of the paper's cell move; images are not made, as they do not depend on it.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import Counter
from typing import Any

import numpy as np

from twinct.core.errors import InputError, TargetRefusedError, TrajectoryError
from twinct.robots.motion import RobotSimulation
from twinct.scan import SimulationBuilder
from twinct.scenario import load_scenario

BASE = {
    "trajectory": {"kind": "arc", "views": 3},
    "specimen": {
        "parts": [{"shape": {"kind": "sphere", "radius_mm": 50, "mesh_resolution_mm": 10}}]
    },
}


def either(rng: np.random.Generator, *values: float | None) -> float | None:
    """Return one of some values."""
    return values[int(rng.integers(len(values)))]


def drawn(rng: np.random.Generator) -> dict[str, Any]:
    """Return random settings, by key of the scenario."""
    views = int(rng.integers(3, 31))
    return {
        "trajectory.views": views,
        "trajectory.longitude_range_deg": float(np.round(views * 10 ** rng.uniform(-1, 0.5), 2)),
        "source.exposure_ms": float(np.round(10 ** rng.uniform(0, 2.5), 1)),
        "source.motion_samples": int(rng.choice([1, 2, 4])),
        "detector.frame_ms": either(rng, None, float(np.round(10 ** rng.uniform(0.5, 2.5), 1))),
        "motion.trigger": str(rng.choice(["on_entry", "on_entry", "settled"])),
        "motion.tool_speed_mm_s": either(rng, None, float(np.round(10 ** rng.uniform(1.3, 3), 1))),
        "motion.tolerance_mm": float(rng.choice([0.3, 1.0, 1.0])),
        "cell.timestep_ms": float(rng.choice([1.0, 2.0, 2.0, 4.0])),
    }


def taken(builder: SimulationBuilder) -> tuple[float, str]:
    """Simulate a scan; return the least time between triggers, and why a view was missed, or ""."""
    robots, times = builder.robots(), list[float]()
    assert isinstance(robots, RobotSimulation)
    for view, target in enumerate(builder.targets):
        try:
            reached = robots.move(view, target)
        except TargetRefusedError as error:
            return 0.0, str(error)
        times.append(reached.time_s - reached.since_middle_s - builder.shutter.middle_s)
    return float(np.diff(times).min()), ""


def main(count: int, seed: int) -> int:
    rng, counts, shares, missed = np.random.default_rng(seed), Counter[str](), [], []
    begun = time.process_time()
    for number in range(count):
        settings = drawn(rng)
        counts["asked"] += 1
        try:
            builder = SimulationBuilder(load_scenario(BASE, settings))
            _ = builder.plan
        except (InputError, TrajectoryError) as error:
            counts[f"refused: {str(error)[:80]}"] += 1
            continue
        counts["planned"] += 1
        least_s, why = taken(builder)
        needed_s = max(builder.shutter.exposure_s, builder.shutter.frame_s)
        if why:
            missed.append({"number": number, "settings": settings, "why": why})
            continue
        counts["taken"] += 1
        shares.append(least_s / needed_s)
    told = dict(counts) | {"least interval, share": min(shares, default=0.0), "missed": missed}
    print(json.dumps(told | {"processor_s": round(time.process_time() - begun, 1)}, indent=1))
    fine = counts["taken"] == counts["planned"] >= count / 2 and min(shares) >= 1 - 1e-6
    return 0 if fine else 1


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Random settings of time")
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    sys.exit(main(args.count, args.seed))
