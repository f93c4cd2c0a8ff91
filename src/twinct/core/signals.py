"""Signals to detect: settings and contrast."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from twinct.core.settings import Finite, Length, Section

Floats = NDArray[np.float64]


class SphereSignal(Section):
    """Ball of uniform contrast."""

    kind: Literal["sphere"]
    radius_mm: Length = Field(description="Radius.")
    contrast_rel: Finite = Field(
        description="Contrast relative to mu(reference).", json_schema_extra={"x-unit": "1"}
    )


class GaussianSignal(Section):
    """Contrast with a Gaussian profile."""

    kind: Literal["gaussian"]
    sigma_mm: Length = Field(description="Standard deviation of the profile.")
    contrast_rel: Finite = Field(
        description="Contrast at the centre, relative to mu(reference).",
        json_schema_extra={"x-unit": "1"},
    )


AnySignal = Annotated[SphereSignal | GaussianSignal, Field(discriminator="kind")]


def contrast_at(signal: SphereSignal | GaussianSignal, radius_mm: Floats, edge_mm: float) -> Floats:
    """Return the contrast of voxels at distances from a signal's centre, in mu(reference)."""
    if isinstance(signal, GaussianSignal):
        return signal.contrast_rel * np.exp(-((radius_mm / signal.sigma_mm) ** 2) / 2)
    return signal.contrast_rel * np.clip((signal.radius_mm - radius_mm) / edge_mm + 0.5, 0, 1)
