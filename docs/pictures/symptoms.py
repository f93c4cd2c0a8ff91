"""Draw what can be wrong with a volume, and the same volume repaired, for docs/howto/symptoms.md.

Each picture shows a section with the symptom and one without, in the same grey window.

    python docs/pictures/symptoms.py                # all
    python docs/pictures/symptoms.py rings streaks  # some
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import numpy as np
from matplotlib import pyplot as plt
from numpy.typing import NDArray

from twinct.runs import reconstruct, simulate
from twinct.scan import Scan

FOLDER = Path(__file__).parents[2] / "docs" / "images"
VIEWS = 120
HEIGHT_MM = 5
"""Height of the body, within the grid."""
EDGE_IN, DPI = 1.6, 100
WHITE = 2.5
"""Brightest value of the window, in medians of the body."""

BODY = {"shape": {"kind": "cylinder", "radius_mm": 42, "height_mm": HEIGHT_MM}, "material": "water"}
RODS = [
    {
        "shape": {"kind": "cylinder", "radius_mm": radius, "height_mm": HEIGHT_MM},
        "material": "bone",
        "position_mm": [x, y, 0],
    }
    for radius, x, y in ((8, 20, 0), (5, -8, 22), (3, -18, -14), (2, 4, -26), (4, -28, 6))
]
SCENE = {
    "specimen.parts": [BODY, *RODS],
    "xray.engine": "mesh",
    "trajectory.views": VIEWS,
    "detector": {"columns": 160, "rows": 12, "pixel_pitch_mm": 1.5},
    "reconstruction": {
        "algorithm": "fdk",
        "grid": {"voxels": [128, 128, 8], "voxel_mm": 0.9},
    },
}


def _scan(**changes: Any) -> Scan:
    return simulate("circle_gantry", **(SCENE | changes))


def _section(scan: Scan, **settings: Any) -> NDArray[np.float32]:
    volume = reconstruct(scan, **settings).array
    return volume[len(volume) // 2]


def _pair(scan: Scan, wrong: dict[str, Any], right: dict[str, Any]) -> tuple[Any, Any]:
    return _section(scan, **wrong), _section(scan, **right)


def double_edges() -> tuple[Any, Any]:
    """Let the panel stand three pixels beside where the system believes."""
    scan = _scan()
    aside = replace(scan, transmission=np.roll(scan.transmission, 3, axis=2))
    return _section(aside), _section(scan)


def streaks() -> tuple[Any, Any]:
    """Take rods of titanium, and replace their shadows."""
    metal = [part | {"material": "titanium"} for part in RODS[:2]]
    tube = {"kind": "tube", "kvp": 100, "filters": [{"material": "aluminium", "thickness_mm": 3}]}
    scan = _scan(**{"specimen.parts": [BODY, *metal, *RODS[2:]], "source.spectrum": tube})
    return _pair(scan, {}, {"metal": {"method": "nmar", "metal": "titanium"}})


def cups() -> tuple[Any, Any]:
    """Put a cylinder of aluminium into the beam of a tube."""
    body = BODY | {"material": "aluminium"}
    scan = _scan(**{"specimen.parts": [body], "source.spectrum": {"kind": "tube", "kvp": 80}})
    return _pair(scan, {}, {"beam_hardening": {"kind": "one_material"}})


def rings() -> tuple[Any, Any]:
    """Make the signal of each pixel wrong by a few percent in every view."""
    scan = _scan()
    gain = np.random.default_rng(3).normal(1, 0.04, scan.transmission.shape[1:])
    wrong = replace(scan, transmission=(scan.transmission * gain).astype(np.float32))
    return _section(wrong), _section(scan)


def truncation() -> tuple[Any, Any]:
    """Take a grid that is smaller than the body."""
    scan = _scan()
    small = {"voxels": [72, 72, 8], "voxel_mm": 0.9}
    around = {"margin_mm": 20, "voxel_mm": 1.8}
    sart = {"algorithm": "sart", "iterations": 5, "grid": small}
    return _pair(scan, sart, sart | {"surroundings": around})


def mirrored() -> tuple[Any, Any]:
    """Swap the columns of the panel."""
    scan = _scan()
    flipped = replace(scan, transmission=scan.transmission[:, :, ::-1].copy())
    return _section(flipped), _section(scan)


def motion() -> tuple[Any, Any]:
    """Move the body by 3 mm in the middle of the scan."""
    scan = _scan()
    aside = _scan(**{"specimen.position_mm": [3, 0, 0]})
    half = VIEWS // 2
    moved = np.concatenate([scan.transmission[:half], aside.transmission[half:]])
    return _section(replace(scan, transmission=moved)), _section(scan)


def starved() -> tuple[Any, Any]:
    """Reconstruct 15 views by SART, and with a penalty on the variation."""
    scan = _scan(**{"trajectory.views": 15})
    sart, variation = {"algorithm": "sart", "iterations": 10}, {"algorithm": "fista_tv"}
    return _pair(scan, sart, variation)


SYMPTOMS: dict[str, Callable[[], tuple[Any, Any]]] = {
    one.__name__: one
    for one in (double_edges, streaks, cups, rings, truncation, mirrored, motion, starved)
}


def draw(name: str) -> None:
    """Write the picture of a symptom."""
    wrong, right = SYMPTOMS[name]()
    window = {
        "vmin": 0,
        "vmax": float(WHITE * np.median(right[right > right.max() / 50])),
        "cmap": "gray",
    }
    figure, axes = plt.subplots(1, 2, figsize=(2 * EDGE_IN, EDGE_IN), dpi=DPI)
    for axis, section in zip(axes, (wrong, right), strict=True):
        axis.imshow(section, origin="lower", **window)
        axis.set_axis_off()
    figure.subplots_adjust(0, 0, 1, 1, 0.02, 0)
    figure.savefig(FOLDER / f"symptom-{name.replace('_', '-')}.png")
    plt.close(figure)


if __name__ == "__main__":
    for chosen in sys.argv[1:] or SYMPTOMS:
        draw(chosen)
        print(chosen)
