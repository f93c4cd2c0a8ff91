"""Cost of the X-ray physics: a spectrum against one energy, and all that comes behind path lengths.

    python benchmarks/bench_physics.py

The figures are the fastest of several views of 640 x 480 pixels. Effects that ask for more rays or
more renders are taken by themselves on top of all the others: what they add behind the path lengths
is said, and how much more gVXR has to render.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from unittest.mock import patch

import numpy as np
import trimesh
from bench_xray import shell

from twinct.geometry import Panel, Pose, ScanGeometry
from twinct.geometry.wire import PosePairs
from twinct.scenario import Detector, Source
from twinct.specimen import BuiltPart, BuiltSpecimen
from twinct.specimen.materials import material
from twinct.xray import Imager
from twinct.xray.paths import PathRenderer

PANEL = {"columns": 640, "rows": 480, "pixel_pitch_mm": 0.5}
TUBE = {"spectrum": {"kind": "tube", "kvp": 120}}
EFFECTS = {
    "response": {"kind": "scintillator", "thickness_mm": 0.5},
    "scatter": {"kind": "monte_carlo", "views": 1},
    "point_spread": {"kind": "gaussian", "sigma_mm": 0.3},
    "noise": {"kind": "quantum"},
    "readout": {"electronic_noise": 5.0},
    "bad_pixels": {"kind": "random", "share": 1e-3},
    "correction": {"flat_frames": 20, "dark_frames": 20},
}
"""Of the detector, with one render a view."""

SPOT = {"focal_spot": {"kind": "gaussian", "sigma_mm": 0.3, "samples": 8}}
MORE_RENDERS = {
    "lag (another view)": ({}, {"lag": 0.1}),
    "2 x 2 samples a pixel (4 x the rays)": ({}, {"pixel_samples": 2}),
    "binning 2 x 2 (4 x the rays)": ({}, {"binning": 2}),
    "focal spot of 8 points (8 renders)": (SPOT, {}),
    "all of these (64 x)": (SPOT, {"lag": 0.1, "pixel_samples": 2, "binning": 2}),
}
"""Keys of source and detector that ask for more."""


def fastest(work: Callable[[], object], repeats: int = 20) -> float:
    """Seconds of the fastest repeat."""
    best = np.inf
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        best = min(best, time.perf_counter() - start)
    return best


def view_s(
    source: Mapping[str, object],
    detector: Mapping[str, object],
    *parts: BuiltPart,
    rendered: bool = True,
) -> float:
    """Seconds of one view; not ``rendered``: of what comes behind its path lengths."""
    panel = Panel(480, 640, 0.5, 0.5)
    x, y, z = np.eye(3)
    view = ScanGeometry(300 * x[None], -300 * x[None], y[None], z[None], panel)
    at = replace(PosePairs.from_geometry(view), object=(Pose.identity(),))
    with Imager(
        Source.model_validate(source),
        Detector.model_validate({**PANEL, **detector}),
        BuiltSpecimen(parts, Pose.identity()),
    ) as imager:
        if rendered:
            return fastest(lambda: imager.expose(at, 1, at))
        with patch.object(PathRenderer, "render", once(PathRenderer.render)):
            return fastest(lambda: imager.expose(at, 1, at), 40)


def once(render: Callable[..., object]) -> Callable[..., object]:
    """A render that gives the same path lengths whatever it is asked."""
    kept: list[object] = []

    def again(renderer: PathRenderer, view: ScanGeometry, pose: Pose) -> object:
        if not kept:
            kept.append(render(renderer, view, pose))
        return kept[0]

    return again


def main() -> None:
    """Measure and print."""
    bone, titanium = material("bone"), material("titanium")
    skull = BuiltPart("shell", bone, shell())
    ball = BuiltPart("ball", bone, trimesh.creation.icosphere(subdivisions=5, radius=60.0))
    screw = BuiltPart("screw", titanium, trimesh.creation.icosphere(subdivisions=3, radius=9.0))
    for name, part in {"shell, 400 k triangles": skull, "ball, 20 k triangles": ball}.items():
        mono, poly = view_s({}, {}, part), view_s(TUBE, {}, part)
        print(
            f"{name}: one energy {1e3 * mono:.1f} ms, 60 energies {1e3 * poly:.1f} ms, "
            f"{poly / mono:.2f} x"
        )
    effects = {n: view_s(TUBE, EFFECTS, *(skull, screw)[:n], rendered=False) for n in (1, 2)}
    for count, seconds in effects.items():
        print(f"spectrum and effects, {count} material(s): {1e3 * seconds:.1f} ms a view")
    for name, (source, detector) in MORE_RENDERS.items():
        more = view_s(TUBE | source, EFFECTS | detector, skull, rendered=False) - effects[1]
        print(f"    {name}: another {1e3 * more:.1f} ms", flush=True)


if __name__ == "__main__":
    main()
