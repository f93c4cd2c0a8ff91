"""What all sections of settings share: their base, and the types of their numbers."""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, JsonValue


def _sane(least: float, most: float) -> AfterValidator:
    """Refuses numbers whose squares and quotients no arithmetic holds, nor anybody means."""

    def sane(value: float) -> float:
        if abs(value) > most:
            raise ValueError(f"must be at most {most:g} in size, but is {value!r}")
        if 0 < abs(value) < least:
            raise ValueError(f"must be at least {least:g} in size, but is {value!r}")
        return value

    return AfterValidator(sane)


Positive = Annotated[float, Field(gt=0, allow_inf_nan=False), _sane(1e-30, 1e15)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False), _sane(1e-30, 1e15)]
Finite = Annotated[float, Field(allow_inf_nan=False), _sane(1e-30, 1e15)]
Length = Annotated[float, Field(gt=0, allow_inf_nan=False), _sane(1e-6, 1e6)]
"""A nanometre to a kilometre, in mm."""
Coordinate = Annotated[float, Field(allow_inf_nan=False), _sane(1e-30, 1e6)]
Vector = tuple[Coordinate, Coordinate, Coordinate]
Lengths = tuple[Length, Length, Length]
Pair = tuple[Length, Length]


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
