"""Signals to detect: a ball, or a Gaussian profile."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from twinct.core.settings import Finite, Length, Section
from twinct.evaluation.region_voxels import centres
from twinct.geometry import Floats, VolumeGrid


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
    sigma_mm: Length = Field(description="Sigma.")
    contrast_rel: Finite = Field(
        description="Contrast at the centre, relative to mu(reference).",
        json_schema_extra={"x-unit": "1"},
    )


Signal = Annotated[SphereSignal | GaussianSignal, Field(discriminator="kind")]


def signal_on(signal: SphereSignal | GaussianSignal, grid: VolumeGrid) -> Floats:
    """Return the contrast on a lattice of twice the sphere's size, or of 6 sigma to each side.

    The lattice has the voxels of ``grid``; the contrast, (z, y, x), is relative to mu(reference).
    """
    sphere = isinstance(signal, SphereSignal)
    half = 2 * signal.radius_mm if sphere else 6 * signal.sigma_mm
    count = (2 * np.ceil(half / grid.voxel[::-1]) + 1).astype(int).tolist()
    lattice = VolumeGrid(count, grid.voxel)
    z, y, x = (slice(0, n) for n in count)
    radius = np.linalg.norm(centres(lattice, (z, y, x)), axis=-1)
    return contrast_at(signal, radius, float(grid.voxel.mean()))


def contrast_at(signal: SphereSignal | GaussianSignal, radius_mm: Floats, edge_mm: float) -> Floats:
    """Return the contrast of voxels at distances from a signal's centre, in mu(reference)."""
    if isinstance(signal, GaussianSignal):
        return signal.contrast_rel * np.exp(-((radius_mm / signal.sigma_mm) ** 2) / 2)
    return signal.contrast_rel * np.clip((signal.radius_mm - radius_mm) / edge_mm + 0.5, 0, 1)
