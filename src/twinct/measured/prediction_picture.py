"""Picture of predicted views beside the measured ones, and of what is left."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinct.core.files.pictures import show
from twinct.recon.residuals import CAUSES, Residuals

_IMAGE_INCH = 2.0
"""Width of one image in the picture; the picture is as high as three of them need."""

SHARE_SHOWN = 99.5
"""Percentile of the residuals at which their grey window ends."""


def show_prediction(
    path: Path, measured: NDArray[np.float32], predicted: NDArray[np.float32], residuals: Residuals
) -> None:
    """Draw the best, a median and the worst view, and the figures of all views.

    Args:
        path: file of the picture.
        measured: line integrals, (views, rows, columns).
        predicted: the same.
        residuals: their residuals.
    """
    rows, columns = measured.shape[1:]
    height = min(max(3 * (_IMAGE_INCH * rows / columns + 0.35), 5.0), 12.0)
    show(partial(_draw, measured, predicted, residuals), (11.0, height), path)


def _draw(
    measured: NDArray[np.float32], predicted: NDArray[np.float32], residuals: Residuals, figure: Any
) -> None:
    order = np.argsort([one.rms_rel for one in residuals.views])
    chosen = [int(order[0]), int(order[len(order) // 2]), int(order[-1])]
    pictures, curves = figure.subfigures(1, 2, width_ratios=(1.9, 1.0))
    top = max(float(np.percentile(measured[chosen], 99.9)), 1e-6)
    typical = np.percentile(np.abs(measured[chosen] - predicted[chosen]), SHARE_SHOWN)
    limit = max(float(typical), 1e-6)
    grid = pictures.subplots(3, 3)
    for row, (word, k) in enumerate(zip(("best", "median", "worst"), chosen, strict=True)):
        one = residuals.views[k]
        grey: dict[str, Any] = {"cmap": "gray", "vmin": 0, "vmax": top}
        given, again, left = grid[row]
        given.imshow(measured[k], origin="lower", **grey)
        again.imshow(predicted[k], origin="lower", **grey)
        off = measured[k] - predicted[k]
        shown = left.imshow(off, origin="lower", cmap="RdBu_r", vmin=-limit, vmax=limit)
        titles = (
            f"measured p: view {one.view}, {word}",
            "predicted q",
            f"residual {100 * one.rms_rel:.2f} %",
        )
        for axes, title in zip(grid[row], titles, strict=True):
            axes.set_title(title, fontsize=9)
            axes.set_axis_off()
        if row == 2:  # all rows have this scale
            pictures.colorbar(shown, ax=grid.ravel().tolist(), shrink=0.6, label="p - q")
    by_view, by_value = curves.subplots(2, 1)
    views = [one.view for one in residuals.views]
    by_view.plot(views, [100 * one.rms_rel for one in residuals.views], lw=1, label="residual")
    for cause, name in enumerate(CAUSES):
        left = [100 * one.left_rel[cause] for one in residuals.views]
        by_view.plot(views, left, lw=1, label=f"after {name}")
    by_view.set(xlabel="view", ylabel="RMS of p - q, % of RMS of p")
    by_view.set_ylim(bottom=0)
    by_view.legend(fontsize=8)
    by_value.axhline(0, color="#9aa5b1", lw=0.8)
    by_value.plot(*residuals.curve.T, lw=1)
    by_value.set(xlabel="predicted line integral q", ylabel="mean of p - q")
