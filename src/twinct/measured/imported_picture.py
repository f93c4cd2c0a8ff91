"""Picture of an imported scan: views, source's path, and what its pixels are worth."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinct.measured.looks import Looks
from twinct.measured.orientation import PanelPlacement
from twinct.scan import Scan, line_integrals

SIZE_IN = 10.4, 12.6

MOST_DOTS = 72
"""Largest number of views whose places a picture shows: more dots would run together."""


def draw_imported(scan: Scan, placement: PanelPlacement, looks: Looks, figure: Any) -> None:
    """Draw three views, mean and extremes of all, air, repaired pixels, and the path from above."""
    chosen = [0, len(scan) // 3, 2 * len(scan) // 3]
    panel = scan.settings.detector.panel
    images: NDArray[np.float32] = line_integrals(scan.transmission[chosen])
    width, height = panel.size_mm
    extent = (-width / 2, width / 2, -height / 2, height / 2)

    def picture(at: Any, image: NDArray[Any], title: str, colours: str = "gray") -> Any:
        at.set(title=title, xlabel="u / mm", ylabel="v / mm")
        return at.imshow(image, cmap=colours, origin="lower", extent=extent)

    views, all_views, pixels, above = figure.subfigures(4, 1, height_ratios=(1.0, 1.0, 1.0, 1.3))
    for at, view, image in zip(views.subplots(1, 3), chosen, images, strict=True):
        picture(at, image, f"view {view}")
    of_all = {
        "mean view": looks.mean / len(scan),
        "smallest line integrals": looks.most,
        "largest line integrals": looks.least,
    }
    for at, (title, image) in zip(all_views.subplots(1, 3), of_all.items(), strict=True):
        picture(at, line_integrals(placement.image(image).astype(np.float32)), title)
    at, there = pixels.subplots(1, 2)
    if looks.air is None:
        at.set_axis_off()
        at.set(title="no air is known")
    else:
        at.stairs(looks.histogram, looks.edges, fill=True, color="#2c6fb3")
        at.axvline(1.0, color="#b3452c")
        at.set(title="air", xlabel="transmission", ylabel="pixels", yscale="log")
    repaired = 100 * placement.image(looks.repaired / len(scan))
    shown = picture(there, repaired, "repaired pixels / % of the views", "inferno")
    pixels.colorbar(shown, ax=there)
    axes = above.subplots()
    geometry = scan.geometry()
    for points, name, colour in (
        (geometry.source, "source", "#b3452c"),
        (geometry.detector, "panel", "#2c6fb3"),
    ):
        some = points[:: -(-len(points) // MOST_DOTS)]
        axes.plot(some[:, 0], some[:, 1], ".", markersize=2, color=colour, label=name)
        axes.plot(*points[0, :2], "o", color=colour, label=f"{name}, view 0")
    axes.plot(0, 0, "k+", label="origin")
    axes.set(title="from above", xlabel="x / mm", ylabel="y / mm", aspect="equal")
    axes.legend(loc="upper left", bbox_to_anchor=(1.02, 1.0))
