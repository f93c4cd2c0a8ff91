"""Picture of the residuals over the iterations of a reconstruction."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter, MaxNLocator

from twinct.report.figures import svg
from twinct.report.style import DETECTOR_COLOUR, LIMIT_COLOUR, SOURCE_COLOUR, STYLE, Picture


class _PlainNumbers(LogFormatter):
    """Labels of a logarithmic axis as plain numbers: 0.6 and not 6 x 10^-1."""

    def _num_to_string(self, x: float, vmin: float, vmax: float) -> str:
        return f"{x:g}"


def convergence(residuals: Mapping[str, Sequence[float]]) -> Picture:
    """Plot the residual of the line integrals over the iterations, for each geometry."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(5.6, 2.6), layout="constrained")
        axes: Any = figure.subplots()
        colours = SOURCE_COLOUR, DETECTOR_COLOUR, LIMIT_COLOUR
        for (geometry, course), colour in zip(residuals.items(), colours, strict=False):
            numbers = np.arange(1, len(course) + 1)
            axes.semilogy(numbers, course, color=colour, marker="o", ms=3, lw=1.1, label=geometry)
        axes.set_xlabel("iteration")
        axes.set_ylabel("residual (RMS)")
        for part in (axes.yaxis.set_major_formatter, axes.yaxis.set_minor_formatter):
            part(_PlainNumbers())
        axes.xaxis.set_major_locator(MaxNLocator(10, integer=True))
        axes.grid(axis="y", which="both", color="#e4e7eb", lw=0.7)
        axes.set_axisbelow(True)
        axes.legend(loc="upper right", borderpad=0)
        return svg(figure)
