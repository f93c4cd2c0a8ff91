"""Cost of the X-ray physics: detector effects of a view, and a spectrum against one energy.

    python benchmarks/bench_physics.py

The figures are the fastest of several views of 640 x 480 pixels, one sample a pixel.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

import numpy as np
import trimesh

from twinct.geometry import Panel, Pose, ScanGeometry
from twinct.scenario import Detector, Source
from twinct.specimen import BuiltPart, BuiltSpecimen
from twinct.specimen.materials import material
from twinct.xray import Imager
from twinct.xray.chain import Chain
from twinct.xray.paths import Body, PathRenderer

PANEL = {"columns": 640, "rows": 480, "pixel_pitch_mm": 0.5}
TUBE = {"kind": "tube", "kvp": 120}
EVERYTHING = {
    "response": {"kind": "scintillator", "thickness_mm": 0.5},
    "point_spread": {"kind": "gaussian", "sigma_mm": 0.3},
    "noise": {"kind": "quantum"},
    "readout": {"electronic_noise": 5.0},
    "bad_pixels": {"kind": "random", "share": 1e-3},
    "correction": {"flat_frames": 20, "dark_frames": 20},
}


def fastest(work: Callable[[], object], repeats: int = 40) -> float:
    """Seconds of the fastest repeat."""
    best = np.inf
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        best = min(best, time.perf_counter() - start)
    return best


def shell() -> trimesh.Trimesh:
    """A bumpy hollow shell of skull size, 400 k triangles."""
    outer = trimesh.creation.icosphere(subdivisions=7, radius=1.0)
    bumps = 1 + 0.02 * np.sin(9 * outer.vertices).sum(axis=1, keepdims=True)
    outer.vertices *= bumps * [90, 72, 67]
    inner = trimesh.creation.icosphere(subdivisions=6, radius=1.0)
    inner.vertices *= [80, 62, 57]
    inner.invert()
    return trimesh.util.concatenate([outer, inner])


def effects(chain: Chain, paths: np.ndarray, view: ScanGeometry) -> None:
    """What one view needs behind its path lengths."""
    expected = chain.blank()
    chain.add(paths, view, expected)
    chain.frame(expected, view, 1, 300.0)


def main() -> None:
    """Measure and print."""
    panel = Panel(480, 640, 0.5, 0.5)
    view = ScanGeometry([[300, 0, 0]], [[-300, 0, 0]], [[0, 1, 0]], [[0, 0, 1]], panel)
    bone, water = material("bone"), material("water")
    meshes = {"shell, 400 k triangles": shell(), "ball, 20 k triangles": None}
    meshes["ball, 20 k triangles"] = trimesh.creation.icosphere(subdivisions=5, radius=60.0)
    for name, mesh in meshes.items():
        built = BuiltSpecimen((BuiltPart("shell", bone, mesh),), Pose.identity())
        with Imager(Source(), Detector(**PANEL), built) as imager:
            mono = fastest(partial(imager.render, view, Pose.identity()))
        with Imager(Source(spectrum=TUBE), Detector(**PANEL), built, commanded=view) as imager:
            poly = fastest(partial(imager.render, view, Pose.identity()))
        print(
            f"{name}: one energy {1e3 * mono:.1f} ms, 60 energies {1e3 * poly:.1f} ms, "
            f"{poly / mono:.2f} x"
        )
    mesh = meshes["shell, 400 k triangles"]
    for materials in ([bone], [bone, water]):
        bodies = [Body(mesh, substance) for substance in materials]
        with PathRenderer(bodies, panel) as renderer:
            paths = renderer.render(view, Pose.identity())
        chain = Chain(Source(spectrum=TUBE), Detector(**PANEL, **EVERYTHING), materials, view)
        print(
            f"spectrum and all detector effects, {len(materials)} material(s): "
            f"{1e3 * fastest(partial(effects, chain, paths, view)):.1f} ms a view"
        )


if __name__ == "__main__":
    main()
