"""Projector and SART here and RTK's, in alternation, on the paper's trajectory.

python benchmarks/bench_recon.py --sizes 128 256 512 --json recon.json

Seconds are the median of a view; SART's are counted from update to update, so that what either
copies before the first one does not count. Views per size: --views, except 512. RTK's back
projection here is the exact adjoint, which it computes with one thread; its SART takes another one.

Difference: RMS of the two volumes within 3 mm of the bone of an ellipsoid shell (0.043/mm), where
every view sees it, relative to the RMS of theirs there: after one pass a volume has barely begun.
Both get the same views in the same order; the line integrals are analytic, made by neither. Peak
memory of ours: the paper's 399 views at once, in a process of its own.

    python benchmarks/bench_recon.py --agreement 1 5 10 --sizes 128 --views 100
    python benchmarks/bench_recon.py --scaling 1 2 --sizes 512 --views 4

    python benchmarks/bench_recon.py --roofline --sizes 512 --threads 1 --views 8

The first gives the differences alone, after so many iterations; the second the seconds of our SART
with so many threads; the third what bounds projection and back projection of a view: their
processor time beside that of moving the volume through memory alone. Tiles that stay in the caches
for a whole subset of views could save that at most.
"""

import argparse
import json
import multiprocessing
import os
import re
import subprocess
import sys
import time
from importlib import import_module
from pathlib import Path
from typing import Any

import numba
import numpy as np
from scipy.ndimage import binary_dilation

from twinct.evaluation import region_of_interest
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
    for view in range(len(geometry)):
        ray = geometry.pixel_centres(view) - geometry.source[view]
        length = np.linalg.norm(ray, axis=-1)
        chords = []
        for axes in (OUTER_MM, INNER_MM):
            s, d = geometry.source[view] / axes, ray / axes
            a, b, c = (d * d).sum(-1), d @ s, s @ s - 1
            chords.append(2 * np.sqrt(np.maximum(b * b - a * c, 0)) / a * length)
        images[view] = MU_BONE * (chords[0] - chords[1])
    return images


class Rtk:
    """RTK's pair of Joseph projectors for one view."""

    def __init__(self, geometry, grid):
        # Not for the process that measures the memory of ours.
        itk: Any = import_module("itk")
        RTK: Any = itk.RTK
        self.itk, self.rtk = itk, RTK
        numbers = (grid.world_from_grid.inverse() @ geometry).to_rtk()
        self.kind = itk.Image[itk.F, 3]
        self.geometry = RTK.ThreeDCircularProjectionGeometry.New()
        points = [itk.Point[itk.D, 3](numbers[k][0].tolist()) for k in ("source", "detector")]
        vectors = [itk.Vector[itk.D, 3](numbers[k][0].tolist()) for k in ("row", "column")]
        self.geometry.AddProjection(*points, *vectors)
        self.panel = (*numbers["origin"], 0.0), (*numbers["spacing"], 1.0)
        self.grid = grid.first_voxel_mm, grid.voxel

    def image(self, array, place):
        image = self.itk.image_view_from_array(array)
        image.SetOrigin([float(value) for value in place[0]])
        image.SetSpacing([float(value) for value in place[1]])
        return image

    def run(self, name, x, y, into):
        project = getattr(self.rtk, name)[self.kind, self.kind].New()
        images = self.image(x, self.grid), self.image(y, self.panel)
        project.SetInput(0, images[into])
        project.SetInput(1, images[1 - into])
        project.SetGeometry(self.geometry)
        project.Update()
        return self.itk.array_view_from_image(project.GetOutput())

    def forward(self, x, y):
        return self.run("JosephForwardProjectionImageFilter", x, y, 1)

    def back(self, x, y):
        return self.run("JosephBackProjectionImageFilter", x, y, 0)


def seconds(work, *args):
    start = time.perf_counter()
    work(*args)
    return time.perf_counter() - start


def updates(algorithm, *args, **kwargs):
    """The volume, and the seconds of each update but the first."""
    stamps = []

    def stamp(*_):
        stamps.append(time.perf_counter())

    volume = algorithm(*args, iterations=1, relaxation=0.3, callback=stamp, **kwargs)
    return volume, list(np.diff(stamps))


def peak_mb(size, threads):
    """Peak memory of a process that runs our SART on the paper's 399 views, a few of them."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(_peak_mb, (size, threads))


def _peak_mb(size, threads):
    numba.set_num_threads(threads)
    geometry, grid = setting(size, 399)
    p = np.ones((399, *geometry.panel.shape), np.float32)
    sart(Projector(geometry, grid), p, iterations=1, relaxation=0.3, callback=_two_updates)
    # Not ru_maxrss, which a process inherits from the one that started it.
    status = Path("/proc/self/status").read_text()
    found = re.search(r"VmHWM:\s+(\d+)", status)
    assert found is not None
    return int(found[1]) / 1024


def _two_updates(step):
    return step.update == 1


SECOND_PROCESS = """
import time
start = time.perf_counter()
import numpy as np
from twinct.geometry import Panel, ScanGeometry, VolumeGrid
from twinct.recon import Projector, sart
x, y, z = np.eye(3)[:, None]
geometry = ScanGeometry(-300 * x, 300 * x, z, y, Panel(120, 160, 2, 2))
A = Projector(geometry, VolumeGrid((128,) * 3, 1.24))
ready = time.perf_counter()
sart(A, np.ones(A.range_shape), iterations=1, relaxation=0.3)
print(f"first update {time.perf_counter() - ready:.2f} s after the call, ", end="")
print(f"{time.perf_counter() - start:.2f} s with all imports")
"""


def setting(size, views):
    scale = size / 512
    panel = Panel(int(480 * scale), int(640 * scale), 0.5 / scale, 0.5 / scale)
    return paper_trajectory(views, panel), VolumeGrid((size,) * 3, 0.31 / scale)


def measure(size, views, rounds, threads):
    geometry, grid = setting(size, views)
    A = Projector(geometry, grid)
    truth = shells(grid)
    p = shell_integrals(geometry)
    sart(A[0], p[:1], iterations=1, relaxation=0.3)  # compiles, or loads what was
    A[0].T(p[:1])
    t = {name: [] for name in ("forward", "rtk_forward", "rtk_adjoint")}
    for view in spread_order(views):
        theirs = Rtk(geometry[int(view)], grid)
        t["forward"].append(seconds(A[view], truth))
        t["rtk_forward"].append(seconds(theirs.forward, truth, np.zeros_like(p[:1])))
        t["rtk_adjoint"].append(seconds(theirs.back, np.zeros_like(truth), p[[view]]))
    t["adjoint"] = [seconds(A.T, p) / views]
    t |= {"sart": [], "rtk_sart": []}
    ours = theirs = None
    for _ in range(rounds):
        ours, some = updates(sart, A, p)
        t["sart"] += some
        theirs, some = updates(rtk_sart, p, geometry, grid)
        t["rtk_sart"] += some
    row = {f"{name}_s": float(np.median(times)) for name, times in t.items()}
    for name in ("forward", "adjoint", "sart"):
        row[f"{name}_ratio"] = row[f"rtk_{name}_s"] / row[f"{name}_s"]
    difference = apart(ours, theirs, geometry, grid)[0]
    peak = peak_mb(size, threads)
    return {"size": size, "views": views} | row | {"difference": difference, "peak_mb": peak}


def apart(ours, theirs, geometry, grid):
    """RMS near bone of the difference and of their error, relative to the RMS of theirs."""
    truth, ours, theirs = shells(grid), np.asarray(ours), np.asarray(theirs)
    reach = max(1, round(3.0 / grid.voxel[0]))
    bone: Any = binary_dilation(truth > 0, iterations=reach)
    near = bone & region_of_interest(geometry, grid)
    size = float(np.sqrt(np.mean(theirs[near] ** 2)))
    return [float(np.sqrt(np.mean((theirs - x)[near] ** 2))) / size for x in (ours, truth)]


def agreement(size, views, iterations):
    """One line for each number of iterations."""
    geometry, grid = setting(size, views)
    p, A = shell_integrals(geometry), Projector(geometry, grid)
    for count in iterations:
        ours = sart(A, p, iterations=count, relaxation=0.3)
        theirs = rtk_sart(p, geometry, grid, iterations=count, relaxation=0.3)
        difference, error = apart(ours, theirs, geometry, grid)
        print(
            f"{size:4}  {views} views, {count} iterations: {difference:.3%} of RTK's volume, ",
            end="",
        )
        print(f"which is {error:.1%} off the truth", flush=True)


def scaling(size, views, threads):
    """Seconds of a view of our SART by threads."""
    geometry, grid = setting(size, views)
    p, A = shell_integrals(geometry), Projector(geometry, grid)
    sart(A[0], p[:1], iterations=1, relaxation=0.3)
    for count in threads:
        numba.set_num_threads(count)
        print(f"{size:4}  {count} threads: {np.median(updates(sart, A, p)[1]):.3f} s a view")


def roofline(size, views):
    """Print processor seconds of a view against those that memory alone would take."""
    geometry, grid = setting(size, views)
    image = np.ones(geometry.panel.shape, np.float32)

    def times(A):
        x = np.ones(A.domain_shape, np.float32)
        found = []
        for view in range(len(A)):
            for call in (A.line_integrals_of, lambda x, view, A=A: A.add_image(image, view, x)):
                clock = time.process_time()
                call(x, view)
                found.append(time.process_time() - clock)
        return [np.median(found[kind::2]) for kind in (0, 1)], x

    (forward, back), x = times(Projector(geometry, grid))
    moves = []
    for _ in range(5):
        clock = time.process_time()
        x *= np.float32(1)
        moves.append(time.process_time() - clock)
    move = min(moves)
    print(f"{size:4}  memory: {2e-9 * x.nbytes / move:.1f} GB/s read and written, {views} views")
    print(f"      projection: {forward:.3f} s, of which the volume's reading {move / 2:.3f} s")
    print(f"      back projection: {back:.3f} s, of which reading and writing {move:.3f} s")
    best = 1 - 1.5 * move / (forward + back)
    print(f"      without any of it, a view would take at least {best:.2f} x its time")


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sizes", type=int, nargs="+", default=[128])
    parser.add_argument("--views", type=int, default=20)
    parser.add_argument("--views-512", type=int, default=4)
    parser.add_argument("--agreement", type=int, nargs="+", metavar="ITERATIONS")
    parser.add_argument("--scaling", type=int, nargs="+", metavar="THREADS")
    parser.add_argument("--roofline", action="store_true")
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--threads", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("--json")
    options = parser.parse_args()
    numba.set_num_threads(options.threads)
    os.environ["ITK_GLOBAL_DEFAULT_NUMBER_OF_THREADS"] = str(options.threads)
    if options.agreement or options.scaling or options.roofline:
        for size in options.sizes:
            if options.roofline:
                roofline(size, options.views)
            elif options.agreement:
                agreement(size, options.views, options.agreement)
            else:
                scaling(size, options.views, options.scaling)
        return
    results = []
    print(f"{options.threads} threads; ms a view, ours / RTK's = ratio")
    print("size  views  forward              exact adjoint        SART                 ", end="")
    print("difference  peak MB")
    for size in options.sizes:
        views = options.views_512 if size == 512 else options.views
        row = measure(size, views, options.rounds, options.threads)
        results.append(row | {"threads": options.threads})
        cells = [
            f"{1e3 * row[f'{name}_s']:5.0f} / {1e3 * row[f'rtk_{name}_s']:6.0f} = "
            f"{row[f'{name}_ratio']:4.1f}"
            for name in ("forward", "adjoint", "sart")
        ]
        print(
            f"{size:4}  {row['views']:5}  {'  '.join(cells)}"
            f"  {row['difference']:9.2%}  {row['peak_mb']:7.0f}",
            flush=True,
        )
    # All kernels were compiled by now, and are on disk.
    second = subprocess.run([sys.executable, "-c", SECOND_PROCESS], capture_output=True, text=True)
    print(f"a second process: {second.stdout.strip() or second.stderr}")
    if options.json:
        with open(options.json, "w") as file:
            json.dump(results, file, indent=1)


if __name__ == "__main__":
    main()
