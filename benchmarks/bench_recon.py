"""SART here and RTK's, view by view in alternation, on the paper's trajectory.

python benchmarks/bench_recon.py --sizes 128 256 512 --views-512 2 --json recon.json

Views per size: --views, except 512. Difference: RMS of the two volumes within 3 mm of the bone of
an ellipsoid shell (0.043/mm), relative to it, where every view sees it. Both get the same views in
the same order; the line integrals are analytic, made by neither.
"""

import argparse
import json
import resource
import time

import numpy as np
from scipy.ndimage import binary_dilation

from twinct.evaluate import region_of_interest
from twinct.geometry import Panel, ScanGeometry, VolumeGrid
from twinct.recon import Projector, rtk_sart, sart, spread_order

MU_BONE = 0.043
OUTER_MM, INNER_MM = (55, 68, 50), (49, 62, 44)


def paper_trajectory(views, panel):
    path = np.linspace(0, 1, views, endpoint=False)
    lon, lat = np.radians(210) * path, np.radians(30) * np.sin(2 * np.pi * path)
    d = np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)], 1)
    u = np.stack([-np.sin(lon), np.cos(lon), 0 * lon], 1)
    return ScanGeometry(300 * d, -300 * d, u, np.cross(d, u), panel)


def shells(grid):
    x, y, z = grid.axes()

    def inside(a, b, c):
        return ((z / c) ** 2)[:, None, None] + ((y / b) ** 2)[:, None] + (x / a) ** 2 <= 1

    return (inside(*OUTER_MM) & ~inside(*INNER_MM)).astype(np.float32) * MU_BONE


def shell_integrals(geometry):
    """Exact line integrals through the shell, (views, rows, columns)."""
    images = np.empty((len(geometry), *geometry.panel.shape), np.float32)
    for view, image in enumerate(images):
        ray = geometry.pixel_centres(view) - geometry.source[view]
        length = np.linalg.norm(ray, axis=-1)
        chords = []
        for axes in (OUTER_MM, INNER_MM):
            s, d = geometry.source[view] / axes, ray / axes
            a, b, c = (d * d).sum(-1), d @ s, s @ s - 1
            chords.append(2 * np.sqrt(np.maximum(b * b - a * c, 0)) / a * length)
        image[:] = MU_BONE * (chords[0] - chords[1])
    return images


def timed(work, *args, **kwargs):
    start = time.perf_counter()
    result = work(*args, **kwargs)
    return result, time.perf_counter() - start


def measure(size, views):
    scale = size / 512
    panel = Panel(int(480 * scale), int(640 * scale), 0.5 / scale, 0.5 / scale)
    grid = VolumeGrid((size,) * 3, 0.31 / scale)
    geometry = paper_trajectory(views, panel)
    A = Projector(geometry, grid)
    truth = shells(grid)
    p = shell_integrals(geometry)
    sart(A[0], p[:1], iterations=1, relaxation=0.3)  # compiles
    ours = theirs = None
    t_ours, t_theirs = [], []
    for view in spread_order(views):
        one, part = [view], p[[view]]
        ours, seconds = timed(sart, A[one], part, iterations=1, relaxation=0.3, x0=ours)
        t_ours.append(seconds)
        theirs, seconds = timed(
            rtk_sart, part, geometry[one], grid, iterations=1, relaxation=0.3, x0=theirs
        )
        t_theirs.append(seconds)
    reach = max(1, round(3.0 / grid.voxel[0]))
    near = binary_dilation(truth > 0, iterations=reach) & region_of_interest(geometry, grid)
    difference = float(np.sqrt(np.mean((ours - theirs)[near] ** 2)) / MU_BONE)
    a, b = float(np.median(t_ours)), float(np.median(t_theirs))
    return {
        "size": size,
        "views": views,
        "ours_s": a,
        "rtk_s": b,
        "ratio": b / a,
        "difference": difference,
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sizes", type=int, nargs="+", default=[128])
    parser.add_argument("--views", type=int, default=20)
    parser.add_argument("--views-512", type=int, default=2)
    parser.add_argument("--json")
    options = parser.parse_args()
    results = []
    print("size  views  ours s/view  RTK s/view  ratio  difference  peak MB")
    for size in options.sizes:
        row = measure(size, options.views_512 if size == 512 else options.views)
        results.append(row)
        print(
            f"{row['size']:4}  {row['views']:5}  {row['ours_s']:11.3f}  {row['rtk_s']:10.3f}"
            f"  {row['ratio']:5.1f}  {row['difference']:9.2%}  {row['peak_mb']:8.0f}",
            flush=True,
        )
    if options.json:
        with open(options.json, "w") as file:
            json.dump(results, file, indent=1)


if __name__ == "__main__":
    main()
