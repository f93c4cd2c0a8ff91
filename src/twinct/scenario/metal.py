"""Reduction of metal artefacts."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from twinct.scenario.composition import Composition
from twinct.settings import Positive, Section, setting


class Nmar(Section):
    """Normalised metal artefact reduction, before the reconstruction."""

    method: Literal["nmar"] = Field(
        description="Rays through metal are replaced by what a prior of air, tissue and bone lets "
        "expect (Meyer et al., Med. Phys. 37 (2010) 5482).",
    )
    tissue: str | Composition = setting(
        "soft_tissue", "Soft tissue of the prior.", source="attenuation: xraylib"
    )
    bone: str | Composition = setting("bone", "Bone of the prior; it attenuates more.")
    metal: str | Composition = setting("titanium", "The metal; it attenuates more than bone.")
    threshold_per_mm: Positive | None = setting(
        None,
        "What attenuates as much in the first volume is metal; null: the geometric mean of bone "
        "and metal.",
    )
    first_iterations: int = setting(
        3, "SART iterations of the volume that is segmented.", ge=1, le=10_000
    )
