"""Signals to detect: settings, contrast, and the contrast along rays."""

from __future__ import annotations

import math
from dataclasses import dataclass
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

    @property
    def extent_mm(self) -> float:
        """Radius that holds the signal."""
        return self.radius_mm


class GaussianSignal(Section):
    """Contrast with a Gaussian profile."""

    kind: Literal["gaussian"]
    sigma_mm: Length = Field(description="Standard deviation of the profile.")
    contrast_rel: Finite = Field(
        description="Contrast at the centre, relative to mu(reference).",
        json_schema_extra={"x-unit": "1"},
    )

    @property
    def extent_mm(self) -> float:
        """Radius that holds most of the signal: 2 sigma, 95 % of its energy."""
        return 2 * self.sigma_mm


AnySignal = Annotated[SphereSignal | GaussianSignal, Field(discriminator="kind")]


def contrast_at(signal: SphereSignal | GaussianSignal, radius_mm: Floats, edge_mm: float) -> Floats:
    """Return the contrast of voxels at distances from a signal's centre, in mu(reference)."""
    if isinstance(signal, GaussianSignal):
        return signal.contrast_rel * np.exp(-((radius_mm / signal.sigma_mm) ** 2) / 2)
    return signal.contrast_rel * np.clip((signal.radius_mm - radius_mm) / edge_mm + 0.5, 0, 1)


def integral_at(signal: SphereSignal | GaussianSignal, distance_mm: Floats) -> Floats:
    """Return the contrast along rays at distances from a signal's centre, in mu(reference) mm."""
    if isinstance(signal, GaussianSignal):
        peak = signal.contrast_rel * signal.sigma_mm * math.sqrt(2 * math.pi)
        return peak * np.exp(-((distance_mm / signal.sigma_mm) ** 2) / 2)
    half = np.sqrt(np.maximum(signal.radius_mm**2 - distance_mm**2, 0))
    return 2 * signal.contrast_rel * half


@dataclass(frozen=True, eq=False)
class Inserts:
    """Copies of a signal in a specimen.

    Attributes:
        signal: the signal.
        centres_mm: their centres in the specimen's frame, (signals, 3), mm.
        mu_per_mm: attenuation of the reference, 1/mm.
    """

    signal: SphereSignal | GaussianSignal
    centres_mm: Floats
    mu_per_mm: float
