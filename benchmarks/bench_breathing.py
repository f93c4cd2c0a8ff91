"""Error where a breathing patient moves: at rest, ignored, compensated, and believed 20 % wrong.

    python benchmarks/bench_breathing.py [--seeds 5] [--views 48] [--algorithms sart] [--save FILE]

The built-in trunk of `scenarios/patient_breathing.yaml`, smaller, turned against the lattice of the
reconstruction and in voxels half as large as its, with another phantom and another
course of breathing for each seed. Prints the error of each case, relative to the attenuation of the
reference, and the share of what the motion costs that compensation wins back.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from twinct.runs import reconstruct, simulate
from twinct.runs.reporting import evaluate
from twinct.runs.truth import truth_of
from twinct.scan import SimulationBuilder
from twinct.scenario import load_scenario

SCENARIO = Path(__file__).parents[1] / "scenarios" / "patient_breathing.yaml"
SMALLER = (
    "specimen.parts.0.shape.voxel_mm=2.5",
    "specimen.rotation_deg=[4, -3, 7]",
    "detector={columns: 88, rows: 64, pixel_pitch_mm: 6.5}",
)
CASES = {
    "ignored": {"compensate": False},
    "compensated": {},
    "amplitude 20 % too small": {"amplitude_rel": 0.8},
    "amplitude 20 % too large": {"amplitude_rel": 1.2},
}


def measure(seed: int, views: int, algorithm: str) -> dict[str, float]:
    keys = [
        *SMALLER,
        f"specimen.parts.0.shape.seed={seed}",
        f"specimen.motion.seed={seed}",
        f"trajectory.views={views}",
        f"cell.view_s={25 / views}",
        f"reconstruction.algorithm={algorithm}",
    ]
    scenario = load_scenario(SCENARIO, keys)
    still = load_scenario(SCENARIO, [*keys, "specimen.motion=null", "reconstruction.motion=null"])
    moving, resting = simulate(scenario), simulate(still)
    truth = truth_of(moving, SimulationBuilder(scenario))
    found: dict[str, float] = {}
    for case, keys_of_case in {"at rest": None, **CASES}.items():
        scan = resting if keys_of_case is None else moving
        more = {} if keys_of_case is None else {"motion": keys_of_case}
        volume = reconstruct(scan, **more)
        # The same voxels and the same truth for all cases.
        judged = evaluate(scan.with_settings(scenario), volume, truth)
        found[case] = judged.as_dict()["rmse_moving_rel"]
    cost = found["ignored"] - found["at rest"]
    for case in list(CASES)[1:]:
        found[f"won back, {case}"] = (found["ignored"] - found[case]) / cost
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--views", type=int, default=48)
    parser.add_argument("--algorithms", nargs="+", default=["sart"])
    parser.add_argument("--save", help="write the figures as JSON")
    args = parser.parse_args()
    told: dict[str, list[dict[str, float]]] = {}
    for name in args.algorithms:
        for seed in range(1, args.seeds + 1):
            told.setdefault(name, []).append(measure(seed, args.views, name))
            print(
                name, seed, {k: f"{100 * v:.1f} %" for k, v in told[name][-1].items()}, flush=True
            )
        for case in told[name][0]:
            values = 100 * np.array([one[case] for one in told[name]])
            print(
                f"{name}: {case}: {values.mean():.1f} % ({values.min():.1f} to {values.max():.1f})"
            )
    if args.save:
        Path(args.save).write_text(json.dumps(told, indent=2), encoding="utf-8")


if __name__ == "__main__":
    main()
