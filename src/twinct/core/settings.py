"""Base class of all settings sections, and the types of their numbers."""

from __future__ import annotations

import logging
import typing
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, JsonValue, create_model
from pydantic.fields import FieldInfo

from twinct.core.foreign_text import quoted

log = logging.getLogger(__name__)


def _sane(least: float, most: float) -> AfterValidator:
    """Return a validator that refuses magnitudes that are implausible or unsafe in arithmetic."""

    def sane(value: float) -> float:
        if abs(value) > most:
            raise ValueError(f"must be at most {most:g} in magnitude, but is {quoted(value)}")
        if 0 < abs(value) < least:
            raise ValueError(f"must be at least {least:g} in magnitude, but is {quoted(value)}")
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
    """Return the facts on a key that the scenario reference and the JSON Schema add to its meaning.

    Args:
        unit: unit of the key, unless its name ends with it.
        source: origin of its default or its definition.
    """
    return {f"x-{name}": text for name, text in (("unit", unit), ("source", source)) if text}


class ReadBy:
    """Mark on a key: the stages of a run that read it, and all keys below it."""

    def __init__(self, *stages: str) -> None:
        """Store the names of the stages."""
        self.stages = frozenset(stages)


class FileOf:
    """Mark on a key: the file that a value stands for, if any, whose content counts, too."""

    def __init__(self, find: Callable[[Any], Path | None]) -> None:
        """Store the function from a value to its file."""
        self.find = find


def read_by(info: FieldInfo) -> frozenset[str]:
    """Return the stages that a key itself declares as its readers."""
    return frozenset[str]().union(*(m.stages for m in info.metadata if isinstance(m, ReadBy)))


def setting(
    default: Any,
    description: str,
    *,
    unit: str = "",
    source: str = "",
    read_by: str | tuple[str, ...] = (),
    **limits: Any,
) -> Any:
    """Return the field of a key that has a default.

    ``unit`` and ``source`` go to ``facts``, ``read_by`` to ``ReadBy``, the limits to pydantic.
    """
    extra = facts(unit=unit, source=source)
    field: FieldInfo = Field(default, description=description, json_schema_extra=extra, **limits)
    field.metadata.append(ReadBy(*((read_by,) if isinstance(read_by, str) else read_by)))
    return field


class Conflict(NamedTuple):
    """Keys whose values do not go together.

    Attributes:
        message: description of the problem.
        keys: dotted names below the section that reports them; the last key that was set is to
            blame.
    """

    message: str
    keys: tuple[str, ...]


class ConflictError(ValueError):
    """Error of a section's validator; each conflict is reported at its keys."""

    def __init__(self, *conflicts: Conflict) -> None:
        """Store the conflicts."""
        super().__init__("; ".join(conflict.message for conflict in conflicts))
        self.conflicts = conflicts


FILE_KEYS = ("path", "file", "plan", "calibration")
"""Names of the keys of input files: in plain data, their paths are made absolute."""


def is_file(info: FieldInfo) -> bool:
    """Return True for the key of an input file: it must exist, and its content counts."""
    return _names_a_path(info.annotation)


def _names_a_path(annotation: Any) -> bool:
    return annotation is Path or any(map(_names_a_path, typing.get_args(annotation)))


class Section(BaseModel):
    """Frozen settings; unknown keys and numbers that are not finite are errors."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


def kind_of(settings: type[Section]) -> str:
    """Return the value of the key ``kind`` of a settings class, a Literal."""
    return str(typing.get_args(settings.model_fields["kind"].annotation)[0])


def extended(
    base: type[Section], name: str, keys: Mapping[str, Callable[[], Any]]
) -> tuple[Any, dict[str, str]]:
    """Return a section with the keys of extensions, and the problem of each unusable key.

    Args:
        base: the section without them, of the module that will have the new class.
        name: name of the new class in this module.
        keys: pydantic's definition of each key, made when it is added: any package may raise there.
    """
    section, broken = base, dict[str, str]()
    about: Any = {"__module__": base.__module__, "__doc__": base.__doc__}
    for key, define in keys.items():
        try:
            if hasattr(base, key):
                raise ValueError("this name is reserved")
            section = create_model(name, __base__=section, **{key: define()}, **about)
        except Exception as error:  # settings may come from any package
            broken[key] = f"the settings of {quoted(key)} cannot be used: {error}"
            log.warning(broken[key])
    return create_model(name, __base__=section, **about), broken
