"""How well a few balls at unknown places on a skull tell the geometry of their scan, through gVXR.

python benchmarks/bench_balls.py [--views 60] [--seeds 1 2 3]

`scenarios/skull_balls.yaml` on a gantry, so that source and panel stand where they are told; 1e4
photons a pixel. What is believed is off by sigma 0.5 mm and 0.2 deg, independent for each axis and
view. Judged where points within 60 mm of the middle project: moved as a whole by the seven modes
that no image shows, and as they are.
"""

import argparse
import time
from pathlib import Path

import numpy as np

from twinct.calibration import PosePrior, aligned, moved, online_calibrated
from twinct.runs import simulate
from twinct.scenario import load_scenario

SCENARIO = Path(__file__).parents[1] / "scenarios" / "skull_balls.yaml"
SIGMA_MM, SIGMA_DEG = 0.5, 0.2
PHOTONS = 1e4
RADIUS_MM = 1.5


def scan_of(views):
    """The scan, and its scenario."""
    keys = ["cell={kind: gantry}", "motion.scheme=reactive", f"trajectory.views={views}"]
    base = load_scenario(SCENARIO, keys)
    panel = base.detector.panel
    # The scenario's path is of one SDD: 600 mm.
    at_a_metre = PHOTONS / (panel.pitch_u * panel.pitch_v) * 0.6**2
    keys.append(f"source.photons_per_mm2_mas={at_a_metre / base.source.mas}")
    keys.append("detector.noise={kind: quantum}")
    scenario = load_scenario(SCENARIO, keys)
    return scenario, simulate(scenario)


def main():
    """Each seed's errors on the same images."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--views", type=int, default=60)
    parser.add_argument("--seeds", nargs="+", type=int, default=(1, 2, 3))
    options = parser.parse_args()
    scenario, scan = scan_of(options.views)
    executed = scan.executed.geometry(scenario.detector.panel)
    truth = np.array([part.specimen_from_part.position for part in scenario.specimen.parts[1:]])
    truth = scenario.specimen.world_from_specimen.apply(truth)
    points = np.random.default_rng(0).normal(size=(200, 3))
    points *= (
        60
        * np.linspace(0.01, 1, 200)[:, None] ** (1 / 3)
        / np.linalg.norm(points, axis=1, keepdims=True)
    )
    sigma = np.array([SIGMA_MM] * 6 + [np.radians(SIGMA_DEG)] * 3)
    for seed in options.seeds:
        rng = np.random.default_rng([3, seed])
        believed = moved(executed, sigma * rng.normal(size=(options.views, 9)))
        start = time.process_time()
        found = online_calibrated(
            scan.transmission, believed, RADIUS_MM, PosePrior(SIGMA_MM, SIGMA_DEG)
        )
        seconds = time.process_time() - start
        far = np.linalg.norm(found.bundle.balls[:, None] - truth, axis=2).min(axis=1)
        before, after = (aligned(one, executed, points) for one in (believed, found.geometry))
        print(
            f"seed {seed}: {len(far)} balls of {len(truth)}, the furthest {far.max():.2f} mm from "
            f"one; {int(found.bundle.outliers.sum())} outliers, {len(found.problems)} views "
            f"failed; shadows off by {found.rms_px:.4f} px; points of the region, RMS: "
            f"{before.after_px:.3f} to {after.after_px:.3f} px ({before.before_px:.3f} to "
            f"{after.before_px:.3f} px without aligning the whole; scale {after.scale:.5f}); "
            f"{seconds:.0f} s of one core",
            flush=True,
        )
        for view, problem in found.problems.items():
            print(f"view {view}: {problem}", flush=True)


if __name__ == "__main__":
    main()
