"""Peak memory of a reconstruction on a large grid, and what the model in recon/memory.py says.

python benchmarks/bench_memory.py --size 1024 --views 4 --only sart fast fdk

Each algorithm runs in a process of its own on analytic line integrals of a shell of bone, from a
few views of SIZE x SIZE pixels on a circle: neither the volumes nor the denoising depend on their
number. Printed: the growth of the process's peak over its size before the call, beside the model's
bytes for these views, and what both are with all ``--of`` views, their line integrals included.
"""

import argparse
import math
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from bench_recon import shell_integrals

from twinct.geometry import Panel, VolumeGrid
from twinct.recon import Projector, fast, fdk, peak_bytes, sart
from twinct.recon.algorithms import algorithms
from twinct.trajectory import CircleTrajectory, commanded_views

SOLVE = {"sart": lambda A, p: sart(A, p, iterations=1, relaxation=0.3), "fast": fast, "fdk": fdk}


def kilobytes(name):
    """A line of the process's status, in bytes."""
    found = re.search(rf"{name}:\s+(\d+)", Path("/proc/self/status").read_text())
    assert found is not None
    return 1024 * int(found[1])


def measure(name, size, views, of):
    """One line, from this process."""
    panel = Panel(size, size, 320 / size, 320 / size)
    circle = CircleTrajectory(kind="circle", views=views, sod_mm=300, sdd_mm=600)
    geometry = commanded_views(circle, panel)
    A = Projector(geometry, VolumeGrid((size,) * 3, 159 / size))
    p = shell_integrals(geometry)
    before, start, spent = kilobytes("VmRSS"), time.perf_counter(), time.process_time()
    volume = SOLVE[name](A, p)
    spent, passed = time.process_time() - spent, time.perf_counter() - start
    grown = kilobytes("VmHWM") - before
    voxels, algorithm = math.prod(A.domain_shape), algorithms()[name]
    stated = peak_bytes(algorithm, voxels, p.size)
    pixels = size * size * (of - views)
    whole = kilobytes("VmHWM") + 4 * (1 + algorithm.projections) * pixels
    print(
        f"{name:5} {size}^3, {views} views: {grown / 1e9:.2f} GB, stated {stated / 1e9:.2f} GB; "
        f"the process with {of} views: {whole / 1e9:.2f} GB; {passed:.0f} s, {spent:.0f} processor "
        f"s; mean {float(np.mean(volume.array)):.4f}",
        flush=True,
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", type=int, default=1024)
    parser.add_argument("--views", type=int, default=4)
    parser.add_argument("--of", type=int, default=400)
    parser.add_argument("--only", nargs="+", choices=SOLVE, default=list(SOLVE))
    parser.add_argument("--here", action="store_true", help="in this process")
    options = parser.parse_args()
    for name in options.only:
        if options.here:
            measure(name, options.size, options.views, options.of)
            continue
        told = [f"--{key}={getattr(options, key)}" for key in ("size", "views", "of")]
        subprocess.run([sys.executable, __file__, "--here", *told, "--only", name], check=True)


if __name__ == "__main__":
    main()
