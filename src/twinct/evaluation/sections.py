"""Measurements in the volume beyond the figures that every run has, and their regions."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from typing import Annotated, Any, Literal

from pydantic import (
    Field,
    SerializerFunctionWrapHandler,
    model_serializer,
    model_validator,
)
from pydantic.fields import FieldInfo

from twinct.core.foreign_text import quoted
from twinct.core.settings import (
    Conflict,
    Extensible,
    Length,
    NonNegative,
    Section,
    Vector,
    require_usable,
    setting,
)
from twinct.evaluation.figure_kind import FigureSettings
from twinct.evaluation.figure_kinds import BUILT_IN, figure_kinds
from twinct.evaluation.kinds.regions import REGIONS, NamedRegion
from twinct.geometry import Pose
from twinct.specimen.sections.specimen import Box, Cylinder, Specimen, Sphere

_SETTINGS = "the settings of {name}"
"""Subject of messages about kinds of figures that cannot be used."""


class Shell(Section):
    """Shell around a part of the specimen."""

    kind: Literal["shell"]
    part: str = Field(description="Name of the part or label.")
    from_mm: NonNegative = setting(0.0, "Distance from the part at which the shell begins.")
    to_mm: Length = Field(description="Distance from the part at which the shell ends.")

    @model_validator(mode="after")
    def _outwards(self) -> Shell:
        if self.to_mm <= self.from_mm:
            raise ValueError(f"to_mm ({self.to_mm:g}) must be above from_mm ({self.from_mm:g})")
        return self


class WholePart(Section):
    """All voxels of a part or of a label of the specimen."""

    kind: Literal["part"]
    part: str = Field(description="Name of the part or label.")


class Region(NamedRegion):
    """Named region of all voxels whose centres lie in it."""

    shape: Annotated[Sphere | Cylinder | Box | Shell | WholePart, Field(discriminator="kind")] = (
        Field(description="Shape of the region; a shell is placed around its part or label.")
    )
    position_mm: Vector = setting((0.0, 0.0, 0.0), "Origin in the specimen's frame.")
    rotation_deg: Vector = setting((0.0, 0.0, 0.0), "Extrinsic rotations about x, y, z.")

    @property
    def specimen_from_region(self) -> Pose:
        """Pose of the region in the specimen's frame."""
        return Pose.from_euler(self.position_mm, self.rotation_deg)


class Evaluation(Extensible):
    """Measurements in the volume beyond the figures that every run has.

    They need no new volume: `twinct report DIR --set evaluation...` measures in an existing one.
    """

    regions: tuple[Region, ...] = setting((), REGIONS.description)

    @classmethod
    def extension_keys(cls) -> Mapping[str, tuple[Any, FieldInfo]]:
        """Return a key for each kind of figures."""
        known = figure_kinds()
        known.keep(lambda kind: require_usable(kind.name, kind.settings, cls), _SETTINGS)
        return {
            name: (tuple[kind.settings, ...], setting((), kind.description))
            for name, kind in known.items()
            if name != REGIONS.name
        }

    def entries(self, kind: str) -> tuple[FigureSettings, ...]:
        """Return the entries of a kind of figures."""
        return getattr(self, kind, ())

    def region(self, name: str) -> Region:
        """Return the region with a given name."""
        return next(region for region in self.regions if region.name == name)

    def figure_names(self) -> list[str]:
        """Return the dotted names, below ``image``, of the scalar figures that it requests."""
        return [
            f"{kind.name}.{one.label}.{figure.key}"
            for kind in figure_kinds().values()
            for one in self.entries(kind.name)
            for figure in kind.figures
        ]

    def conflicts(self, specimen: Specimen | None) -> list[Conflict]:
        """Return conflicts of names that are unknown, repeated, or name a body without an edge.

        Without a known specimen, figures that need its truth are conflicts, too.
        """
        regions = {region.name: region.shape for region in self.regions}
        parts = {part.label: part.shape for part in specimen.parts} if specimen else {}
        bodies = parts | regions
        known: dict[str, tuple[str, Collection[str]]] = {
            "part": ("part or label", specimen.names if specimen else ()),
            "region": ("region", regions),
            "round body": ("part or region", bodies),
        }
        contradictions: list[Conflict] = [
            _conflict(name, "this scan has no truth that these figures could use")
            for name, kind in figure_kinds().items()
            if specimen is None and kind.needs_truth and self.entries(name)
            if name != REGIONS.name  # other figures name them; their own need a truth
        ]
        for at, name, target in self.references():
            what, having = known.get(target) or self._entries_named(target)
            if name not in having:
                contradictions.append(
                    _conflict(at, f"unknown {what} {quoted(name)}; {_are(having)}")
                )
            elif target == "round body" and not isinstance(bodies[name], Sphere | Cylinder):
                contradictions.append(
                    _conflict(at, f"{quoted(name)} is neither a sphere nor a cylinder")
                )
        contradictions += [
            _conflict(f"regions.{i}.name", f"a part is also called {quoted(region.name)}")
            for i, region in enumerate(self.regions)
            if region.name in parts
        ]
        for kind in figure_kinds():
            labels = Counter(one.label for one in self.entries(kind))
            twice = [label for label, times in labels.items() if times > 1]
            contradictions += [
                _conflict(kind, f"{quoted(label)} appears more than once") for label in twice
            ]
        return contradictions

    def references(self) -> Iterator[tuple[str, str, str]]:
        """Yield each key that names something, the name, and its target: see ``FigureKind``."""
        for i, region in enumerate(self.regions):
            if isinstance(region.shape, Shell | WholePart):
                yield f"regions.{i}.shape.part", region.shape.part, "part"
        for kind in figure_kinds().values():
            for key, target in kind.names.items():
                for i, one in enumerate(self.entries(kind.name)):
                    if (name := getattr(one, key)) is not None:
                        yield f"{kind.name}.{i}.{key}", name, target

    def _entries_named(self, target: str) -> tuple[str, Collection[str]]:
        kind, _, key = target.partition(".")
        return f"entry of evaluation.{kind}", {getattr(e, key): e for e in self.entries(kind)}

    @model_serializer(mode="wrap")
    def _without_unused_extensions(self, plain: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Leave out foreign kinds without entries: others can read the scenario without them."""
        return {
            name: section for name, section in plain(self).items() if section or name in BUILT_IN
        }


def _conflict(key: str, message: str) -> Conflict:
    return Conflict(f"evaluation.{key}: {message}", (f"evaluation.{key}",))


def _are(having: Iterable[str]) -> str:
    names = [repr(name) for name in having]
    return (
        f"{'choose from' if len(names) > 1 else 'the only one is'} {', '.join(names)}"
        if names
        else "none is defined"
    )
