"""Base class of all settings sections, and the types of their numbers."""

from __future__ import annotations

import typing
from abc import abstractmethod
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    JsonValue,
)
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema

from twinct.core.foreign_text import quoted


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


def facts_of(info: FieldInfo) -> dict[str, Any]:
    """Return the facts on a key."""
    extra = info.json_schema_extra or {}
    if not callable(extra):
        return dict(extra)
    schema: dict[str, Any] = {"description": info.description or ""}
    extra(schema)
    return {name: value for name, value in schema.items() if name.startswith("x-")}


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


def default_of(info: FieldInfo) -> Any:
    """Return the default of a key, also of one that is made at its first use."""
    return info.get_default(call_default_factory=True, validated_data={})


def section_made_late(
    make: Callable[[], BaseModel], description: str, *, read_by: str | tuple[str, ...] = ()
) -> Any:
    """Return the field of a section whose default is made at its first use."""

    def extra(schema: dict[str, Any]) -> None:
        text = schema.pop("description")
        schema["default"] = make().model_dump(mode="json")
        schema["description"] = text

    field: Any = Field(default_factory=make, description=description, json_schema_extra=extra)
    field.metadata.append(ReadBy(*((read_by,) if isinstance(read_by, str) else read_by)))
    return field


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

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, defer_build=True)


def kind_of(settings: type[Section]) -> str:
    """Return the value of the key ``kind`` of a settings class, a Literal."""
    return str(typing.get_args(settings.model_fields["kind"].annotation)[0])


class OneOf:
    """Mark on a key: its section is one of several classes, which are looked up at the first use.

    Extensions offer such classes. No package is imported together with the module of the key.
    """

    def __init__(self, union: Callable[[], Any]) -> None:
        """Store the function that returns the union of the classes, with its discriminator."""
        self.union = union

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> Any:
        """Let pydantic validate the union."""
        return handler.generate_schema(self.union())


def annotation_of(info: FieldInfo) -> Any:
    """Return the type of a key; a union of classes where it is marked by ``OneOf``."""
    marks = (mark for mark in info.metadata if isinstance(mark, OneOf))
    return next((mark.union() for mark in marks), info.annotation)


def models_in(annotation: Any) -> list[type[BaseModel]]:
    """Return the sections that values of a type can be."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        complete(annotation)
        return [annotation]
    args = typing.get_args(annotation)
    if marks := [mark for mark in args if isinstance(mark, OneOf)]:
        return models_in(marks[0].union())
    return [model for arg in args for model in models_in(arg)]


def complete(model: type[BaseModel]) -> None:
    """Add the keys of extensions to a section, if it is not in use yet."""
    model.model_rebuild()


class Extensible(Section):
    """Section with a key for each extension of some kind; they are added at its first use."""

    @classmethod
    @abstractmethod
    def extension_keys(cls) -> Mapping[str, tuple[Any, FieldInfo]]:
        """Return type and field of the keys that are added."""

    @classmethod
    def own_last_keys(cls) -> Collection[str]:
        """Return own keys that stand after those of extensions."""
        return ()

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Add the keys."""
        fields = cls.model_fields
        for name, (annotation, info) in cls.extension_keys().items():
            fields[name] = FieldInfo.from_annotated_attribute(annotation, info)
        for name in cls.own_last_keys():
            fields[name] = fields.pop(name)
        return handler(source)

    def __setstate__(self, state: dict[Any, Any]) -> None:
        """Restore a pickled section, whose keys may not have been added in this process."""
        complete(type(self))
        super().__setstate__(state)


def require_usable(name: str, settings: type[Section], section: type[Section]) -> None:
    """Check that an extension's keys can stand in a section, under its name.

    Raises:
        ValueError: the name is reserved.
        PydanticUserError: the keys cannot be validated.
    """
    if hasattr(section, name):
        raise ValueError("this name is reserved")
    complete(settings)
