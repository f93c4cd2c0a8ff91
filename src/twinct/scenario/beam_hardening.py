"""Correction of beam hardening."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from twinct.scenario.composition import Composition
from twinct.settings import Conflict, ConflictError, Section, facts


class OneMaterialHardening(Section):
    """Beam hardening of one material, undone by a table of the known spectrum."""

    kind: Literal["one_material"]
    material: str | Composition | None = Field(
        default=None,
        description="What is linearised; null: the specimen's part with the largest volume.",
        json_schema_extra=facts(source="attenuation: xraylib"),
    )


class TwoMaterialHardening(Section):
    """Beam hardening of two materials; the dense one is segmented in a first volume."""

    kind: Literal["two_materials"]
    base: str | Composition = Field(
        default="soft_tissue",
        description="Material of everything that is not dense.",
        json_schema_extra=facts(
            source="Joseph and Spital, J. Comput. Assist. Tomogr. 2 (1978) 100"
        ),
    )
    dense: str | Composition = Field(
        default="bone",
        description="Material that is segmented; it attenuates more than base.",
        json_schema_extra=facts(source="the same"),
    )
    first_iterations: int = Field(
        default=3, ge=1, description="SART iterations of the volume that is segmented."
    )

    @model_validator(mode="after")
    def _two(self) -> TwoMaterialHardening:
        if self.base == self.dense:
            message = f"base and dense are the same material, {self.base!r}: use one_material"
            raise ConflictError(Conflict(message, ("base", "dense")))
        return self


BeamHardening = Annotated[OneMaterialHardening | TwoMaterialHardening, Field(discriminator="kind")]
