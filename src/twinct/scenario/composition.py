"""A material by its elements."""

from __future__ import annotations

from pydantic import Field, model_validator

from twinct.settings import Positive, Section, setting


class Composition(Section):
    """A material by its elements."""

    formula: str | None = setting(
        None,
        "Chemical formula, such as Ca10(PO4)6(OH)2.",
        source="attenuation of the elements: xraylib",
    )
    mass_fractions: dict[str, Positive] | None = setting(
        None,
        "Element symbol to share of mass; the shares add up to 1.",
        source="attenuation of the elements: xraylib",
    )
    density_g_cm3: Positive = Field(description="Density.")

    @model_validator(mode="after")
    def _one_description(self) -> Composition:
        if (self.formula is None) == (self.mass_fractions is None):
            raise ValueError("give either formula or mass_fractions")
        return self
