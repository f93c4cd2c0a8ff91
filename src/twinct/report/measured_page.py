"""Page of a measured scan: what can be judged without a truth, and no other figure."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinct.core.files.writing import write_text
from twinct.geometry import ScanGeometry
from twinct.recon.volume import Volume
from twinct.report.style import STYLE, WIDTH, Picture
from twinct.report.template import rendered
from twinct.scenario import Scenario
from twinct.version import __version__


@dataclass(frozen=True, eq=False)
class MeasuredColumn:
    """A reconstruction of a measured scan.

    Attributes:
        name: name of the reconstruction.
        in_words: algorithm, settings and geometry in one line.
        figures: figures without a truth, by their keys in ``FIGURES``; NaN if unknown.
        residual_by_view: relative residual of each view.
        residuals: residual of each iteration.
        seconds: duration.
        volume: the volume, 1/mm.
    """

    name: str
    in_words: str
    figures: Mapping[str, float]
    residual_by_view: Sequence[float]
    residuals: Sequence[float]
    seconds: float
    volume: Volume


class _ColumnText(NamedTuple):
    title: str
    unit: str
    meaning: str
    factor: float = 1.0
    digits: int = 3


FIGURES = {
    "residual_rel": _ColumnText(
        "residual",
        "%",
        "line integrals of images less volume (RMS), relative to the images",
        100,
        2,
    ),
    "residual": _ColumnText("residual", "", "this difference as a line integral", 1, 4),
    "consistency_rel": _ColumnText(
        "consistency",
        "%",
        "residual of views that the volume of the others predicts (--halves)",
        100,
        2,
    ),
    "edge_width_mm": _ColumnText(
        "edge width", "mm", "median 10–90 % rise across the volume's own surface (Otsu's threshold)"
    ),
    "noise_per_mm": _ColumnText(
        "noise", "1/mm", "standard deviation, from volumes of every other view (--halves)", 1, 5
    ),
}


class _Row(NamedTuple):
    title: str
    cells: list[str]
    unit: str
    meaning: str


def write_measured_report(
    path: Path,
    scenario: Scenario,
    scenario_yaml: str,
    geometry: ScanGeometry,
    projections: Sequence[tuple[int, NDArray[np.floating]]],
    columns: Sequence[MeasuredColumn],
    predictions: Sequence[tuple[str, Picture]] = (),
) -> None:
    """Write the page of a measured scan, completely or not at all.

    Args:
        path: file of the page.
        scenario: scenario beside the scan.
        scenario_yaml: the same as text.
        geometry: the views as imported.
        projections: a few views, (view, transmission (row, column)).
        columns: the reconstructions.
        predictions: predicted views in words, and their picture.
    """
    from twinct.report import figures
    from twinct.report.convergence import convergence

    courses = {one.name: one.residuals for one in columns if len(one.residuals) > 1}
    source = np.asarray(geometry.source)
    page = rendered(
        "measured_page.html",
        name=scenario.name,
        description=scenario.description,
        views=len(geometry),
        panel=geometry.panel,
        columns=columns,
        rows=[_row(key, columns) for key in FIGURES],
        slices=[(one.name, picture.data_uri) for one, picture in _slices(columns)],
        residuals=_by_view(columns).data_uri,
        convergence=convergence(courses).data_uri if courses else "",
        predictions=[(words, picture.data_uri) for words, picture in predictions],
        projections=figures.projection_strip(projections, geometry.panel).data_uri,
        path=figures.source_path(source, source, np.zeros(3)).data_uri,
        scenario_yaml=scenario_yaml,
        version=__version__,
    )
    write_text(path, page)


def _row(key: str, columns: Sequence[MeasuredColumn]) -> _Row:
    text = FIGURES[key]
    values = (one.figures[key] for one in columns)
    cells = [f"{text.factor * x:.{text.digits}f}" if math.isfinite(x) else "–" for x in values]
    return _Row(text.title, cells, text.unit, text.meaning)


def _slices(columns: Sequence[MeasuredColumn]) -> list[tuple[MeasuredColumn, Picture]]:
    top = max(float(np.percentile(one.volume.array[::3, ::3, ::3], 99.5)) for one in columns)
    return [(one, _planes(one.volume, max(top, 1e-6))) for one in columns]


def _planes(volume: Volume, top: float) -> Picture:
    """Draw the three planes through the middle of a grid, axes in the grid's own frame."""
    import matplotlib as mpl
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

    from twinct.report.figures import png

    names, half, norm = "xyz", volume.grid.size_mm / 2, Normalize(0, top)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 3.9), layout="constrained")
        grid: Any = figure.subplots(1, 3)
        for axes, normal in zip(grid, (0, 1, 2), strict=True):
            up, right = (2 - axis for axis in range(3) if axis != normal)
            image = np.take(volume.array, volume.shape[normal] // 2, axis=normal)
            extent = (-half[right], half[right], -half[up], half[up])
            axes.imshow(image, cmap="gray", norm=norm, origin="lower", extent=extent)
            axes.set(xlabel=f"{names[right]} / mm", ylabel=f"{names[up]} / mm")
        figure.colorbar(ScalarMappable(norm, "gray"), ax=grid, label="1/mm", shrink=0.8)
        return png(figure, 120)


def _by_view(columns: Sequence[MeasuredColumn]) -> Picture:
    import matplotlib as mpl
    from matplotlib.figure import Figure

    from twinct.report.figures import svg

    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 2.4), layout="constrained")
        axes: Any = figure.subplots()
        for one in columns:
            axes.plot(100 * np.asarray(one.residual_by_view), lw=1, label=one.name)
        axes.set(xlabel="view", ylabel="residual / %")
        axes.set_ylim(bottom=0)
        axes.legend(loc="upper right")
        return svg(figure)
