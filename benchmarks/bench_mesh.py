"""Processor time of a view, engine mesh against gVXR in turn, and the errors of their images.

    python benchmarks/bench_mesh.py                                    # the paper's skull and panel
    python benchmarks/bench_mesh.py --threads 2
    python benchmarks/bench_mesh.py --scenario scenarios/demo.yaml --views 100

Both engines hold the scene in one process and take each view in turn. Processor time counts all
threads of the process, those of the renderer included. The views are the commanded ones of the
scenario. The kernel of ``rays``, which is another one, judges the images.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from twinct.core.threads import limit_threads

if TYPE_CHECKING:
    from twinct.geometry import ScanGeometry
    from twinct.xray.engine import SceneBody

SETTLE_S = 0.05
"""Pause before each view, in which the threads of the last one fall asleep."""

REFEREED = 8
"""Number of views that the referee judges."""


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--scenario", type=Path, default=Path("scenarios/paper.yaml"))
    parser.add_argument("--views", type=int, default=40)
    parser.add_argument("--threads", type=int, default=1)
    options = parser.parse_args()
    limit_threads(options.threads)  # before anything loads a library
    geometry, bodies, mu_per_mm = scene(options.scenario, options.views)
    panel = geometry.panel
    faces = sum(len(body.faces) for body in bodies)
    print(f"{options.scenario.name}: {faces} triangles, {panel.columns} x {panel.rows} pixels")
    seconds, images = compared(geometry, bodies)
    gvxr, mesh = np.median(seconds, axis=1)
    ratios = seconds[1] / seconds[0]
    print(f"threads: {options.threads}; medians of {len(ratios)} views, processor seconds a view")
    print(f"gvxr {gvxr:.3f}, mesh {mesh:.3f}: {mesh / gvxr:.2f} x", end=" ")
    print(f"(single views {ratios.min():.2f} to {ratios.max():.2f} x)")
    error = np.abs(images[0] - images[1])
    print(f"transmission: mean difference {error.mean():.1e}, largest {error.max():.1e},", end=" ")
    print(f"above 1e-3 in {(error > 1e-3).mean():.1e} of the pixels")
    chosen = np.linspace(0, len(geometry) - 1, min(REFEREED, len(geometry))).astype(int)
    truth = np.array([refereed(geometry, bodies, int(view)) for view in chosen])
    visible = (truth > 0) & (truth < 7)  # single precision shows little behind more
    for name, shown in zip(("gvxr", "mesh"), images[:, chosen], strict=True):
        lines = -np.log(np.maximum(shown, 1e-6, dtype=np.float64))
        path = np.abs(lines - truth)[visible] / mu_per_mm
        print(f"{name} against shadow, path in bone, mm: mean {path.mean():.1e}", end=", ")
        print(f"99.9 % within {np.quantile(path, 0.999):.1e}, worst {path.max():.1e}")


def scene(path: Path, views: int) -> tuple[ScanGeometry, list[SceneBody], float]:
    """Return views in the frame of the bodies, the bodies, and the attenuation of bone."""
    from twinct.scan import SimulationBuilder
    from twinct.scenario import load_scenario
    from twinct.specimen.materials import material
    from twinct.xray._placement import longest_edge, split
    from twinct.xray.engine import SceneBody

    scenario = load_scenario(path)
    builder = SimulationBuilder(scenario)
    energy, edge = scenario.source.energy_kev, longest_edge(150.0)
    bodies = []
    for part in builder.specimen.parts:
        mesh, mu = split(part.mesh, edge), float(part.material.mu_per_mm(energy))
        bodies.append(SceneBody(np.asarray(mesh.vertices), np.asarray(mesh.faces), mu))
    requested = builder.requested
    chosen = np.linspace(0, len(requested) - 1, min(views, len(requested))).astype(int)
    geometry = builder.specimen.world_from_specimen.inverse() @ requested[chosen]
    return geometry, bodies, float(material("bone").mu_per_mm(energy))


def compared(
    geometry: ScanGeometry, bodies: Sequence[SceneBody]
) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
    """Return processor seconds (engines, views), and the transmissions."""
    from twinct.xray.engines import engine_named

    engines = [engine_named(name).engine for name in ("gvxr", "mesh")]
    for engine in engines:
        engine.acquire(bodies, geometry.panel)
    seconds = np.empty((2, len(geometry)))
    images = np.empty((2, len(geometry), *geometry.panel.shape), np.float32)
    for turn, i in enumerate([0, *range(len(geometry))]):  # the first turn does not count
        view = geometry[i]
        for which in (0, 1) if turn % 2 else (1, 0):
            time.sleep(SETTLE_S)
            start = time.process_time()
            engines[which].render(view, images[which, i])
            seconds[which, i] = time.process_time() - start
    return seconds, images


def refereed(geometry: ScanGeometry, bodies: Sequence[SceneBody], view: int) -> NDArray[np.float64]:
    """Return line integrals of one view by the kernel of ``rays``, (rows, columns)."""
    from twinct.geometry import Pose
    from twinct.rays import Body, Rays

    total = np.zeros(geometry.panel.shape)
    for body in bodies:
        shadow = Rays(geometry).shadow(Body(body.vertices, body.faces), Pose.identity(), view)
        total[shadow.box.rows, shadow.box.columns] += (body.mu_per_mm or 0.0) * shadow.lengths
    return total


if __name__ == "__main__":
    main()
