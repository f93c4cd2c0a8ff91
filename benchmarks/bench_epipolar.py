"""Whether planes that pairs of views share bring the geometry near enough, before any volume.

    python benchmarks/bench_epipolar.py [--panel paper whole] [--larger 1 2 4 8] [--seeds 1]
                                        [--errors white] [--factor 4] [--out DIR]

The scan of bench_selfcal.py, beyond whose panel the skull reaches nearly everywhere (paper), and
one with a panel of 560 x 560 mm that holds all of it (whole). Errors are those of
bench_selfcal.py, white ones also ``--larger`` times as large, the prior with them.

Told of each case: where points about the middle project, RMS, in pixels of 1 mm at any factor, the
seven modes taken out: as believed, after epipolar consistency (start), after self-calibration from
what was believed (self), from the start in all of its rounds (both), and in those that it has with
a start (fine).
One JSON line a case in DIR; those that are there are not done again.
"""

from __future__ import annotations

import argparse
import json
import pickle
import time
from pathlib import Path

import numpy as np
from bench_selfcal import ALIKE, SIGMA, SIGMA_DEG, SIGMA_MM, VIEWS, believed_of, scenario_of

from twinct.calibration import PosePrior, aligned, epipolar_consistent, moved, self_calibrated
from twinct.calibration.consistency import FROM_START, ROUNDS
from twinct.geometry import ScanGeometry
from twinct.runs import simulate
from twinct.scan import line_integrals
from twinct.scenario import Scenario, parse_scenario
from twinct.uncertainty.correlation import view_normals

WHOLE_MM = 560
POINTS = 30.0 * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, -1, -1]])


def scan_of(panel: str, factor: int) -> Scenario:
    """The scan of bench_selfcal, or the same with a panel that holds the skull."""
    scenario = scenario_of(factor)
    if panel == "paper":
        return scenario
    told = scenario.model_dump(mode="json", exclude_unset=True)
    told["detector"] |= {"columns": WHOLE_MM // factor, "rows": WHOLE_MM // factor}
    return parse_scenario(told)


def scanned(scenario: Scenario, kept: Path):
    """Line integrals and executed geometry; made once."""
    if not kept.exists():
        scan = simulate(scenario)
        executed = scan.executed.geometry(scenario.detector.panel)
        kept.write_bytes(pickle.dumps((line_integrals(scan.transmission), executed)))
    return pickle.loads(kept.read_bytes())


def wrong(executed: ScanGeometry, errors: str, larger: float, seed: int):
    """What is believed, what is known of its errors, and what may have moved."""
    if errors != "white":
        prior = PosePrior(3.0, 2.0, 15.0) if errors == "nod" else PosePrior(correlation_views=ALIKE)
        return believed_of(executed, errors, seed), prior, "patient" if errors == "nod" else "arms"
    normals = np.array([view_normals(seed, "selfcal", view, 9, 0.0) for view in range(VIEWS)])
    prior = PosePrior(larger * SIGMA_MM, larger * SIGMA_DEG)
    return moved(executed, larger * SIGMA * normals), prior, "arms"


def off_px(geometry: ScanGeometry, executed: ScanGeometry, factor: int) -> float:
    """Where points project, from the executed, seven modes taken out, in pixels of 1 mm."""
    return round(aligned(geometry, executed, POINTS).after_px * factor, 4)


def main() -> None:
    """Each case that is not there yet."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--panel", nargs="+", choices=("paper", "whole"), default=("paper", "whole")
    )
    parser.add_argument("--larger", nargs="+", type=float, default=(1, 2, 4, 8))
    parser.add_argument("--seeds", nargs="+", type=int, default=(1,))
    parser.add_argument(
        "--errors", nargs="+", choices=("white", "smooth", "nod"), default=("white",)
    )
    parser.add_argument("--factor", type=int, default=4)
    parser.add_argument("--out", type=Path, default=Path("out/epipolar"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    factor = options.factor
    lines = options.out / f"cases{factor}.jsonl"
    told = [json.loads(line) for line in lines.read_text().splitlines()] if lines.exists() else []
    done = {(one["panel"], one["errors"], one["larger"], one["seed"]) for one in told}
    cases = [
        (panel, errors, float(larger), seed)
        for panel in options.panel
        for errors in options.errors
        for larger in (options.larger if errors == "white" else (1,))
        for seed in options.seeds
    ]
    for panel, errors, larger, seed in cases:
        if (panel, errors, larger, seed) in done:
            continue
        scenario = scan_of(panel, factor)
        p, executed = scanned(scenario, options.out / f"{panel}{factor}.pkl")
        grid = scenario.reconstruction.volume_grid
        believed, prior, what = wrong(executed, errors, larger, seed)
        case: dict = {"panel": panel, "errors": errors, "larger": larger, "seed": seed}
        case |= {"believed px": off_px(believed, executed, factor)}
        since = time.perf_counter()
        start = epipolar_consistent(p, believed, grid, prior, what=what)
        case |= {"start s": round(time.perf_counter() - since, 1)}
        case |= {"start px": off_px(start.geometry, executed, factor)}
        case["complete"] = round(float(start.complete.sum() / start.planes.sum()), 3)
        case["problems"] = len(start.problems)
        for name, rounds, change in (
            ("self", ROUNDS, None),
            ("both", ROUNDS, start.change),
            ("fine", FROM_START, start.change),
        ):
            since = time.perf_counter()
            found = self_calibrated(
                p, believed, grid, prior, what=what, rounds=rounds, start=change
            )
            case |= {f"{name} s": round(time.perf_counter() - since, 1)}
            case |= {f"{name} px": off_px(found.geometry, executed, factor)}
        with lines.open("a") as stream:
            stream.write(json.dumps(case) + "\n")
        print(json.dumps(case), flush=True)


if __name__ == "__main__":
    main()
