"""What all sections of settings share: their base, and the types of their numbers."""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple

from pydantic import BaseModel, ConfigDict, Field, JsonValue

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Vector = tuple[Finite, Finite, Finite]
Lengths = tuple[Positive, Positive, Positive]
Pair = tuple[Positive, Positive]


def facts(*, unit: str = "", source: str = "") -> dict[str, JsonValue]:
    """What the scenario reference and the JSON Schema say of a key beside its meaning.

    Args:
        unit: where the key's name does not end with it.
        source: where its default or its definition comes from.
    """
    return {f"x-{name}": text for name, text in (("unit", unit), ("source", source)) if text}


def setting(
    default: Any, description: str, *, unit: str = "", source: str = "", **limits: Any
) -> Any:
    """A key that has a default; ``unit`` and ``source`` as for ``facts``, limits as pydantic's."""
    extra = facts(unit=unit, source=source)
    return Field(default, description=description, json_schema_extra=extra, **limits)


class Conflict(NamedTuple):
    """Keys that do not go together.

    Attributes:
        message: what is wrong.
        keys: dotted, below the section that says so; the last one that was set is to blame.
    """

    message: str
    keys: tuple[str, ...]


class ConflictError(ValueError):
    """Raised by a section's validator: each conflict gets the place of its keys."""

    def __init__(self, *conflicts: Conflict) -> None:
        """Keep all of them."""
        super().__init__("; ".join(conflict.message for conflict in conflicts))
        self.conflicts = conflicts


FILE_KEYS = ("path", "file", "plan")
"""Keys that name an input file: it is made absolute, must exist, and counts by its content."""


class Section(BaseModel):
    """Frozen; an unknown key is an error, and so is a number that is not finite."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
