"""Processor time of a view through grey voxels, in turn with a gVXR view of the paper's skull.

    python benchmarks/bench_grey.py
    python benchmarks/bench_grey.py --threads 2 --voxels 256

The grid of voxels is as wide as the paper's skull is long and full of matter, so that few rays are
cheaper because they miss it. The views are those of the scenario. Processor time counts all threads
of the process, those of gVXR's renderer included.
"""

from __future__ import annotations

import argparse
import resource
import time
from pathlib import Path

import numpy as np
from bench_mesh import SETTLE_S, scene

from twinct.core.threads import limit_threads

WIDTH_MM = 200.0
"""Edge of the grid."""


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--scenario", type=Path, default=Path("scenarios/paper.yaml"))
    parser.add_argument("--views", type=int, default=20)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--voxels", type=int, default=512, help="along each edge")
    options = parser.parse_args()
    limit_threads(options.threads)  # before anything loads a library
    from twinct.specimen.grey_caster import GreyCaster
    from twinct.xray.engines import engine_named

    geometry, bodies, _ = scene(options.scenario, options.views)
    panel = geometry.panel
    caster = GreyCaster(body(options.voxels), panel)
    engine = engine_named("gvxr").engine
    engine.acquire(bodies, panel)
    image = np.empty(panel.shape, np.float32)
    seconds = np.empty((2, len(geometry)))
    crossed = []
    for turn, i in enumerate([0, *range(len(geometry))]):  # the first turn does not count
        view = geometry[i]
        for which in (0, 1) if turn % 2 else (1, 0):
            time.sleep(SETTLE_S)
            start = time.process_time()
            if which:
                crossed.append(caster.cast(view)[0].mean())
            else:
                engine.render(view, image)
            seconds[which, i] = time.process_time() - start
    gvxr, grey = np.median(seconds, axis=1)
    ratios = seconds[1] / seconds[0]
    print(f"{panel.columns} x {panel.rows} pixels, {options.voxels}^3 voxels of 3 materials")
    print(f"mean path of a ray in the grid: {np.mean(crossed):.0f} mm of {WIDTH_MM:.0f}")
    print(f"threads: {options.threads}; medians of {len(ratios)} views, processor seconds a view")
    print(f"gvxr {gvxr:.3f}, grey {grey:.3f}: {grey / gvxr:.2f} x", end=" ")
    print(f"(single views {ratios.min():.2f} to {ratios.max():.2f} x)")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    print(f"peak memory of the process: {peak:.2f} GB")


def body(voxels: int):  # noqa: ANN201 - the class loads libraries
    """Return a grid full of three materials, with an empty layer around, as grey parts have."""
    from twinct.geometry import VolumeGrid
    from twinct.specimen.grey import GreyField
    from twinct.specimen.materials import material

    names = "water", "bone", "titanium"
    amounts = np.zeros((voxels + 2, voxels + 2, voxels + 2, len(names)), np.float32)
    amounts[1:-1, 1:-1, 1:-1] = 1.0
    materials = tuple(material(name) for name in names)
    return GreyField(materials, amounts, VolumeGrid(amounts.shape[:3], WIDTH_MM / voxels))


if __name__ == "__main__":
    main()
