"""Mean and error of the voxels of a region."""

from __future__ import annotations

import math

from pydantic import Field

from twinct.evaluation.figure import percent
from twinct.evaluation.figure_kind import FigureKind, FigureSettings, Measurement, Name


class NamedRegion(FigureSettings):
    """Region of voxels; the scenario adds its shape and its pose."""

    name: Name = Field(description="Name of the region in figures.")


def _measure(at: Measurement, one: NamedRegion) -> dict[str, float]:
    voxels = at.region(one.name)
    if not len(voxels):
        return {}
    values = voxels.of(at.volume)
    error = values - voxels.of(at.truth)
    found = {
        "mean_rel": float(values.mean()),
        "bias_rel": float(error.mean()),
        "rmse_rel": math.sqrt(float((error * error).mean())),
    }
    return {key: value / at.mu_reference for key, value in found.items()}


REGIONS = FigureKind(
    "regions",
    NamedRegion,
    "Named regions; each has a mean and an RMSE.",
    (
        percent("mean_rel", "mean", "of μ({0})", good="that of the truth", without_signal="any"),
        percent(
            "bias_rel",
            "mean error",
            "of μ({0}), volume minus truth",
            good="within 1 %",
            without_signal="any",
        ),
        percent("rmse_rel", "RMSE", "of μ({0})", "lower", good="below 3 %", without_signal="null"),
    ),
    _measure,
)
