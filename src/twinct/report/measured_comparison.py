"""Comparison of measured scans and their volumes on one page, without any figure of a truth."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np

from twinct.report.comparison import Compared, Comparison, Row, row_of, time_rows
from twinct.report.data import CrossSection
from twinct.report.measured_page import FIGURES
from twinct.report.style import STYLE, WIDTH, Picture
from twinct.report.template import fixed


@dataclass(frozen=True)
class MeasuredComparison(Comparison):
    """Volumes of measured scans to compare, the reference first."""

    kicker: ClassVar[str] = "Measured CT scan"
    about_slices: ClassVar[str] = (
        "All volumes show the same planes of the first one's frame, in one window, each in its own "
        "voxels; below, the difference from the first, where both have the same voxels."
    )

    @property
    def notes(self) -> list[str]:
        """Reasons why some figures cannot be compared."""
        first, *others = self.compared
        sentences: list[str] = []
        for one in others:
            both = f"{one.label} and {first.label}"
            if one.truth != first.truth:
                sentences.append(
                    f"{both} are volumes of different images: their residuals have no common scale."
                )
            grids = (each.scenario.reconstruction.volume_grid for each in (one, first))
            if len({repr(grid) for grid in grids}) > 1:
                sentences.append(f"{both} have different grids: each is judged in its own voxels.")
        return sentences

    def tables(self) -> dict[str, list[Row]]:
        """Return the rows of figures that need no truth, and of the seconds."""
        alike = [one.truth == self.compared[0].truth for one in self.compared]
        rows = [
            row_of(
                figure.title,
                figure.unit,
                [one.image.get(key) for one in self.compared],
                partial(fixed, digits=figure.digits, factor=figure.factor),
                figure.meaning,
                alike,
            )
            for key, figure in FIGURES.items()
        ]
        seconds = [row for row in time_rows(self.compared) if row.title == "reconstruction"]
        return {"What can be judged": rows, "Time": seconds}

    def pictures(self) -> list[tuple[str, str]]:
        """Return a title and the address of an image for each plane."""
        first = self.compared[0]
        values = [
            section.reconstruction[np.isfinite(section.reconstruction)]
            for one in self.compared
            for section in one.slices.values()
            if section is not None
        ]
        top = max([float(np.percentile(each, 99.5)) for each in values if each.size] or [1.0])
        return [
            (f"{name}, {section.position}", _drawn(name, self.compared, max(top, 1e-6)).data_uri)
            for name, section in first.slices.items()
            if section is not None
        ]


def _drawn(name: str, compared: tuple[Compared, ...], top: float) -> Picture:
    """Draw a plane of all volumes, and their differences from the first."""
    import matplotlib as mpl
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

    from twinct.report.figures import png

    sections = [one.slices[name] for one in compared]
    first = sections[0]
    assert first is not None
    grey = ScalarMappable(Normalize(0, top), "gray")
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 2.2 + 1.6 * WIDTH / len(compared)), layout="constrained")
        grid: Any = figure.subplots(2, len(compared), squeeze=False)
        for column, (one, section) in enumerate(zip(compared, sections, strict=True)):
            above, below = grid[:, column]
            below.set_visible(False)
            above.set_title(one.label, weight="bold")
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
