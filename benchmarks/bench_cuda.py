"""A card against the processor: views, projector pair, SART's update and `fast`.

    python benchmarks/bench_cuda.py                         # the paper's skull, 512^3, 399 views
    python benchmarks/bench_cuda.py --views 40 --voxels 256
    python benchmarks/bench_cuda.py --save scene.npz        # the scene alone, for another machine
    python benchmarks/bench_cuda.py --scene scene.npz

Each figure is the time by the clock, until the results are in the processor's memory. The card's
first run compiles its kernels; that time is printed. `TWINCT_CUDA_DEVICE` chooses the card.
"""

from __future__ import annotations

import argparse
import resource
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from twinct.core.threads import limit_threads

if TYPE_CHECKING:
    from twinct.geometry import ScanGeometry, VolumeGrid
    from twinct.xray.engine import SceneBody

FEW = 20
"""Number of views whose single steps are timed."""


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--scenario", type=Path, default=Path("scenarios/paper.yaml"))
    parser.add_argument("--scene", type=Path, help="scene made by --save, instead of a scenario")
    parser.add_argument("--save", type=Path, help="write the scene, and nothing else")
    parser.add_argument("--views", type=int, default=399)
    parser.add_argument("--voxels", type=int, default=512)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--pixels", type=int, help="columns and rows; the panel keeps its size")
    parser.add_argument(
        "--card-alone", action="store_true", help="views and `fast`, without rivals"
    )
    options = parser.parse_args()
    limit_threads(options.threads)  # before anything loads a library
    geometry, bodies = loaded(options.scene) if options.scene else made(options)
    if options.pixels:
        geometry = with_pixels(geometry, options.pixels)
    if options.save:
        save(options.save, geometry, bodies)
        return
    from twinct.core.card import device
    from twinct.geometry import VolumeGrid

    faces, panel = sum(len(body.faces) for body in bodies), geometry.panel
    print(f"{device().name}; processor with {options.threads} threads")
    print(f"{len(geometry)} views of {panel.columns} x {panel.rows} pixels, {faces} triangles")
    integrals = views(geometry, bodies, FEW * (not options.card_alone))
    np.negative(np.log(np.maximum(integrals, 1e-6, out=integrals), out=integrals), out=integrals)
    grid = VolumeGrid((options.voxels,) * 3, 160.0 / options.voxels)
    if not options.card_alone:
        steps(geometry, grid, integrals)
    volumes(geometry, grid, integrals, ("cuda",) if options.card_alone else ("cuda", "vector"))


def made(options: argparse.Namespace) -> tuple[ScanGeometry, list[SceneBody]]:
    """Return the scene of a scenario."""
    from bench_mesh import scene

    geometry, bodies, _ = scene(options.scenario, options.views)
    return geometry, bodies


def save(path: Path, geometry: ScanGeometry, bodies: list[SceneBody]) -> None:
    """Write a scene of one body."""
    (body,), panel = bodies, geometry.panel
    np.savez_compressed(
        path,
        poses=np.stack([geometry.source, geometry.detector, geometry.u, geometry.v]),
        panel=[panel.rows, panel.columns, panel.pitch_v, panel.pitch_u],
        vertices=body.vertices.astype(np.float32),
        faces=np.asarray(body.faces, np.int32),
        mu_per_mm=body.mu_per_mm or 0.0,
    )


def loaded(path: Path) -> tuple[ScanGeometry, list[SceneBody]]:
    """Read a scene written by ``save``."""
    from twinct.geometry import Panel, ScanGeometry
    from twinct.xray.engine import SceneBody

    with np.load(path) as kept:
        rows, columns, pitch_v, pitch_u = kept["panel"]
        panel = Panel(int(rows), int(columns), float(pitch_v), float(pitch_u))
        vertices = kept["vertices"].astype(np.float64)
        body = SceneBody(vertices, kept["faces"], float(kept["mu_per_mm"]))
        source, detector, u, v = kept["poses"]
        return ScanGeometry(source, detector, u, v, panel), [body]


def timed(work: Callable[[], Any]) -> tuple[float, Any]:
    """Return the seconds that a call takes, and its result."""
    start = time.perf_counter()
    result = work()
    return time.perf_counter() - start, result


def with_pixels(geometry: ScanGeometry, pixels: int) -> ScanGeometry:
    """Return the views with other pixels on panels of this size."""
    from twinct.geometry import Panel

    panel, own = geometry.panel, (geometry.source, geometry.detector, geometry.u, geometry.v)
    pitch_v, pitch_u = panel.pitch_v * panel.rows, panel.pitch_u * panel.columns
    return type(geometry)(*own, Panel(pixels, pixels, pitch_v / pixels, pitch_u / pixels))


def views(geometry: ScanGeometry, bodies: list[SceneBody], compared: int) -> NDArray[np.float32]:
    """Time the card's engine, and ``mesh`` in some views; return the card's transmissions."""
    from twinct.xray.engines import engine_named

    few = min(compared, len(geometry))
    images = [np.empty((n, *geometry.panel.shape), np.float32) for n in (len(geometry), few)]
    medians = []
    for name, own in zip(("cuda_mesh", "mesh"), images if few else images[:1], strict=False):
        engine = engine_named(name).engine
        engine.prepare()
        start, _ = timed(partial(engine.acquire, bodies, geometry.panel))
        seconds = []
        for i in range(len(own)):
            view = geometry[i]
            seconds.append(timed(partial(engine.render, view, own[i]))[0])
        print(f"{name}: start {start:.1f} s, first view {seconds[0]:.2f} s", end=", ")
        print(f"then {1e3 * np.median(seconds[1:]):.2f} ms a view")
        medians.append(np.median(seconds[1:]))
        engine.release()
    if few:
        worst = np.abs(images[0][:few] - images[1]).max()
        print(
            f"views: {medians[0] / medians[1]:.4f} x; transmissions differ by at most {worst:.1e}"
        )
    return images[0]


def steps(geometry: ScanGeometry, grid: VolumeGrid, integrals: NDArray[np.float32]) -> None:
    """Time the projector pair and SART's update, a view each, and compare the results."""
    from twinct.recon import Projector, sart

    few = np.linspace(0, len(geometry) - 1, min(FEW, len(geometry))).astype(int)
    p = np.ascontiguousarray(integrals[few])
    k, j, i = (np.linspace(-1, 1, n, dtype=np.float32) for n in grid.shape)
    inside = (k[:, None, None] - 0.2) ** 2 + j[:, None] ** 2 + 2 * i**2 < 0.6
    body = 0.05 * inside.astype(np.float32)
    results: dict[str, list[NDArray[np.float32]]] = {}
    medians: dict[str, list[float]] = {}
    for name in ("cuda", "vector"):
        A = Projector(geometry[few], grid, name)
        calls: tuple[Callable[[], Any], ...] = (
            partial(A.T, p),
            partial(A, body),
            partial(sart, A, p, iterations=1, relaxation=0.5),
        )
        results[name], medians[name] = [], []
        for call in calls:
            first, _ = timed(call)
            seconds, result = min((timed(call) for _ in range(2)), key=lambda pair: pair[0])
            results[name].append(result if isinstance(result, np.ndarray) else result.array)
            medians[name].append(seconds / len(few))
            print(
                f"{name}: first call {first:.1f} s, then {1e3 * seconds / len(few):.1f} ms a view"
            )
    for i, what in enumerate(("adjoint", "forward", "SART update")):
        a, b = results["cuda"][i], results["vector"][i]
        off = float(np.sqrt(np.mean((a - b) ** 2)) / np.abs(b).max())
        ratio = medians["cuda"][i] / medians["vector"][i]
        print(f"{what}: {ratio:.4f} x; differs by {off:.1e} of the largest value, RMS")


def volumes(
    geometry: ScanGeometry,
    grid: VolumeGrid,
    integrals: NDArray[np.float32],
    engines: tuple[str, ...],
) -> None:
    """Time `fast` on some engines, and compare the volumes of two."""
    from twinct.recon import Projector, fast

    results, seconds = [], []
    for name in engines:
        A = Projector(geometry, grid, name)
        took, volume = timed(partial(fast, A, integrals))
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
        print(f"fast, {name}: {took:.1f} s; {dict(volume.extras)}; peak so far {peak:.2f} GB")
        results.append(volume.array)
        seconds.append(took)
    if len(engines) == 1:
        return
    largest = float(np.percentile(results[1], 99.9))
    off = float(np.sqrt(np.mean((results[0] - results[1]) ** 2))) / largest
    print(f"fast: {seconds[0] / seconds[1]:.3f} x; volumes differ by {off:.1e} of bone, RMS")


if __name__ == "__main__":
    main()
