"""Noise power spectrum of a homogeneous region."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from pydantic import Field

from twinct.evaluation.figure import Figure, percent
from twinct.evaluation.figure_kind import Curve, FigureKind, FigureSettings, Measurement
from twinct.evaluation.nps import Nps, detrended, noise_power_spectrum


class NoisePower(FigureSettings):
    """Noise power spectrum of a homogeneous region, with its trend removed."""

    region: str = Field(description="Name of the region.")


def spectrum_of(at: Measurement, name: str) -> Nps | None:
    """Return the spectrum of the error in a region, relative to mu; None without voxels."""
    voxels = at.region(name)
    if not len(voxels):
        return None
    error = (at.volume[voxels.box] - at.truth[voxels.box]).astype(np.float64) / at.mu_reference
    noise = detrended(error, voxels.mask)
    return noise_power_spectrum(noise, at.grid.voxel[::-1].tolist(), voxels.mask)


_CAPTION = "Noise power of the named region, averaged over all directions, relative to μ({0})²."


def _measure(at: Measurement, one: NoisePower) -> dict[str, Any]:
    spectrum = at.once(spectrum_of, one.region)
    if spectrum is None:
        return {}
    return {
        "noise_rel": math.sqrt(spectrum.variance),
        "mean_frequency_per_mm": spectrum.mean_frequency_per_mm,
        "frequency_per_mm": spectrum.frequency_per_mm,
        "nps_mm3": spectrum.value,
    }


NPS = FigureKind(
    "nps",
    NoisePower,
    "Regions in which the noise power spectrum is measured.",
    (
        percent(
            "noise_rel",
            "noise",
            "of μ({0}), standard deviation about a trend",
            "lower",
            good="a fifth of the contrast sought",
            without_signal="null",
            blind_to=("blur", "smoothing", "shift", "contrast"),
        ),
        Figure(
            "mean_frequency_per_mm",
            "mean frequency of noise",
            "mm⁻¹",
            meaning="weighted by power",
            good="that of volumes to compare with",
            without_signal="null",
        ),
    ),
    _measure,
    names={"region": "region"},
    curves=(Curve("nps_mm3", "noise power / mm³", "Noise power", _CAPTION),),
)
