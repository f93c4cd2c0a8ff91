"""Draw docs/images/head_sections.png: ground truth of the head with screws, in five planes.

python docs/pictures/head.py
"""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure

from twinct.geometry import Pose, VolumeGrid
from twinct.scenario import load_scenario
from twinct.specimen import build_specimen, material

ROOT = Path(__file__).parents[2]
KEV = 60.0
PLANES = (("z", 8.0), ("z", -6.5), ("z", -76.8), ("x", -32.2), ("y", 68.3))
"""Planes: inserts in a narrow window, petrous screw, jaw screw, left eye and jaw, both eyes."""


def main() -> None:
    """Build the specimen, sample its ground truth in each plane and draw the sections."""
    specimen = build_specimen(load_scenario(ROOT / "scenarios" / "head_screws.yaml").specimen)
    brain, bone = (material(name).mu_per_mm(KEV) for name in ("brain", "bone"))
    figure = Figure(figsize=(14, 3.9), facecolor="white", layout="constrained")
    for panel, (axis, at) in zip(figure.subplots(1, len(PLANES)), PLANES, strict=True):
        size, place = {"x": 160, "y": 210, "z": 220}, [0.0, 0.0, 0.0]
        size[axis], place["xyz".index(axis)] = 2, at
        grid = VolumeGrid((size["z"], size["y"], size["x"]), 1.0, Pose.from_euler(place, (0, 0, 0)))
        truth = specimen.truth(grid, KEV, Pose.identity())
        across, up = (a for a in "xyz" if a != axis)
        low, high = (0.95 * brain, 1.05 * brain) if (axis, at) == PLANES[0] else (0, 1.2 * bone)
        extent = (-size[across] / 2, size[across] / 2, -size[up] / 2, size[up] / 2)
        panel.imshow(
            truth.take(0, axis="zyx".index(axis)),
            origin="lower",
            extent=extent,
            vmin=low,
            vmax=high,
            cmap="gray",
        )
        panel.set(xlabel=f"{across}, mm", ylabel=f"{up}, mm")
        panel.set_title(f"{axis} = {at:g} mm\n{low:.4f} to {high:.4f} per mm", fontsize=9)
    figure.savefig(ROOT / "docs" / "images" / "head_sections.png", dpi=80)


if __name__ == "__main__":
    main()
