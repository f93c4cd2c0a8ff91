"""Seconds a view: the imager against a bare gVXR loop that reads every image into numpy.

    python benchmarks/bench_xray.py                       # paper panel, a shell of 400 k faces
    python benchmarks/bench_xray.py --scenario demo.yaml  # panel and specimen of a scenario
    python benchmarks/bench_xray.py --save before.json

Each loop runs in a process of its own, one after the other, several times in turn. ``bare_loop``
is the baseline for whatever claims to add little to gVXR.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from twinct.geometry import Panel, Pose, ScanGeometry
from twinct.scenario import Detector, Source, Specimen, load_scenario


@dataclass(frozen=True)
class Bare:
    """What a bare loop leaves behind.

    Attributes:
        images: transmission, (views, rows, columns), float32.
        seconds: for each view, from setting its geometry to having it in numpy, (views,).
    """

    images: NDArray[np.float32]
    seconds: NDArray[np.float64]


def bare_loop(
    geometry: ScanGeometry,
    bodies: Sequence[tuple[trimesh.Trimesh, float]],
    energy_kev: float = 80.0,
    *,
    defaults: bool = False,
) -> Bare:
    """The least code that takes these views with gVXR. Needs a process of its own.

    Args:
        geometry: the views, in the frame of the meshes.
        bodies: closed meshes, mm, each with its attenuation in 1/mm.
        energy_kev: photon energy.
        defaults: as a newcomer writes it, with gVXR's artefact filter and ``np.array`` of the
            tuples that gVXR returns; otherwise in the fastest way that gVXR offers.
    """
    from gvxrPython3 import gvxr as module

    gvxr: Any = module  # its stubs know other numbers of arguments

    panel = geometry.panel
    gvxr.createOpenGLContext()
    if not defaults:
        gvxr.disableArtefactFiltering()
    gvxr.usePointSource()
    gvxr.setMonoChromaticPerPixelAtSDD(energy_kev, "keV", 1)
    gvxr.setDetectorNumberOfPixels(panel.columns, panel.rows)
    gvxr.setDetectorPixelSize(panel.pitch_u, panel.pitch_v, "mm")
    for index, (mesh, mu_per_mm) in enumerate(bodies):
        label = str(index)
        vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
        gvxr.makeTriangularMesh(label, vertices.ravel().tolist(), faces.ravel().tolist(), "mm")
        gvxr.setLinearAttenuationCoefficient(label, 10 * mu_per_mm, "cm-1")
        gvxr.addPolygonMeshAsInnerSurface(label)
    images = np.empty((len(geometry), *panel.shape), dtype=np.float32)
    seconds = np.empty(len(geometry))
    for i in range(len(geometry)):
        start = time.perf_counter()
        gvxr.setSourcePosition(*geometry.source[i].tolist(), "mm")
        gvxr.setDetectorPosition(*geometry.detector[i].tolist(), "mm")
        gvxr.setDetectorRightVector(*geometry.u[i].tolist())
        gvxr.setDetectorUpVector(*geometry.v[i].tolist())
        if defaults:
            images[i] = np.array(gvxr.computeXRayImage(False))
        else:
            gvxr.computeXRayImage(images[i], False)
        seconds[i] = time.perf_counter() - start
    return Bare(images, seconds)


def imager_loop(geometry: ScanGeometry, specimen: Any, detector: Detector) -> Bare:
    """The same views through the imager."""
    from twinct.xray import Imager

    images = np.empty((len(geometry), *geometry.panel.shape), dtype=np.float32)
    seconds = np.empty(len(geometry))
    with Imager(Source(), detector, specimen) as imager:
        for i, view in enumerate(geometry):
            start = time.perf_counter()
            images[i] = imager.render(view, Pose.identity())
            seconds[i] = time.perf_counter() - start
    return Bare(images, seconds)


def circle(panel: Panel, views: int) -> ScanGeometry:
    """Source and panel 300 mm from the origin."""
    angle = np.linspace(0, 2 * np.pi, views, endpoint=False)
    out = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    u = np.stack([-np.sin(angle), np.cos(angle), 0 * angle], axis=1)
    return ScanGeometry(300 * out, -300 * out, u, np.tile([0.0, 0.0, 1.0], (views, 1)), panel)


@dataclass(frozen=True)
class _Material:
    mu: float

    def mu_per_mm(self, energy_kev: float) -> float:
        return self.mu


@dataclass(frozen=True)
class _Part:
    name: str
    mesh: trimesh.Trimesh
    material: _Material


@dataclass(frozen=True)
class _Parts:
    parts: tuple[_Part, ...]


def shell() -> trimesh.Trimesh:
    """A bumpy hollow shell of skull size, 400 k triangles."""
    outer = trimesh.creation.icosphere(subdivisions=7, radius=1.0)
    bumps = 1 + 0.02 * np.sin(9 * outer.vertices).sum(axis=1, keepdims=True)
    outer.vertices *= bumps * [90, 72, 67]
    inner = trimesh.creation.icosphere(subdivisions=6, radius=1.0)
    inner.vertices *= [80, 62, 57]
    inner.invert()
    mesh = trimesh.util.concatenate([outer, inner])
    assert isinstance(mesh, trimesh.Trimesh)
    return mesh


def _run(task: tuple[str, int, str | None, int, int]) -> tuple[list[float], float]:
    loop, views, path, columns, rows = task
    detector, specimen = (
        Detector(columns=columns, rows=rows),
        _Parts((_Part("shell", shell(), _Material(0.043)),)),
    )
    if path is not None:
        from twinct.specimen import build_specimen

        scenario = load_scenario(Path(path))
        detector, section = scenario.detector, scenario.specimen
        assert isinstance(section, Specimen)
        specimen = build_specimen(section)
    geometry = circle(detector.panel, views)
    if loop == "imager":
        result = imager_loop(geometry, specimen, detector)
    else:
        bodies = [(part.mesh, part.material.mu_per_mm(80.0)) for part in specimen.parts]
        result = bare_loop(geometry, bodies, defaults=loop == "bare, defaults")
    return result.seconds[1:].tolist(), float(result.images.sum(dtype=np.float64))


def main() -> None:
    """Run, print, save."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--views", type=int, default=30)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--columns", type=int, default=640)
    parser.add_argument("--rows", type=int, default=480)
    parser.add_argument("--scenario", help="take panel and specimen from this scenario")
    parser.add_argument("--save", type=Path, help="write the figures as JSON")
    options = parser.parse_args()
    loops = ("bare", "imager", "bare, defaults")
    seconds: dict[str, list[float]] = {loop: [] for loop in loops}
    sums: dict[str, float] = {}
    spawn = multiprocessing.get_context("spawn")
    for _ in range(options.repeats):
        for loop in loops:
            task = (loop, options.views, options.scenario, options.columns, options.rows)
            with spawn.Pool(1) as pool:
                measured, sums[loop] = pool.apply(_run, (task,))
            seconds[loop] += measured
    # On a machine that others use too, the fastest view says more than the median.
    figures = {
        name: {loop: float(statistic(values)) for loop, values in seconds.items()}
        for name, statistic in (("median", np.median), ("fastest", np.min))
    }
    for name, figure in figures.items():
        for loop, value in figure.items():
            ratio = value / figure["bare"]
            print(f"{name:8} {loop:15} {1e3 * value:7.1f} ms a view, {ratio:.3f} x bare")
        print(f"{name:8} imager adds {1e3 * (figure['imager'] - figure['bare']):.2f} ms a view")
    print(f"images of imager and bare loop equal: {sums['imager'] == sums['bare']}")
    if options.save:
        options.save.write_text(json.dumps(figures, indent=2))


if __name__ == "__main__":
    main()
