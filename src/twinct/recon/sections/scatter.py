"""Correction of scattered radiation."""

from __future__ import annotations

from typing import Literal

from twinct.core.settings import Length, Section, setting
from twinct.specimen.sections.composition import Composition


class ScatterCorrection(Section):
    """Scatter of a first volume, simulated by Monte Carlo and subtracted from the images.

    Each round reconstructs a coarse volume, takes each voxel as a mixture of two materials by its
    attenuation, and simulates the scatter of this body. The body must lie in the grid, or in its
    surroundings. The beam must be known, as must the panel's response.
    """

    kind: Literal["monte_carlo"]
    rounds: int = setting(2, "Rounds of reconstruction and simulation.", ge=1, le=10)
    tissue: str | Composition = setting("soft_tissue", "Material of voxels up to its attenuation.")
    dense: str | Composition = setting(
        "bone", "Dense material; it must attenuate more than tissue."
    )
    photons: int = setting(
        300_000, "Photons of each simulated view.", ge=1000, le=10**12, unit="photons"
    )
    views: int = setting(16, "Views that are simulated; fewer if the scan has fewer.", ge=1)
    voxel_mm: Length = setting(4.0, "Edge of the coarse voxels.")
    pixel_mm: Length = setting(
        40.0, "Edge of the coarse pixels, about; at equal photons, larger ones have less noise."
    )
    first_iterations: int = setting(3, "SART iterations of the coarse volume.", ge=1)
