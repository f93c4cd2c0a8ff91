"""Measurements in the volume beyond the figures that every run has, and their regions."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from twinct.core.settings import (
    Conflict,
    Length,
    NonNegative,
    Section,
    Vector,
    setting,
)
from twinct.core.signals import AnySignal
from twinct.geometry import Pose
from twinct.scenario.specimen import Box, Cylinder, Specimen, Sphere

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]+$")]
"""Part of a figure's dotted name."""


class Shell(Section):
    """Shell around a part of the specimen."""

    kind: Literal["shell"]
    part: str = Field(description="Name of the part.")
    from_mm: NonNegative = setting(0.0, "Distance from the part at which the shell begins.")
    to_mm: Length = Field(description="Distance from the part at which the shell ends.")

    @model_validator(mode="after")
    def _outwards(self) -> Shell:
        if self.to_mm <= self.from_mm:
            raise ValueError(f"to_mm ({self.to_mm:g}) must be above from_mm ({self.from_mm:g})")
        return self


class Region(Section):
    """Named region of all voxels whose centres lie in it."""

    name: Name = Field(description="Name of the region in figures.")
    shape: Annotated[Sphere | Cylinder | Box | Shell, Field(discriminator="kind")] = Field(
        description="Shape of the region; a shell is placed around its part."
    )
    position_mm: Vector = setting((0.0, 0.0, 0.0), "Origin in the specimen's frame.")
    rotation_deg: Vector = setting((0.0, 0.0, 0.0), "Extrinsic rotations about x, y, z.")

    @property
    def specimen_from_region(self) -> Pose:
        """Pose of the region in the specimen's frame."""
        return Pose.from_euler(self.position_mm, self.rotation_deg)


class RegionContrast(Section):
    """Contrast and contrast-to-noise ratio of one region against another."""

    region: str = Field(description="Name of the region.")
    against: str = Field(description="Name of the background region.")

    @property
    def label(self) -> str:
        """Name of its figures."""
        return f"{self.region}_against_{self.against}"


class Transfer(Section):
    """Local modulation transfer, measured at the edge of a sphere or at the side of a cylinder."""

    at: str = Field(
        description="Name of a part or region that is a sphere or a cylinder; the surface of a "
        "region must be that of a body of the specimen."
    )

    @property
    def label(self) -> str:
        """Name of its figures."""
        return figure_part(self.at)


class NoisePower(Section):
    """Noise power spectrum of a homogeneous region, with its trend removed."""

    region: str = Field(description="Name of the region.")

    @property
    def label(self) -> str:
        """Name of its figures."""
        return self.region


class Task(Section):
    """Detection of a signal in the noise of a region, rated by the index of detectability."""

    name: Name = Field(description="Name of the figure.")
    signal: AnySignal = Field(description="Signal to detect.")
    region: str = Field(
        description="Name of the homogeneous region in whose noise the signal lies."
    )
    mtf: str | None = setting(
        None, "Measured blur of the signal: an `at` of `evaluation.mtf`; null: no blur."
    )

    @property
    def label(self) -> str:
        """Name of its figure."""
        return self.name


class Streaks(Section):
    """Dependence of the error around a part on the direction."""

    part: str = Field(description="Name of the part, such as an implant.")
    from_mm: NonNegative = setting(2.0, "Distance from the part at which the shell begins.")
    to_mm: Length = setting(15.0, "Distance from the part at which the shell ends.")

    @model_validator(mode="after")
    def _outwards(self) -> Streaks:
        if self.to_mm <= self.from_mm:
            raise ValueError(f"to_mm ({self.to_mm:g}) must be above from_mm ({self.from_mm:g})")
        return self

    @property
    def label(self) -> str:
        """Name of its figure."""
        return figure_part(self.part)


class Evaluation(Section):
    """Measurements in the volume beyond the figures that every run has.

    They need no new volume: `twinct report DIR --set evaluation...` measures in an existing one.
    """

    regions: tuple[Region, ...] = setting((), "Named regions; each has a mean and an RMSE.")
    contrasts: tuple[RegionContrast, ...] = setting((), "Contrasts between regions.")
    mtf: tuple[Transfer, ...] = setting(
        (), "Parts and regions at which the modulation transfer is measured."
    )
    nps: tuple[NoisePower, ...] = setting(
        (), "Regions in which the noise power spectrum is measured."
    )
    tasks: tuple[Task, ...] = setting((), "Detection tasks.")
    streaks: tuple[Streaks, ...] = setting((), "Parts around which streaks are measured.")

    def region(self, name: str) -> Region:
        """Return the region with a given name."""
        return next(region for region in self.regions if region.name == name)

    def conflicts(self, specimen: Specimen) -> list[Conflict]:
        """Return conflicts of names that are unknown, repeated, or name a body without an edge."""
        regions = {region.name: region.shape for region in self.regions}
        parts = {part.label: part.shape for part in specimen.parts}
        bodies: Mapping[str, object] = parts | regions
        measured = {transfer.at: transfer for transfer in self.mtf}
        known: dict[tuple[str, str], tuple[str, Mapping[str, object]]] = {
            ("regions", "shape.part"): ("part", parts),
            ("contrasts", "region"): ("region", regions),
            ("contrasts", "against"): ("region", regions),
            ("mtf", "at"): ("part or region", bodies),
            ("nps", "region"): ("region", regions),
            ("tasks", "region"): ("region", regions),
            ("tasks", "mtf"): ("entry of evaluation.mtf", measured),
            ("streaks", "part"): ("part", parts),
        }
        found = [
            _conflict(f"{of}.{i}.{key}", f"unknown {what} {name!r}; {_are(having)}")
            for (of, key), (what, having) in known.items()
            for i, one in enumerate(getattr(self, of))
            if (name := _at(one, key)) is not None and name not in having
        ]
        for i, one in enumerate(self.mtf):
            body = bodies.get(one.at)
            if body is not None and not isinstance(body, Sphere | Cylinder):
                found.append(
                    _conflict(f"mtf.{i}.at", f"{one.at!r} is neither a sphere nor a cylinder")
                )
        found += [
            _conflict(f"regions.{i}.name", f"a part is also called {region.name!r}")
            for i, region in enumerate(self.regions)
            if region.name in parts
        ]
        for name, labels in {
            "regions": [one.name for one in self.regions],
            **{of: [one.label for one in getattr(self, of)] for of in KINDS},
        }.items():
            twice = [label for label, times in Counter(labels).items() if times > 1]
            found += [_conflict(name, f"{label!r} appears more than once") for label in twice]
        return found


KINDS = ("contrasts", "mtf", "nps", "tasks", "streaks")
"""Measurements that refer to regions and parts."""


def figure_part(name: str) -> str:
    """Return a name without dots, to be used as part of a dotted name."""
    return name.replace(".", "_")


def _at(section: Section, key: str) -> str | None:
    """Return the value of a section at a dotted key; None if it has no such key."""
    found: Any = section
    for step in key.split("."):
        found = getattr(found, step, None)
    return found


def _conflict(key: str, message: str) -> Conflict:
    return Conflict(f"evaluation.{key}: {message}", (f"evaluation.{key}",))


def _are(having: Iterable[str]) -> str:
    names = [repr(name) for name in having]
    return (
        f"{'choose from' if len(names) > 1 else 'the only one is'} {', '.join(names)}"
        if names
        else "none is defined"
    )
