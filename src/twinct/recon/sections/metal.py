"""Reduction of metal artefacts."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from twinct.core.settings import NonNegative, Positive, Section, Vector, setting
from twinct.specimen.sections.composition import Composition
from twinct.specimen.sections.specimen import Part, Shape


class Nmar(Section):
    """Normalised metal artefact reduction, before the reconstruction."""

    method: Literal["nmar"] = Field(
        description="Rays through metal are replaced by values predicted from a prior of air, "
        "tissue and bone (Meyer et al., Med. Phys. 37 (2010) 5482).",
    )
    tissue: str | Composition = setting(
        "soft_tissue", "Soft tissue of the prior.", source="attenuation: xraylib"
    )
    bone: str | Composition = setting("bone", "Bone of the prior; it attenuates more than tissue.")
    metal: str | Composition = setting("titanium", "The metal; it attenuates more than bone.")
    threshold_per_mm: Positive | None = setting(
        None,
        "Smallest attenuation of a metal voxel in the first volume; null: the geometric mean of "
        "bone and metal.",
        unit="1/mm",
    )
    first_iterations: int = setting(
        3, "SART iterations of the volume that is segmented.", ge=1, le=10_000
    )


class Implant(Section):
    """Implant of known shape and material. The search for its pose starts at the believed pose."""

    part: str = setting(
        "", "Name of the specimen's part; it supplies the keys that are not given here."
    )
    shape: Shape | None = setting(None, "Shape of the implant.")
    material: str | Composition | None = setting(
        None, "A name, or a composition with its density.", source="attenuation: xraylib"
    )
    position_mm: Vector | None = setting(None, "Believed position in the specimen's frame.")
    rotation_deg: Vector | None = setting(
        None, "Believed rotation: extrinsic rotations about x, y, z."
    )

    @model_validator(mode="after")
    def _described(self) -> Implant:
        if not self.part and None in (self.shape, self.material, self.position_mm):
            raise ValueError("give part, or all of shape, material and position_mm")
        return self

    def described_by(self, part: Part | None) -> Part:
        """Return shape, material and believed pose as one part; ``part`` fills the gaps."""
        data = {name: value for name, value in dict(self).items() if name != "part"}
        data = {name: value for name, value in data.items() if value is not None}
        return part.model_copy(update=data) if part else Part(name=self.part, **data)


class KnownImplants(Section):
    """Implants of known shape, located in the projections and removed from them."""

    method: Literal["known"] = Field(
        description="Poses of known implants and the anatomy are estimated in turn (Stayman et "
        "al., IEEE Trans. Med. Imaging 31 (2012) 1837)."
    )
    implants: tuple[Implant, ...] = Field(min_length=1, description="The implants.")
    position_sigma_mm: NonNegative = setting(
        2.0, "Standard deviation of the error of the believed positions, along each axis."
    )
    rotation_sigma_deg: NonNegative = setting(
        5.0, "Standard deviation of the error of the believed rotations, about each axis."
    )
    slack_mm: NonNegative = setting(
        0.1,
        "Standard deviation of an implant's apparent displacement in one view, caused by "
        "inexact poses of source and panel.",
    )
    rounds: int = setting(
        1, "Number of rounds; each estimates poses and anatomy once.", ge=1, le=100
    )
    tissue: str | Composition = setting(
        "soft_tissue", "Soft tissue of the first volume, as with nmar."
    )
    bone: str | Composition = setting(
        "bone", "Bone of the first volume; it attenuates more than tissue."
    )
    first_iterations: int = setting(3, "SART iterations of each volume.", ge=1, le=10_000)


Metal = Annotated[Nmar | KnownImplants, Field(discriminator="method")]
