"""What the sections of a scenario are made of: bounded numbers, and a material by its elements."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, model_validator

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Vector = tuple[Finite, Finite, Finite]
Lengths = tuple[Positive, Positive, Positive]


class Section(BaseModel):
    """Frozen; an unknown key is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class Composition(Section):
    """A material by its elements."""

    formula: str | None = Field(
        default=None, description="Chemical formula, such as Ca10(PO4)6(OH)2."
    )
    mass_fractions: dict[str, Positive] | None = Field(
        default=None, description="Element symbol to share of mass; the shares add up to 1."
    )
    density_g_cm3: Positive

    @model_validator(mode="after")
    def _one_description(self) -> Composition:
        if (self.formula is None) == (self.mass_fractions is None):
            raise ValueError("give either formula or mass_fractions")
        return self
