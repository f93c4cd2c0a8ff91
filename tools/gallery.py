"""Pictures of the X-ray physics on the skull, for docs/physics.md: one for each effect.

Each shows the ideal image, the image with the effect, and their difference, as line integrals or
transmission; all in one view of the paper's geometry on a coarser panel.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import numpy as np
from matplotlib import pyplot as plt
from numpy.typing import NDArray

from twinct.geometry import Pose, ScanGeometry
from twinct.scan import Workshop
from twinct.scenario import Scenario, parse_scenario

FOLDER = Path(__file__).parents[1] / "docs" / "images"
TUBE = {"kind": "tube", "kvp": 80}
BASE = {
    "detector": {"columns": 320, "rows": 240, "pixel_pitch_mm": 1.0},
    "trajectory": {"kind": "sinusoid", "views": 3, "centre_longitude_deg": 60},
    "specimen": {"parts": [{"shape": {"kind": "skull"}, "material": "bone"}]},
}
EFFECTS: dict[str, dict[str, Mapping[str, Any]]] = {
    "spectrum": {"source": {"spectrum": TUBE}},
    "response": {
        "source": {"spectrum": TUBE},
        "detector": {"response": {"kind": "scintillator", "thickness_mm": 0.2}},
    },
    "focal_spot": {"source": {"focal_spot": {"kind": "gaussian", "sigma_mm": 1.5, "samples": 32}}},
    "motion": {"source": {"motion_samples": 24}},
    "pixel_samples": {"detector": {"pixel_samples": 4}},
    "point_spread": {"detector": {"point_spread": {"kind": "gaussian", "sigma_mm": 2.0}}},
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
    "scatter": {"detector": {"scatter": {"kind": "kernel"}}},
}
TURN_DEG = 4.0
"""Between the last view and this one, for lag, and during the exposure, for motion."""


def scenario(effect: Mapping[str, Mapping[str, Any]]) -> Scenario:
    """The base with one effect."""
    data: dict[str, Any] = dict(BASE)
    for section, keys in effect.items():
        data[section] = {**data.get(section, {}), **keys}
    return parse_scenario(data)


def turned(view: ScanGeometry, degrees: float) -> ScanGeometry:
    """Source and panel turned about z."""
    return Pose.from_euler((0, 0, 0), (0, 0, degrees)) @ view


def take(workshop: Workshop) -> NDArray[np.float32]:
    """The middle view, with whatever the scenario asks for."""
    view = workshop.commanded[1]
    pose = workshop.specimen.world_from_specimen
    samples = workshop.scenario.source.motion_samples
    shares = (np.arange(samples) + 0.5) / samples - 0.5
    path = [(turned(view, TURN_DEG * share), pose) for share in shares]
    before = (turned(view, -2 * TURN_DEG), pose) if workshop.scenario.detector.lag else None
    with workshop.imager() as imager:
        return imager.expose(path, 1, before)


def draw(name: str, ideal: NDArray[np.float32], image: NDArray[np.float32]) -> None:
    """Ideal image, image with the effect, difference."""
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


def main() -> None:
    """Draw every effect."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    ideal = take(Workshop(scenario({})))
    for name, effect in EFFECTS.items():
        draw(name, ideal, take(Workshop(scenario(effect))))
        print(f"physics-{name.replace('_', '-')}.png")


if __name__ == "__main__":
    main()
