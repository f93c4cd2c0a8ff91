"""Output of a reach as tables, and as pictures on the sphere and in the cell."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np

from twinct.core.files.writing import complete, write_json
from twinct.geometry import Floats
from twinct.robots.cell import CellModel, Marks, render_cell
from twinct.robots.reach.sphere import Reach

MAP = "viridis"

NOBODY_RGBA = (0.45, 0.45, 0.45, 0.35)
"""Colour of unreachable directions in the cell."""

CAN, CANNOT = "tab:blue", "0.82"
"""Colours of directions on the sphere that an arm alone can hold and cannot hold."""


def shares(reach: Reach) -> list[dict[str, float]]:
    """Return for each radius the shares of directions and the median clearance and margin."""
    rows: list[dict[str, float]] = []
    for k, sod in enumerate(reach.sod_mm.tolist()):
        row = {"sod_mm": sod, "odd_mm": reach.odd_mm, "directions": len(reach.directions)}
        row |= {
            f"{n}_share": float(getattr(reach, n)[k].mean()) for n in ("source", "detector", "both")
        }
        if reach.connected is not None:
            row["connected_share"] = float(reach.connected[k].mean())
        if reach.both[k].any():
            row["median_clearance_mm"] = float(np.nanmedian(reach.clearance_mm[k]))
            row["median_margin_deg"] = float(np.nanmedian(reach.margin_deg[k]))
        rows.append(row)
    return rows


def longitude_latitude_deg(directions: Floats) -> tuple[Floats, Floats]:
    """Return longitude in (-180, 180], 0 at +x, and latitude of unit vectors, (d, 3)."""
    x, y, z = directions.T
    return np.degrees(np.arctan2(y, x)), np.degrees(np.arcsin(z))


def write_tables(reach: Reach, folder: Path) -> None:
    """Write the shares to ``reach.json``, and one row per direction to ``reach.csv``."""
    write_json(
        folder / "reach.json", {"isocentre_mm": list(reach.isocentre_mm), "radii": shares(reach)}
    )
    longitude, latitude = longitude_latitude_deg(reach.directions)
    names = ["source", "detector", "both"] + ["connected"] * (reach.connected is not None)
    with (
        complete(folder / "reach.csv") as draft,
        draft.open("w", newline="", encoding="utf-8") as stream,
    ):
        table = csv.writer(stream)
        head = ["sod_mm", "longitude_deg", "latitude_deg", "x", "y", "z", *names]
        table.writerow([*head, "clearance_mm", "margin_deg"])
        for k, sod in enumerate(reach.sod_mm.tolist()):
            flags = [getattr(reach, name)[k].astype(int).tolist() for name in names]
            figures = [
                ["" if np.isnan(value) else f"{value:.2f}" for value in column]
                for column in (reach.clearance_mm[k], reach.margin_deg[k])
            ]
            place = np.round(np.column_stack([longitude, latitude]), 3).tolist()
            for where, towards, *rest in zip(
                place, reach.directions.tolist(), *flags, *figures, strict=True
            ):
                table.writerow([sod, *where, *(f"{x:.6f}" for x in towards), *rest])


def draw_sphere(reach: Reach, path: Path, radius: int = 0, title: str = "") -> None:
    """Write a picture (PNG) of one radius: each arm alone, both by clearance, and by margin.

    The directions to the source are drawn in Mollweide's equal-area projection.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    longitude, latitude = (np.radians(a) for a in longitude_latitude_deg(reach.directions))
    figure = Figure(figsize=(12, 6.2), layout="constrained")
    FigureCanvasAgg(figure)
    size = 9000 / len(longitude) + 2
    most_mm = _most(reach.clearance_mm[radius])
    both = reach.both[radius]
    joined = both if reach.connected is None else reach.connected[radius]
    panels: list[tuple[str, Any, Any]] = [
        (f"{side} arm alone: {100 * held.mean():.1f} %", held, None)
        for side, held in (
            ("source", reach.source[radius]),
            ("detector (panel opposite)", reach.detector[radius]),
        )
    ]
    ways = "" if reach.connected is None else f", {100 * joined.mean():.1f} % connected by paths"
    share = f"both: {100 * both.mean():.1f} %{ways}"
    panels += [
        (share, both, (reach.clearance_mm[radius], "clearance, mm", most_mm)),
        (
            "both: joint margin",
            both,
            (reach.margin_deg[radius], "to the end of a range, deg", None),
        ),
    ]
    for k, (text, held, figures) in enumerate(panels):
        axes: Any = figure.add_subplot(2, 2, k + 1, projection="mollweide")
        axes.scatter(
            longitude[~held], latitude[~held], s=size, c=CANNOT, linewidths=0, label="not held"
        )
        look: dict[str, Any] = {"c": CAN, "label": "held"}
        if figures is not None:
            look = {"c": figures[0][held], "cmap": MAP, "vmin": 0, "vmax": figures[2]}
        spots = axes.scatter(longitude[held], latitude[held], s=size, linewidths=0, **look)
        if figures is None:
            axes.legend(loc="lower right", fontsize=7, bbox_to_anchor=(1.08, 0), markerscale=2)
        else:
            figure.colorbar(spots, ax=axes, label=figures[1], shrink=0.7)
            apart = held & ~joined
            joint = "not connected by paths" if apart.any() else None
            axes.scatter(
                *(longitude[apart], latitude[apart]),
                s=size,
                facecolors="none",
                edgecolors="red",
                label=joint,
            )
            if joint:
                axes.legend(loc="lower right", fontsize=7, bbox_to_anchor=(1.08, 0))
        _label_globe(axes, text)
    figure.suptitle(f"{title}: SOD {reach.sod_mm[radius]:g} mm, ODD {reach.odd_mm:g} mm")
    with complete(path) as draft:
        figure.savefig(draft, dpi=110)


def _label_globe(axes: Any, title: str) -> None:
    axes.grid(alpha=0.4)
    axes.set_title(title, fontsize=10)
    axes.set_xlabel("longitude of the source, deg", fontsize=8)
    axes.set_ylabel("latitude, deg", fontsize=8)
    axes.tick_params(labelsize=7)
    axes.set_axisbelow(False)
    for label in axes.get_xticklabels():  # labels on the equator cover directions
        label.set_bbox({"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.8})


def draw_room(reach: Reach, cell: CellModel, path: Path, radius: int = 0, title: str = "") -> None:
    """Write a picture (PNG) of the cell with a ball at the source position of each direction.

    Balls of directions that both arms hold are coloured by clearance. The arms are drawn in the
    pair of configurations with the largest clearance.
    """
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure
    from PIL import Image

    held, gaps = reach.both[radius], reach.clearance_mm[radius]
    scale = Normalize(0, _most(gaps))
    colours = np.tile(NOBODY_RGBA, (len(held), 1))
    colours[held] = matplotlib.colormaps[MAP](scale(gaps[held]))
    points = reach.isocentre_mm + reach.sod_mm[radius] * reach.directions
    joints = reach.joints[radius, int(np.nanargmax(gaps))] if held.any() else None
    render_cell(cell, path, joints, marks=Marks(points=points, colours=colours, radius_mm=7))
    with Image.open(path) as drawn:
        picture = np.asarray(drawn)
    figure = Figure(figsize=(10, 6.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes: Any = figure.add_subplot()
    axes.imshow(picture)
    axes.set_axis_off()
    text = f"{title}: source at {reach.sod_mm[radius]:g} mm, panel opposite at {reach.odd_mm:g} mm"
    axes.set_title(f"{text}\ncoloured: both arms can hold the view; grey: they cannot", fontsize=10)
    colours_of = ScalarMappable(scale, MAP)
    figure.colorbar(colours_of, ax=axes, label="clearance, mm", shrink=0.8)
    with complete(path) as draft:
        figure.savefig(draft, dpi=130)


def _most(clearance_mm: Floats) -> float:
    """Return the upper end of the colour scale: the largest clearance, rounded up to 10 mm."""
    return 10 * float(np.ceil(np.nanmax(clearance_mm, initial=1.0) / 10))
