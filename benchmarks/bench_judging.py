"""Judging of two volumes by an older checkout against this one, in pairs of processes.

python benchmarks/bench_judging.py OLDER_CHECKOUT --pairs 2

Each process builds the paper's specimen with a titanium ball, its truth and two volumes, and judges
both with all kinds of figures. Which checkout goes first alternates. Printed: processor seconds of
each stage, medians over the pairs, with new / old; the peak memory; and the largest difference of
each figure. Figures that only one of the two has are listed.
"""

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parents[1]
STAGES = "truth", "first volume", "second volume"

RUNNER = """
import json, math, resource, sys, time
from types import SimpleNamespace
import numpy as np
from scipy import ndimage
from twinct.core.threads import limit_threads
from twinct.recon.volume import Volume
from twinct.runs import judge, truth_of
from twinct.scan import SimulationBuilder
from twinct.scenario import load_scenario
from twinct.trajectory import commanded_views

voxels, threads = int(sys.argv[1]), int(sys.argv[2])
limit_threads(threads)
scenario = load_scenario("scenarios/paper.yaml", [
    f"reconstruction.grid={{voxels: {voxels}, voxel_mm: {0.31 * 512 / voxels}}}",
    "xray.engine=mesh",
    "specimen.parts=[{name: skull, shape: {kind: skull}, material: bone}, {name: ball, "
    "shape: {kind: sphere, radius_mm: 6}, position_mm: [10, 0, 20], material: titanium}]",
    "specimen.reference=skull",
    "evaluation={regions: [{name: brain, shape: {kind: box, size_mm: [30, 30, 20]}, "
    "position_mm: [0, -30, 20]}, {name: side, shape: {kind: sphere, radius_mm: 8}, "
    "position_mm: [-25, 0, 10]}], contrasts: [{region: side, against: brain}], "
    "nps: [{region: brain}], mtf: [{at: ball}], streaks: [{part: ball}]}",
])
views = commanded_views(scenario.trajectory, scenario.detector.panel)
builder = SimulationBuilder(scenario)
# What judging needs of a scan.
scan = SimpleNamespace(
    scenario=scenario,
    stands=builder.specimen.world_from_specimen,
    relative=SimpleNamespace(geometry=lambda panel: views),
)
told = {}

def timed(name, work):
    start = time.process_time()
    found = work()
    told[name] = time.process_time() - start
    return found

truth = timed("truth", lambda: truth_of(scan, builder))
grid, mu = truth.grid, truth.mu_reference
figures = {}
for name, sigma, seed in (("first volume", 1.2, 0), ("second volume", 0.8, 1)):
    array, random = ndimage.gaussian_filter(truth.volume, sigma), np.random.default_rng(seed)
    for plane in array:
        plane += 0.05 * mu * random.standard_normal(plane.shape, dtype=np.float32)
    volume = Volume(array, grid)
    figures[name] = timed(name, lambda: judge(scan, volume, truth, builder.specimen)).as_dict()
told["peak GB"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6

def plain(value):
    if isinstance(value, dict):
        return {key: plain(inner) for key, inner in value.items()}
    return None if np.ndim(value) else float(value)

print(json.dumps({"seconds": told, "figures": plain(figures)}))
"""


def run(checkout, voxels, threads):
    """Return seconds and flat figures of a checkout, from a process of its own."""
    done = subprocess.run(
        [sys.executable, "-c", RUNNER, str(voxels), str(threads)],
        stdout=subprocess.PIPE,
        text=True,
        check=True,
        cwd=checkout,
        env=os.environ | {"PYTHONPATH": str(Path(checkout) / "src")},
    )
    told = json.loads(done.stdout)
    return told["seconds"], flat(told["figures"])


def flat(told, key=""):
    found = {}
    for name, value in told.items():
        inner = f"{key}.{name}" if key else name
        found |= flat(value, inner) if isinstance(value, dict) else {inner: value}
    return {name: value for name, value in found.items() if value is not None}


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("older", type=Path)
    parser.add_argument("--pairs", type=int, default=2)
    parser.add_argument("--voxels", type=int, default=512)
    parser.add_argument("--threads", type=int, default=2)
    arguments = parser.parse_args()
    checkouts = {"old": arguments.older.resolve(), "new": HERE}
    seconds, figures = {"old": [], "new": []}, {}
    for pair in range(arguments.pairs):
        for which in ("old", "new") if pair % 2 == 0 else ("new", "old"):
            told, figures[which] = run(checkouts[which], arguments.voxels, arguments.threads)
            seconds[which].append(told)
            print(which, {name: round(value, 2) for name, value in told.items()}, flush=True)
    for stage in STAGES:
        old, new = (np.median([one[stage] for one in seconds[of]]) for of in ("old", "new"))
        print(f"{stage}: {old:.1f} to {new:.1f} s of processor, {new / old:.3f} x")
    old, new = figures["old"], figures["new"]
    worst = {
        name: abs(new[name] - old[name]) / max(abs(old[name]), 1e-12)
        for name in old.keys() & new.keys()
        if np.isfinite(old[name]) or np.isfinite(new[name])
    }
    for name in sorted(worst, key=lambda name: -worst[name]):
        print(f"{name:60} {old[name]:.9g} {new[name]:.9g} {worst[name]:.1e}")
    print("only old:", sorted(old.keys() - new.keys()))
    print("only new:", sorted(new.keys() - old.keys()))


if __name__ == "__main__":
    main()
