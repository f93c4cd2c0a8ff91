"""Mean and error of the voxels of a region, also in Hounsfield units."""

from __future__ import annotations

import math

from pydantic import Field

from twinct.core.settings import setting
from twinct.evaluation.figure import Figure, percent
from twinct.evaluation.figure_kind import FigureKind, FigureSettings, Measurement, Name

AIR_HU = -1000.0


class NamedRegion(FigureSettings):
    """Region of voxels; the scenario adds its shape and its pose."""

    name: Name = Field(description="Name of the region in figures.")


def _measure(at: Measurement, one: NamedRegion) -> dict[str, float]:
    voxels = at.region(one.name)
    if not len(voxels):
        return {}
    values = voxels.of(at.volume)
    error = values - voxels.of(at.truth)
    results = {
        "mean_rel": float(values.mean()),
        "bias_rel": float(error.mean()),
        "rmse_rel": math.sqrt(float((error * error).mean())),
    }
    return {key: value / at.mu_reference for key, value in results.items()}


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
        percent(
            "rmse_rel",
            "RMSE",
            "of μ({0})",
            "lower",
            good="below 3 %",
            without_signal="null",
            blind_to=("smoothing",),
        ),
    ),
    _measure,
)


class HounsfieldUnits(FigureSettings):
    """One region in HU."""

    region: str = Field(description="Name of the region.")
    water: str | None = setting(
        None,
        "Region of water in the volume, whose mean becomes 0 HU; null: the attenuation of water.",
    )
    air: str | None = setting(
        None, "Region of air in the volume, whose mean becomes -1000 HU; null: no attenuation."
    )


def _measure_hu(at: Measurement, one: HounsfieldUnits) -> dict[str, float]:
    voxels = at.region(one.region)
    water = _mean(at, one.water, at.mu_water)
    air = _mean(at, one.air, 0.0)
    if not len(voxels) or not water > air:
        return {}
    hu = AIR_HU * (1 - (voxels.of(at.volume) - air) / (water - air))
    error = hu - AIR_HU * (1 - voxels.of(at.truth) / at.mu_water)
    return {
        "mean_hu": float(hu.mean()),
        "bias_hu": float(error.mean()),
        "sd_hu": float(error.std()),
        "rmse_hu": math.sqrt(float((error * error).mean())),
    }


def _mean(at: Measurement, region: str | None, otherwise: float) -> float:
    return otherwise if region is None else float(at.region(region).of(at.volume).mean())


HOUNSFIELD = FigureKind(
    "hounsfield",
    HounsfieldUnits,
    "Regions in Hounsfield units, which air and water define.",
    (
        Figure("mean_hu", "mean", "HU", 1, 1, "of the volume", "", "that of the truth", "any"),
        Figure(
            "bias_hu", "mean error", "HU", 1, 1, "volume minus truth", "", "within 10 HU", "any"
        ),
        Figure(
            "sd_hu",
            "standard deviation",
            "HU",
            1,
            1,
            "of the error about its mean",
            "lower",
            "below 30 HU",
            "null",
            blind_to=("smoothing", "contrast"),
        ),
        Figure(
            "rmse_hu",
            "RMSE",
            "HU",
            1,
            1,
            "",
            "lower",
            "below 30 HU",
            "null",
            blind_to=("smoothing",),
        ),
    ),
    _measure_hu,
    {"region": "region", "water": "region", "air": "region"},
)
