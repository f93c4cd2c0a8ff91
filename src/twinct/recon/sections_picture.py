"""Three sections through a volume, as a picture, or in a notebook with a slider for each."""

from __future__ import annotations

import importlib
import io
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from twinct.core.files.pictures import show
from twinct.geometry import Floats, VolumeGrid
from twinct.recon.engine import Singles

SIZE_INCH = (10.4, 3.4)


def middle(grid: VolumeGrid) -> tuple[int, ...]:
    """Return the indices (x, y, z) of the voxel in the middle."""
    return tuple(n // 2 for n in grid.shape_xyz)


def draw_sections(
    array: Singles, grid: VolumeGrid, figure: Any, at: Sequence[int] | None = None
) -> None:
    """Draw the sections across z, y and x in one grey window.

    Args:
        array: voxels, (z, y, x).
        grid: their lattice.
        figure: an empty figure of matplotlib.
        at: indices (x, y, z) that the sections pass through; None: the middle.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    x, y, z = grid.axes()
    i, j, k = middle(grid) if at is None else at
    greys = ScalarMappable(Normalize(*np.percentile(array[::2, ::2, ::2], (0.1, 99.9))), "gray")
    for axes, section, (across, along), (up, upwards), (name, place) in zip(
        figure.subplots(1, 3),
        (array[k], array[:, j], array[:, :, i]),
        (("x", x), ("x", x), ("y", y)),
        (("y", y), ("z", z), ("z", z)),
        (("z", z[k]), ("y", y[j]), ("x", x[i])),
        strict=True,
    ):
        extent = (*_borders(along), *_borders(upwards))
        axes.imshow(section, cmap="gray", norm=greys.norm, origin="lower", extent=extent)
        axes.set(title=f"{name} = {place:.4g} mm", xlabel=f"{across} / mm", ylabel=f"{up} / mm")
    figure.colorbar(greys, ax=figure.axes, shrink=0.8, label="attenuation / mm⁻¹")


def show_with_sliders(array: Singles, grid: VolumeGrid, widgets: Any) -> None:
    """Show the sections in a notebook, with a slider for the place of each.

    Args:
        array: voxels, (z, y, x).
        grid: their lattice.
        widgets: the module ``ipywidgets``.
    """
    importlib.import_module("IPython.display").display(sections_with_sliders(array, grid, widgets))


def sections_with_sliders(array: Singles, grid: VolumeGrid, widgets: Any) -> Any:
    """Return the picture and its sliders as a widget."""
    picture = widgets.Image(format="png")
    sliders = [
        widgets.IntSlider(start, 0, number - 1, description=name, continuous_update=False)
        for name, start, number in zip("xyz", middle(grid), grid.shape_xyz, strict=True)
    ]

    def draw(change: object = None) -> None:
        drawn = io.BytesIO()
        at = [slider.value for slider in sliders]
        show(partial(draw_sections, array, grid, at=at), SIZE_INCH, drawn)
        picture.value = drawn.getvalue()

    for slider in sliders:
        slider.observe(draw, names="value")
    draw()
    return widgets.VBox([picture, widgets.HBox(sliders)])


def _borders(centres: Floats) -> tuple[float, float]:
    half = (centres[-1] - centres[0]) / max(len(centres) - 1, 1) / 2 or 0.5
    return float(centres[0] - half), float(centres[-1] + half)
