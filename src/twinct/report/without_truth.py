"""Figures and pictures of volumes without a truth: what they show by themselves."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from twinct.report.data import Another, CrossSection
from twinct.report.style import STYLE, WIDTH, Picture


class FigureText(NamedTuple):
    """Title, unit and meaning of a figure, and its display: times a factor, with some digits."""

    title: str
    unit: str
    meaning: str
    factor: float = 1.0
    digits: int = 3


FIGURES = {
    "residual_rel": FigureText(
        "residual",
        "%",
        "line integrals of images less volume (RMS), relative to the images",
        100,
        2,
    ),
    "residual": FigureText("residual", "", "this difference as a line integral", 1, 4),
    "consistency_rel": FigureText(
        "consistency",
        "%",
        "residual of views that the volume of the others predicts (--halves)",
        100,
        2,
    ),
    "edge_width_mm": FigureText(
        "edge width", "mm", "median 10–90 % rise across the volume's own surface (Otsu's threshold)"
    ),
    "noise_per_mm": FigureText(
        "noise", "1/mm", "standard deviation, from volumes of every other view (--halves)", 1, 5
    ),
}


class JudgedRow(NamedTuple):
    """One figure of all volumes, as text."""

    title: str
    cells: list[str]
    unit: str
    meaning: str


def judged_rows(volumes: Sequence[Another]) -> list[JudgedRow]:
    """Return the rows of the figures that need no truth."""
    rows: list[JudgedRow] = []
    for key, text in FIGURES.items():
        values = (one.figures.get(key) for one in volumes)
        cells = [
            "–" if x is None or not math.isfinite(x) else f"{text.factor * x:.{text.digits}f}"
            for x in values
        ]
        rows.append(JudgedRow(text.title, cells, text.unit, text.meaning))
    return rows


def top_of(sections: Sequence[CrossSection]) -> float:
    """Return the upper limit of a grey window for all sections, 1/mm."""
    values = [s.reconstruction[np.isfinite(s.reconstruction)] for s in sections]
    top = max([float(np.percentile(each, 99.5)) for each in values if each.size] or [1.0])
    return max(top, 1e-6)


def section_row(sections: Mapping[str, CrossSection], top: float) -> Picture:
    """Draw the planes of one volume beside each other, with scales in mm."""
    import matplotlib as mpl
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

    from twinct.report.figures import png

    norm = Normalize(0, top)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 3.9), layout="constrained")
        grid: Any = figure.subplots(1, len(sections), squeeze=False)[0]
        for axes, section in zip(grid, sections.values(), strict=True):
            extent = section.extent_mm
            axes.imshow(
                section.reconstruction, cmap="gray", norm=norm, origin="lower", extent=extent
            )
            axes.set(xlabel=f"{section.axes[0]} / mm", ylabel=f"{section.axes[1]} / mm")
            axes.set_title(section.position)
        figure.colorbar(ScalarMappable(norm, "gray"), ax=list(grid), label="1/mm", shrink=0.8)
        return png(figure, 120)


def residuals_by_view(volumes: Sequence[Another]) -> Picture:
    """Plot the residual of each view, for all volumes."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    from twinct.report.figures import svg

    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 2.4), layout="constrained")
        axes: Any = figure.subplots()
        for one in volumes:
            residuals: Any = one.figures["residual_by_view"]
            axes.plot(100 * np.asarray(residuals), lw=1, label=one.name)
        axes.set(xlabel="view", ylabel="residual / %")
        axes.set_ylim(bottom=0)
        axes.legend(loc="upper right")
        return svg(figure)


def differences(columns: Mapping[str, CrossSection | None], top: float) -> Picture:
    """Draw a plane of all volumes and, where both have the same voxels, its change from the first.

    Args:
        columns: section of each volume, by name; None if the plane misses its grid.
        top: upper limit of the grey window, 1/mm.
    """
    import matplotlib as mpl
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

    from twinct.report.figures import png

    first = next(section for section in columns.values() if section is not None)
    grey = ScalarMappable(Normalize(0, top), "gray")
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 2.2 + 1.6 * WIDTH / len(columns)), layout="constrained")
        grid: Any = figure.subplots(2, len(columns), squeeze=False)
        for column, (label, section) in enumerate(columns.items()):
            above, below = grid[:, column]
            below.set_visible(False)
            above.set_title(label, weight="bold")
            if section is None:
                above.text(0.5, 0.5, "outside the grid", ha="center", transform=above.transAxes)
                continue
            show = {"origin": "lower", "extent": section.extent_mm}
            above.imshow(section.reconstruction, cmap="gray", norm=grey.norm, **show)
            above.set(xlabel=f"{section.axes[0]} / mm", ylabel=f"{section.axes[1]} / mm")
            if column and _same_voxels(section, first):
                off = section.reconstruction - first.reconstruction
                below.set_visible(True)
                end = max(float(np.percentile(np.abs(off[np.isfinite(off)]), 99.5)), 1e-9)
                shown = below.imshow(off, cmap="RdBu_r", vmin=-end, vmax=end, **show)
                figure.colorbar(shown, ax=below, label="difference / mm⁻¹", shrink=0.8)
        figure.colorbar(grey, ax=grid[0].tolist(), label="1/mm", shrink=0.8)
        return png(figure, 120)


def _same_voxels(one: CrossSection, other: CrossSection) -> bool:
    return one.reconstruction.shape == other.reconstruction.shape and np.allclose(
        one.extent_mm, other.extent_mm
    )
