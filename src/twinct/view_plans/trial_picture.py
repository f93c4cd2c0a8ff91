"""Picture of volumes from planned views beside others: slices through the region."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinct.core.files.writing import complete
from twinct.geometry import Floats

MARGIN = 3.0
"""Half the width of a slice, in radii of the region; at least ``LEAST_MM``."""

LEAST_MM = 25.0


def draw_tried(
    path: Path,
    title: str,
    volumes: Mapping[str, NDArray[Any]],
    axes: tuple[Floats, Floats, Floats],
    place: tuple[float, float, float],
    radius_mm: float,
) -> None:
    """Write the picture (PNG): two slices of each volume, all in the grey window of the first.

    Args:
        path: file to write.
        title: title of the picture.
        volumes: volumes by name, (z, y, x), 1/mm; the first is the truth.
        axes: centres of the voxels along x, y and z, mm.
        place: centre of the region, x, y, z, mm.
        radius_mm: radius of the region.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.patches import Circle

    half = max(LEAST_MM, MARGIN * radius_mm)
    parts = [
        np.flatnonzero(np.abs(axis - at) <= half) for axis, at in zip(axes, place, strict=True)
    ]
    x, y, z = (slice(int(part[0]), int(part[-1]) + 1) for part in parts)
    at = [int(np.abs(axis - middle).argmin()) for axis, middle in zip(axes, place, strict=True)]
    truth = next(iter(volumes.values()))[z, y, x]
    window = {"vmin": 0.0, "vmax": float(np.quantile(truth, 0.995)) * 1.1 or 1.0}
    figure = Figure(figsize=(3.4 * len(volumes) + 0.8, 6.8), layout="constrained")
    FigureCanvasAgg(figure)
    every: Any = figure.subplots(2, len(volumes), squeeze=False)
    for column, (name, volume) in zip(every.T, volumes.items(), strict=True):
        for axis, image, (row, col), (up, across) in (
            (column[0], volume[at[2], y, x], (1, 0), ("y", "x")),
            (column[1], volume[z, at[1], x], (2, 0), ("z", "x")),
        ):
            low, high = axes[col], axes[row]
            extent = (
                low[parts[col][0]],
                low[parts[col][-1]],
                high[parts[row][0]],
                high[parts[row][-1]],
            )
            axis.imshow(image, cmap="gray", origin="lower", extent=extent, **window)
            axis.add_patch(Circle((place[col], place[row]), radius_mm, fill=False, ec="tab:orange"))
            axis.set_xlabel(f"{across}, mm")
            axis.set_ylabel(f"{up}, mm")
        column[0].set_title(name, fontsize=10)
    figure.colorbar(every[0, 0].images[0], ax=every, label="attenuation, 1/mm", shrink=0.6)
    figure.suptitle(title)
    with complete(path) as draft:
        figure.savefig(draft, dpi=110)
