"""What all sections of a scenario share: their base, and the types of their numbers."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, JsonValue

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Vector = tuple[Finite, Finite, Finite]
Lengths = tuple[Positive, Positive, Positive]


def facts(*, unit: str = "", source: str = "") -> dict[str, JsonValue]:
    """What the scenario reference and the JSON Schema say of a key beside its meaning.

    Args:
        unit: where the key's name does not end with it.
        source: where its default or its definition comes from.
    """
    return {f"x-{name}": text for name, text in (("unit", unit), ("source", source)) if text}


class Section(BaseModel):
    """Frozen; an unknown key is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid")
