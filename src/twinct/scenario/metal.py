"""Reduction of metal artefacts."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from twinct.scenario.composition import Composition
from twinct.scenario.specimen import Part, Shape
from twinct.settings import NonNegative, Positive, Section, Vector, setting


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


class Implant(Section):
    """Implant of known shape and material. The search for its pose starts at the believed pose."""

    part: str = setting(
        "", "The specimen's part that it is, by name: what is not given here is taken from there."
    )
    shape: Shape | None = setting(None, "Its shape.")
    material: str | Composition | None = setting(
        None, "A name, or a composition with its density.", source="attenuation: xraylib"
    )
    position_mm: Vector | None = setting(None, "Where it is believed, in the specimen's frame.")
    rotation_deg: Vector | None = setting(
        None, "How it is believed to be turned: extrinsic rotations about x, y, z."
    )

    @model_validator(mode="after")
    def _described(self) -> Implant:
        if not self.part and None in (self.shape, self.material, self.position_mm):
            raise ValueError("give part, or all of shape, material and position_mm")
        return self

    def described_by(self, part: Part | None) -> Part:
        """Return shape, material and believed pose as one part; ``part`` fills the gaps."""
        told = {name: value for name, value in dict(self).items() if name != "part"}
        told = {name: value for name, value in told.items() if value is not None}
        return part.model_copy(update=told) if part else Part(name=self.part, **told)


class KnownImplants(Section):
    """Implants of known shape, located in the projections and removed from them."""

    method: Literal["known"] = Field(
        description="Poses of known implants and the anatomy are worked out in turns (Stayman et "
        "al., IEEE Trans. Med. Imaging 31 (2012) 1837)."
    )
    implants: tuple[Implant, ...] = Field(min_length=1, description="The implants.")
    position_sigma_mm: NonNegative = setting(
        2.0, "How far off their believed positions may be, along each axis: standard deviation."
    )
    rotation_sigma_deg: NonNegative = setting(
        5.0, "How far their believed rotations may be off, about each axis: standard deviation."
    )
    slack_mm: NonNegative = setting(
        0.1,
        "How far an implant may seem displaced in one view because poses of source and panel are "
        "not exact: standard deviation.",
    )
    rounds: int = setting(1, "Poses and anatomy in turns, as often.", ge=1, le=100)
    tissue: str | Composition = setting(
        "soft_tissue", "Soft tissue of the first volume, as with nmar."
    )
    bone: str | Composition = setting("bone", "Bone of the first volume; it attenuates more.")
    first_iterations: int = setting(3, "SART iterations of each volume.", ge=1, le=10_000)


Metal = Annotated[Nmar | KnownImplants, Field(discriminator="method")]
