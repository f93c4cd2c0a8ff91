"""Planned views run over ROS 2: are all reached, how near, how long beside the equidistant path.

    python benchmarks/bench_planned_runs.py out/planned_dose/views_*.csv --out out/planned_runs

Each file of views (``twinct plan`` and the other benchmarks of planning write them) is toured by
the arms of the default cell about the head, shortest way, panel's roll free, every exposure
settled; so is the paper's equidistant path with as many views, in its own order. Images are small
and nothing is made of them. Clearance is the smallest gap at any step of the simulation; the
scan's time is that of its last exposure, simulated. Ends with 1 if a view is missing, a gap is
below 10 mm, or a tour takes more than twice the path's time. Finished runs are kept in the folder.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path

import numpy as np

from twinct.runs import load_scan

ROOT = Path(__file__).parents[1]
GAP_MM, TIMES = 10.0, 2.0
KEYS = {
    "cell": "{kind: arms}",
    "motion": "{detector_roll: free, trigger: settled}",
    "detector": "{columns: 64, rows: 48, pixel_pitch_mm: 5}",
    "reconstruction": "{algorithm: sart, iterations: 1, grid: {voxels: 16, voxel_mm: 9}}",
}


def run(out: Path, scenario: Path, **keys: str) -> tuple[int, float, float]:
    """Views reached, smallest gap in mm, seconds of a scan over ROS 2."""
    if not (out / "report.html").exists():
        words = [f"--set={key.replace('__', '.')}={value}" for key, value in (KEYS | keys).items()]
        command = [sys.executable, "-m", "twinct", "run", str(scenario), "--out", str(out)]
        again = ["--resume"] if out.exists() else []
        done = subprocess.run([*command, *words, *again], capture_output=True, text=True)
        if done.returncode:
            raise SystemExit(f"{out}: {done.stdout[-2000:]}{done.stderr[-2000:]}")
    scan = load_scan(out)
    images = np.isfinite(scan.transmission).all(axis=(1, 2))
    return int(images.sum()), float(scan.clearance_mm.min()), float(scan.simulated_s.max())


def main() -> None:
    """All files of views."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("views", type=Path, nargs="+")
    parser.add_argument("--scenario", type=Path, default=ROOT / "scenarios" / "head.yaml")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    paths: dict[int, float] = {}
    missed = False
    for file in options.views:
        count = sum(1 for line in file.read_text().splitlines() if line[:1] in "-0123456789")
        if count not in paths:
            number, gap, paths[count] = run(
                options.out / f"equidistant_{count}", options.scenario, trajectory__views=str(count)
            )
            print(f"equidistant: {number} of {count} views, {gap:.1f} mm, {paths[count]:.1f} s")
        trajectory = json.dumps({"kind": "file", "path": str(file.resolve())})
        number, gap, seconds = run(
            options.out / f"{file.parent.name}_{file.stem}",
            options.scenario,
            trajectory=trajectory,
            motion__order="shortest",
        )
        share = seconds / paths[count]
        print(
            f"{file}: {number} of {count} views, {gap:.1f} mm, {seconds:.1f} s, {share:.2f} x the "
            "equidistant path's",
            flush=True,
        )
        missed = missed or number < count or gap < GAP_MM or share > TIMES
    if missed:
        raise SystemExit("not reached: all views, 10 mm, twice the equidistant path's time")


if __name__ == "__main__":
    main()
