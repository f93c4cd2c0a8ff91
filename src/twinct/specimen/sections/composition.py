"""Material defined by its elements, or a known material at another density."""

from __future__ import annotations

from pydantic import Field, model_validator

from twinct.core.settings import Positive, Section, setting


class Composition(Section):
    """Material defined by its elements, or a known material at another density."""

    of: str | None = setting(
        None,
        "Name of a known material, such as brain, whose elements are used at the density given "
        "here.",
    )
    formula: str | None = setting(
        None,
        "Chemical formula, such as Ca10(PO4)6(OH)2.",
        source="attenuation of the elements: xraylib",
    )
    mass_fractions: dict[str, Positive] | None = setting(
        None,
        "Mass fraction of each element, by its symbol; the fractions add up to 1.",
        source="attenuation of the elements: xraylib",
    )
    density_g_cm3: Positive = Field(description="Density.")

    @model_validator(mode="after")
    def _one_description(self) -> Composition:
        if [self.of, self.formula, self.mass_fractions].count(None) != 2:
            raise ValueError("give exactly one of formula, mass_fractions and of")
        return self
