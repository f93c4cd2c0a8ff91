"""Draw the effects of X-ray physics on the skull, for docs/physics.md and docs/scenario.md.

Each picture shows the ideal image, the image with one effect and their difference in transmission,
in one view of the paper's geometry with a coarser panel. Beam hardening is shown in a volume.

    python docs/pictures/physics.py            # all
    python docs/pictures/physics.py lag noise  # some
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import numpy as np
from matplotlib import pyplot as plt
from numpy.typing import NDArray

from twinct.geometry import Pose, ScanGeometry
from twinct.geometry.wire import PosePairs
from twinct.runs import reconstruct, simulate
from twinct.scan import SimulationBuilder
from twinct.scenario import Scenario, parse_scenario
from twinct.xray.build import effective_energy_kev

MM_PER_CM = 10.0
FOLDER = Path(__file__).parents[2] / "docs" / "images"
TUBE = {"kind": "tube", "kvp": 80}
BASE = {
    "detector": {"columns": 320, "rows": 240, "pixel_pitch_mm": 1.0},
    "trajectory": {"kind": "sinusoid", "views": 3, "centre_longitude_deg": 60},
    "specimen": {"parts": [{"shape": {"kind": "skull"}, "material": "bone"}]},
}
GRID = {"along": "v", "ratio": 10, "lines_per_cm": 40, "strip_mm": 0.043, "focus_mm": 1000}
BOWTIE = {"along": "u", "angles_deg": [0, 4, 10], "thickness_mm": [0, 4, 9]}
EFFECTS: dict[str, dict[str, Mapping[str, Any]]] = {
    "energy": {"source": {"energy_kev": 50}},
    "spectrum": {"source": {"spectrum": TUBE}},
    "response": {
        "source": {"spectrum": TUBE},
        "detector": {"response": {"kind": "scintillator", "thickness_mm": 0.2}},
    },
    "focal_spot": {"source": {"focal_spot": {"kind": "gaussian", "sigma_mm": 1.5, "samples": 32}}},
    "motion": {"source": {"motion_samples": 24}},
    "pixel_samples": {"detector": {"pixel_samples": 4}},
    "point_spread": {"detector": {"point_spread": {"kind": "gaussian", "sigma_mm": 2.0}}},
    "binning": {"detector": {"columns": 80, "rows": 60, "pixel_pitch_mm": 4.0, "binning": 4}},
    "noise": {
        "source": {"photons_per_mm2_mas": 1e6, "exposure_ms": 0.5},
        "detector": {"noise": {"kind": "quantum"}},
    },
    "readout": {
        "detector": {
            "noise": {"kind": "snr", "snr": 400},
            "readout": {"bits": 8, "free_beam": 200, "offset": 5},
        }
    },
    "bad_pixels": {"detector": {"bad_pixels": {"kind": "random", "share": 0.02}}},
    "correction": {
        "detector": {
            "noise": {"kind": "snr", "snr": 60},
            "correction": {"flat_frames": 1, "flat_geometry": "first"},
        }
    },
    "lag": {"detector": {"lag": 0.3}},
    "scatter": {"detector": {"scatter": {"kind": "monte_carlo"}}},
    "grid": {"detector": {"scatter": {"kind": "monte_carlo"}, "grid": GRID}},
    "bowtie": {"source": {"spectrum": TUBE, "bowtie": BOWTIE}},
}
HEAD: dict[str, Any] = {
    "source": {"spectrum": TUBE},
    "detector": {"columns": 160, "rows": 120, "pixel_pitch_mm": 2.0},
    "trajectory": {"kind": "sinusoid", "views": 60},
    "specimen": {
        "parts": [
            {
                "shape": {"kind": "ellipsoid", "semi_axes_mm": [48, 61, 44]},
                "material": "soft_tissue",
                "position_mm": [0, 0, 15],
            },
            {"shape": {"kind": "skull", "scale": 0.7}, "material": "bone"},
        ]
    },
    "reconstruction": {
        "algorithm": "cgls",
        "geometry": "executed",
        "grid": {"voxels": 128, "voxel_mm": 1.24},
    },
}
"""A small head: the beam hardening pictures need two materials and no truncation."""
CORRECTIONS: dict[str, Any] = {
    "uncorrected": None,
    "one_material": {"kind": "one_material", "material": "bone"},
    "two_materials": {"kind": "two_materials"},
}
TURN_DEG = 4.0
"""Rotation during the exposure, for motion; half the rotation since the previous view, for lag."""


def scenario(effect: Mapping[str, Mapping[str, Any]]) -> Scenario:
    """Return the base scenario with one effect."""
    data: dict[str, Any] = dict(BASE)
    for section, keys in effect.items():
        data[section] = {**data.get(section, {}), **keys}
    return parse_scenario(data)


def turned(view: ScanGeometry, degrees: float) -> ScanGeometry:
    """Return the view with source and panel rotated about z."""
    return Pose.from_euler((0, 0, 0), (0, 0, degrees)) @ view


def posed(views: ScanGeometry, specimen: Pose) -> PosePairs:
    """Return the poses of views at which the specimen stands still."""
    return replace(PosePairs.from_geometry(views), object=(specimen,) * len(views))


def take(builder: SimulationBuilder) -> NDArray[np.float32]:
    """Return the image of the middle view, with all effects of the scenario."""
    view = builder.commanded[1]
    pose = builder.specimen.world_from_specimen
    samples = builder.scenario.source.motion_samples
    shares = (np.arange(samples) + 0.5) / samples - 0.5
    turns = [turned(view, TURN_DEG * share) for share in shares]
    path = posed(ScanGeometry.joined(turns), pose)
    before = posed(turned(view, -2 * TURN_DEG), pose) if builder.scenario.detector.lag else None
    with builder.imager() as imager:
        return imager.expose(path, 1, before)


def draw(name: str, ideal: NDArray[np.float32], image: NDArray[np.float32]) -> None:
    """Draw the ideal image, the image with the effect and their difference."""
    difference = image - ideal
    limit = max(float(np.quantile(np.abs(difference), 0.995)), 1e-6)
    figure, axes = plt.subplots(1, 3, figsize=(9.6, 2.7), layout="constrained")
    for axis, pixels, title in (
        (axes[0], ideal, "ideal"),
        (axes[1], image, name.replace("_", " ")),
    ):
        axis.imshow(pixels, cmap="gray", vmin=0, vmax=1.05, origin="lower")
        axis.set_title(title, fontsize=9)
    shown = axes[2].imshow(difference, cmap="RdBu", vmin=-limit, vmax=limit, origin="lower")
    axes[2].set_title("difference of transmission", fontsize=9)
    figure.colorbar(shown, ax=axes[2], shrink=0.85).ax.tick_params(labelsize=7)
    for axis in axes:
        axis.set_axis_off()
    figure.savefig(
        FOLDER / f"physics-{name.replace('_', '-')}.png", dpi=80, pil_kwargs={"optimize": True}
    )
    plt.close(figure)


def draw_hardening() -> None:
    """Draw a slice of the ground truth, and the error of the volume with each correction."""
    base = parse_scenario(HEAD)
    builder = SimulationBuilder(base)
    scan = simulate(base, builder=builder)
    grid = base.reconstruction.grid.volume_grid
    truth = builder.specimen.truth(grid, effective_energy_kev(base.source, base.detector))
    middle = truth.shape[0] * 5 // 8
    slices = {}
    for name, correction in CORRECTIONS.items():
        section = base.reconstruction.model_dump() | {"beam_hardening": correction}
        corrected = parse_scenario(HEAD | {"reconstruction": section})
        volume = reconstruct(scan.with_settings(corrected)).array
        slices[name] = (volume[middle] - truth[middle]) * MM_PER_CM
    figure, axes = plt.subplots(1, 4, figsize=(9.6, 2.7), layout="constrained")
    shown = axes[0].imshow(truth[middle] * MM_PER_CM, cmap="gray", origin="lower")
    axes[0].set_title("truth, 1/cm", fontsize=9)
    figure.colorbar(shown, ax=axes[0], shrink=0.7).ax.tick_params(labelsize=7)
    for axis, (name, pixels) in zip(axes[1:], slices.items(), strict=True):
        shown = axis.imshow(pixels, cmap="RdBu", vmin=-0.1, vmax=0.1, origin="lower")
        axis.set_title(f"{name} - truth", fontsize=9)
    figure.colorbar(shown, ax=axes[1:], shrink=0.7).ax.tick_params(labelsize=7)
    for axis in axes:
        axis.set_axis_off()
    figure.savefig(FOLDER / "physics-beam-hardening.png", dpi=80, pil_kwargs={"optimize": True})
    plt.close(figure)


def main() -> None:
    """Draw the effects given on the command line, or all."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    wanted = sys.argv[1:] or [*EFFECTS, "beam_hardening"]
    ideal = take(SimulationBuilder(scenario({})))
    for name in wanted:
        if name == "beam_hardening":
            draw_hardening()
            continue
        image = take(SimulationBuilder(scenario(EFFECTS[name])))
        coarse = ideal.shape[0] // image.shape[0]
        draw(name, ideal, image.repeat(coarse, axis=0).repeat(coarse, axis=1))


if __name__ == "__main__":
    main()
