"""Processor seconds and memory of the figures that every run has, at the paper's size."""

from __future__ import annotations

import argparse
import resource
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage

from twinct.core.threads import limit_threads
from twinct.evaluation import (
    edge_width,
    image_figures,
    region_depth,
    region_of_interest,
    rmse_by_depth,
)
from twinct.scenario import load_scenario
from twinct.specimen import build_specimen
from twinct.trajectory import commanded_views

PAPER = Path(__file__).parents[1] / "scenarios" / "paper.yaml"
ENERGY_KEV = 80.0


def peak_gb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6


def timed(name: str, work: Callable[[], Any]) -> Any:
    wall, processor = time.perf_counter(), time.process_time()
    found = work()
    wall, processor = time.perf_counter() - wall, time.process_time() - processor
    print(f"{name:24} {processor:6.1f} s of processor, {wall:6.1f} s, peak {peak_gb():.2f} GB")
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--voxels", type=int, default=512)
    parser.add_argument("--threads", type=int, default=1)
    arguments = parser.parse_args()
    limit_threads(arguments.threads)
    voxel = 0.31 * 512 / arguments.voxels
    keys = [f"reconstruction.grid={{voxels: {arguments.voxels}, voxel_mm: {voxel}}}"]
    scenario = load_scenario(PAPER, keys)
    specimen, grid = build_specimen(scenario.specimen), scenario.reconstruction.grid.volume_grid
    views = commanded_views(scenario.trajectory, scenario.detector.panel)
    truth, mu = specimen.truth(grid, ENERGY_KEV), specimen.reference_mu(ENERGY_KEV)
    region = region_of_interest(views, grid)
    volume, random = ndimage.gaussian_filter(truth, 1.2), np.random.default_rng(0)
    for plane in volume:
        plane += 0.05 * mu * random.standard_normal(plane.shape, dtype=np.float32)
    print(f"{arguments.voxels}^3, {len(views)} views; before: peak {peak_gb():.2f} GB")
    print(timed("image figures", lambda: image_figures(volume, truth, region, mu, grid)))
    depth = timed("depth", lambda: region_depth(views, grid))
    print(timed("error by depth", lambda: rmse_by_depth(volume, truth, region, depth, mu)))
    found = timed("edge width", lambda: edge_width(volume, truth, region, mu, grid))
    blur = float(np.hypot(1.2, np.sqrt(1 / 12)) * voxel)
    print(f"edge width {found:.3f} mm; of the blur, voxel's mean included: {2.563 * blur:.3f} mm")


if __name__ == "__main__":
    main()
