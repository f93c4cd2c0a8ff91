"""Picture of the effects of a scenario's errors on its geometry."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from twinct.geometry import Floats
from twinct.report.figures import png
from twinct.report.style import (
    DETECTOR_COLOUR,
    LIMIT_COLOUR,
    SOURCE_COLOUR,
    STYLE,
    WIDTH,
    Picture,
)

_PANELS = (
    ("displacement / mm", {"source_mm": SOURCE_COLOUR, "detector_mm": DETECTOR_COLOUR}),
    ("turn / deg", {"source_deg": SOURCE_COLOUR, "detector_deg": DETECTOR_COLOUR}),
    ("shift of the image / px", {"isocentre_px": LIMIT_COLOUR, "region_px": "#3d7a4d"}),
)


def errors_picture(
    figures: Mapping[str, Floats], terms: Sequence[Mapping[str, Any]], title: str
) -> Picture:
    """Plot errors over the views, 5 to 95 % of the draws and their median, and their causes.

    Args:
        figures: each figure, (draws, views).
        terms: name and single effect of each cause.
        title: title of the picture.
    """
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 6.4), layout="constrained")
        figure.suptitle(title, x=0.01, ha="left", fontsize=10)
        axes: Any = figure.subplots(2, 2).ravel()
        for on, (label, shown) in zip(axes, _PANELS, strict=False):
            for name, colour in shown.items():
                if name not in figures:
                    continue
                low, middle, high = np.quantile(figures[name], [0.05, 0.5, 0.95], axis=0)
                views = np.arange(len(middle))
                on.fill_between(views, low, high, color=colour, alpha=0.2, lw=0)
                on.plot(views, middle, color=colour, lw=1.3, label=name.rsplit("_", 1)[0])
            on.set_xlabel("view")
            on.set_ylabel(label)
            on.set_ylim(bottom=0)
            on.legend(loc="best")
        causes = axes[3]
        names = [str(row["term"]) for row in terms][::-1]
        values = [row["region_px"] or row["isocentre_px"] for row in terms][::-1]
        causes.barh(names, values, color=LIMIT_COLOUR, height=0.6)
        causes.set_xlabel("shift of the image by each cause alone, RMS / px")
        return png(figure, 110)
