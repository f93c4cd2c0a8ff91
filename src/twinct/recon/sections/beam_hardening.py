"""Correction of beam hardening."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from twinct.core.foreign_text import quoted
from twinct.core.settings import Conflict, ConflictError, Section, setting
from twinct.specimen.sections.composition import Composition


class OneMaterialHardening(Section):
    """Beam hardening of one material, corrected with a table computed from the known spectrum."""

    kind: Literal["one_material"]
    material: str | Composition | None = setting(
        None,
        "Material that is linearised; null: that of the specimen's part with the largest volume.",
        source="attenuation: xraylib",
    )


class TwoMaterialHardening(Section):
    """Beam hardening of two materials; the dense one is segmented in a first volume."""

    kind: Literal["two_materials"]
    base: str | Composition = setting(
        "soft_tissue",
        "Material of everything that is not dense.",
        source="Joseph and Spital, J. Comput. Assist. Tomogr. 2 (1978) 100",
    )
    dense: str | Composition = setting(
        "bone",
        "Dense material, which is segmented; it must attenuate more than base.",
        source="Joseph and Spital, J. Comput. Assist. Tomogr. 2 (1978) 100",
    )
    first_iterations: int = setting(3, "SART iterations of the volume that is segmented.", ge=1)

    @model_validator(mode="after")
    def _two(self) -> TwoMaterialHardening:
        if self.base == self.dense:
            message = f"base and dense are the same material, {quoted(self.base)}: use one_material"
            raise ConflictError(Conflict(message, ("base", "dense")))
        return self


BeamHardening = Annotated[OneMaterialHardening | TwoMaterialHardening, Field(discriminator="kind")]
