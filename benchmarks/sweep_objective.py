"""Sweeps over the constants of ``fast``, on the tuning scans in 48^3 voxels.

python benchmarks/sweep_objective.py --out out/objective

Printed for each value: the error relative to that with the value of the code, over the scans:
median, 5th and 95th percentile; and the mean number of passes. ``--only OF_NOISE SUBSETS`` chooses.
"""

from __future__ import annotations

import argparse
from importlib import import_module
from pathlib import Path
from unittest import mock

import numpy as np
from random_scans import random_scan

from twinct.core.threads import let_idle_threads_sleep
from twinct.recon import fast
from twinct.recon.fast import TOLERANCE

SWEEPS = {
    "OF_COARSER": ("ray_weights.OF_COARSER", (0.25, 0.35, 0.7, 1.0)),
    "OF_NOISE": ("strength.OF_NOISE", (0.4, 0.6, 1.1, 1.6)),
    "EVIDENCE": ("strength.EVIDENCE", (0.05, 0.1, 0.2, 0.3)),
    "PARTS": ("strength.PARTS", (5, 7, 14, 20)),
    "SUBSETS": ("ordered_subsets.SUBSETS", (5, 7, 14, 20)),
    "DUAL_STEPS": ("ordered_subsets.DUAL_STEPS", (1, 2, 5, 10)),
    "TOLERANCE": (None, (0.005, 0.01, 0.03, 0.05)),
    "RELAXATION": ("fast.RELAXATION", (0.75, 1.0, 1.25, 1.75)),
    "COARSE_PASSES": ("fast.COARSE_PASSES", (1, 3, 4)),
}


def main() -> None:
    """Sweep."""
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n", maxsplit=1)[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--scans", type=int, default=19)
    parser.add_argument("--voxels", type=int, default=48)
    parser.add_argument("--only", nargs="+", choices=tuple(SWEEPS), default=list(SWEEPS))
    given = parser.parse_args()
    let_idle_threads_sleep()
    scans = [random_scan(seed, given.voxels, given.out / "scans") for seed in range(given.scans)]

    def errors(tolerance: float = TOLERANCE) -> tuple[np.ndarray, float]:
        volumes = [
            fast(scan.A, scan.p, photons=scan.photons, tolerance=tolerance) for scan in scans
        ]
        found = [scan.error(volume.array) for scan, volume in zip(scans, volumes, strict=True)]
        return np.array(found), float(np.mean([volume.extras["passes"] for volume in volumes]))

    usual, passes = errors()
    print(f"{len(scans)} scans in {given.voxels}^3 voxels: {passes:.1f} passes")
    for name in given.only:
        place, values = SWEEPS[name]
        for value in values:
            if place is None:
                made, passes = errors(tolerance=value)
            else:
                file, constant = place.split(".")
                with mock.patch.object(import_module(f"twinct.recon.{file}"), constant, value):
                    made, passes = errors()
            low, middle, high = np.percentile(made / usual, [5, 50, 95])
            text = f"{middle:.3f} (5th to 95th percentile: {low:.3f} to {high:.3f})"
            print(f"{name} {value:g}: {text}, {passes:.1f} passes", flush=True)


if __name__ == "__main__":
    main()
