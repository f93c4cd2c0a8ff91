"""Measure scans that end early: views saved, error at the end, and whether the promise holds.

Random objects of nine families, that nobody tuned on, on a circle and all over the sphere: each is
taken in sweeps until twice as many views change the volume by less than ``change_rel``. Reported
are the views, the error relative to that of all views, and whether doubling the views after the end
does change the volume by less. The baseline is the fixed number of views with the 95th percentile
of the errors of the scans that end early: a plan for an unknown object needs it.

    python benchmarks/bench_until.py [--seeds 400 403] [--change 0.05] [--out FILE]
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from random_objects import FAMILIES, random_object
from random_scans import SPAN_MM, RandomScan, _measured

from twinct.evaluation.region_voxels import whole
from twinct.geometry import Panel, ScanGeometry, VolumeGrid, fibonacci_directions
from twinct.recon import Projector, fast
from twinct.runs.early_end import relative_change
from twinct.trajectory import ends_of_sweeps, in_sweeps

VIEWS, FIRST, SIZE = 384, 24, 48
PHOTONS = 1e5
SOD_MM, SDD_MM = 400.0, 640.0
DENSEST = 2.5
"""Line integral through the object, 99.5th percentile."""

PATHS = ("circle", "sphere")


@dataclass(frozen=True)
class Course:
    """Errors and changes of a scan after each sweep."""

    name: str
    views: tuple[int, ...]
    errors: tuple[float, ...]
    changes: tuple[float, ...]

    def end(self, change_rel: float) -> int:
        """Return the number of the sweep with which the scan ends."""
        small = (k for k in range(2, len(self.views) - 1) if self.changes[k] < change_rel)
        return next(small, len(self.views) - 1)


def views_on(path: str, panel: Panel, rng: np.random.Generator) -> ScanGeometry:
    """Return views on a circle or all over the sphere, from a random start."""
    turn = rng.uniform(0, 2 * np.pi)
    if path == "circle":
        angle = turn + 2 * np.pi * np.arange(VIEWS) / VIEWS
        out = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    else:
        out = fibonacci_directions(VIEWS)
        angle = np.arctan2(out[:, 1], out[:, 0]) + turn
        flat = np.hypot(out[:, 0], out[:, 1])
        out = np.stack([flat * np.cos(angle), flat * np.sin(angle), out[:, 2]], axis=1)
    u = np.stack([-np.sin(angle), np.cos(angle), np.zeros(VIEWS)], axis=1)
    return ScanGeometry(SOD_MM * out, (SOD_MM - SDD_MM) * out, u, np.cross(out, u), panel)


def course(seed: int, family: str, path: str) -> Course:
    """Take and reconstruct one scan, sweep by sweep."""
    rng = np.random.default_rng([seed, 64])
    made = random_object(rng, family)
    grid, pixels = VolumeGrid([SIZE] * 3, 1.05 * SPAN_MM / SIZE), round(1.1 * SIZE)
    wide = 1.05 * SPAN_MM * SDD_MM / np.sqrt(SOD_MM**2 - (SPAN_MM / 2) ** 2)
    panel = Panel(pixels, pixels, wide / pixels, wide / pixels)
    A = Projector(views_on(path, panel, rng), grid)
    p, truth, mu = _measured(rng, made, A, DENSEST, PHOTONS)
    scan = RandomScan(seed, family, path, PHOTONS, A, p, truth, mu)
    order, ends = in_sweeps(A.geometry, FIRST), ends_of_sweeps(VIEWS, FIRST)
    everywhere = whole(np.ones(grid.shape, np.bool_))
    volumes: list[np.ndarray] = []
    changes: list[float] = []
    for sweep, end in enumerate(ends):
        taken = order[:end]
        volumes.append(fast(A[taken], p[taken], photons=PHOTONS).array)
        half = volumes[sweep - 2] if sweep > 1 else None
        changes.append(np.inf if half is None else relative_change(half, volumes[-1], everywhere))
    errors = tuple(scan.error(volume) for volume in volumes)
    return Course(f"{family} {path} {seed}", ends, errors, tuple(changes))


def summary(courses: list[Course], change_rel: float) -> str:
    """Return a line of results at one criterion."""
    ends = [one.end(change_rel) for one in courses]
    views = np.array([one.views[k] for one, k in zip(courses, ends, strict=True)])
    ratio = np.array([one.errors[k] / one.errors[-1] for one, k in zip(courses, ends, strict=True)])
    kept = [
        one.changes[k + 2] < change_rel
        for one, k in zip(courses, ends, strict=True)
        if k + 2 < len(one.views)
    ]
    all_ratios = np.array([np.array(one.errors) / one.errors[-1] for one in courses])
    percentiles = np.percentile(all_ratios, 95, axis=0)
    bound = float(np.percentile(ratio, 95))
    falling = np.minimum.accumulate(percentiles)
    fixed = float(np.exp(np.interp(-bound, -falling, np.log(courses[0].views))))
    return (
        f"change_rel {change_rel:g}: {len(courses)} scans, views mean {views.mean():.0f} "
        f"({views.min()} to {views.max()}), error / error of all {VIEWS} views: median "
        f"{np.median(ratio):.3f}, 95 % {bound:.3f}, largest {ratio.max():.3f}; twice the views "
        f"change less in {sum(kept)} of {len(kept)}; a fixed number with this 95 %: {fixed:.0f}, "
        f"views saved {100 * (1 - views.mean() / fixed):.0f} %"
    )


def main() -> None:
    """Measure, and print a line for each scan and for each criterion."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, nargs=2, default=(400, 403), help="first, end")
    parser.add_argument("--change", type=float, nargs="+", default=(0.15, 0.1, 0.05))
    parser.add_argument("--out", type=Path, help="JSON lines of all scans")
    args = parser.parse_args()
    courses: list[Course] = []
    for seed in range(*args.seeds):
        for family in FAMILIES:
            for path in PATHS:
                courses.append(course(seed, family, path))
                print(courses[-1].name, *(f"{e:.4f}" for e in courses[-1].errors), flush=True)
                if args.out:
                    with args.out.open("a") as file:
                        file.write(json.dumps(vars(courses[-1])) + "\n")
    for change_rel in args.change:
        print(summary(courses, change_rel))


if __name__ == "__main__":
    main()
