"""Regions and parts that a scenario's section ``evaluation`` names, on the grid of a volume."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from twinct import scenario
from twinct.core.errors import SpecimenError
from twinct.core.foreign_text import quoted
from twinct.evaluation import (
    Again,
    Measurement,
    RoundBody,
    VoxelSet,
    ball,
    cuboid,
    cylinder,
    figure_kinds,
    shell,
    whole,
)
from twinct.geometry import Pose, VolumeGrid
from twinct.scenario import Evaluation
from twinct.scenario.imported import ScanSettings
from twinct.specimen import BuiltSpecimen
from twinct.specimen.voxels import volume_fractions


@dataclass(frozen=True, eq=False)
class Places:
    """Voxels of the regions and parts of a scenario.

    Attributes:
        scenario: settings that name the regions.
        specimen: the built specimen with its parts; None if it is not known.
        world_from_specimen: pose of the specimen, in whose frame regions are.
        grid: grid of the voxels.
    """

    scenario: ScanSettings
    specimen: BuiltSpecimen | None
    world_from_specimen: Pose
    grid: VolumeGrid

    @property
    def section(self) -> Evaluation:
        """The section ``evaluation``, or an empty one."""
        return self.scenario.evaluation or Evaluation()

    def region(self, name: str) -> VoxelSet:
        """Return the voxels of a region."""
        region = self.section.region(name)
        pose, shape = self.world_from_specimen @ region.specimen_from_region, region.shape
        match shape:
            case scenario.Sphere():
                return ball(self.grid, pose, shape.radius_mm)
            case scenario.Cylinder():
                return cylinder(self.grid, pose, shape.radius_mm, shape.height_mm)
            case scenario.Box():
                return cuboid(self.grid, pose, shape.size_mm)
            case scenario.Shell():
                return shell(self.part(shape.part), self.grid, shape.from_mm, shape.to_mm)
            case scenario.WholePart():
                return self.part(shape.part)

    def part(self, name: str) -> VoxelSet:
        """Return all voxels that a part fills, even partly, or that a label fills by half."""
        part = self._built.named(name, "evaluation")
        if label := part.label_of(name):
            return whole(part.label_on(label, self.grid, self.world_from_specimen))
        mesh = part.mesh
        low, high = np.asarray(mesh.bounds)
        middle = Pose.from_euler((low + high) / 2, (0.0, 0.0, 0.0))
        place = self.world_from_specimen
        box = cuboid(self.grid, place @ middle, high - low + 2 * self.grid.voxel.max()).box
        if not all(side.stop > side.start for side in box):
            return VoxelSet(box, np.zeros([s.stop - s.start for s in box], dtype=np.bool_))
        grid = self.grid.part(box)
        return VoxelSet(box, volume_fractions(mesh.vertices, mesh.faces, grid, place) > 0)

    @property
    def _built(self) -> BuiltSpecimen:
        if self.specimen is None:
            raise ValueError("settings without a specimen name no part: they were checked")
        return self.specimen

    def body(self, name: str) -> RoundBody:
        """Return a region or a part that is a sphere or a cylinder, in the world."""
        parts = self.scenario.specimen.parts if self.scenario.specimen else ()
        named = [
            *((one.name, one.specimen_from_region, one.shape) for one in self.section.regions),
            *((part.label, part.specimen_from_part, part.shape) for part in parts),
        ]
        for label, place, shape in named:
            if label == name and isinstance(shape, scenario.Sphere | scenario.Cylinder):
                height = shape.height_mm if isinstance(shape, scenario.Cylinder) else None
                return RoundBody(self.world_from_specimen @ place, shape.radius_mm, height)
        raise AssertionError(f"no sphere or cylinder {name!r}")

    def check(self) -> list[str]:
        """Return a sentence for each entry that cannot be measured, beginning with its key."""
        if unknown := self._unknown_parts():
            return unknown
        problems_by_key: dict[str, str] = {}
        for i, region in enumerate(self.section.regions):
            # A shell is covered if its part is: see below.
            of_part = isinstance(region.shape, scenario.Shell | scenario.WholePart)
            if not (of_part or len(self.region(region.name))):
                problems_by_key[f"regions.{i}"] = (
                    f"{quoted(region.name)} covers no voxel of the grid"
                )
        for key, name, target in self.section.references():
            if target == "part" and not len(self.part(name)):
                problems_by_key[key] = f"{quoted(name)} covers no voxel of the grid"
        for kind in figure_kinds().values():
            for i, one in enumerate(self.section.entries(kind.name)):
                problems = kind.check(self, one)
                problems_by_key |= {f"{kind.name}.{i}.{key}": why for key, why in problems.items()}
        return [f"evaluation.{key}: {why}" for key, why in problems_by_key.items()]

    def _unknown_parts(self) -> list[str]:
        """Return a sentence for each name that no part and no label has."""
        problems: list[str] = []
        for key, name, target in self.section.references():
            if target == "part":
                try:
                    self._built.named(name, f"evaluation.{key}")
                except SpecimenError as error:
                    problems += error.problems
        return problems

    def figures(
        self,
        volume: Any,
        truth: Any,
        mu_reference: float,
        signal_rel: float = math.nan,
        mu_water: float = math.nan,
        again: Again | None = None,
        signal_error_rel: float = 0.0,
    ) -> dict[str, Any]:
        """Compute all requested figures and curves, by kind and name.

        Args:
            volume: attenuation on the grid, (z, y, x), 1/mm.
            truth: true attenuation on the grid, (z, y, x), 1/mm; None if it is not known.
            mu_reference: attenuation to which figures are relative, 1/mm; NaN without a truth.
            signal_rel: contrast of the volume, relative to the truth's; NaN if it is unknown.
            mu_water: attenuation of water, 1/mm; NaN if it is unknown.
            again: takes the scan of the volume again, for figures that need it.
            signal_error_rel: standard error of ``signal_rel``.
        """
        of_volume = volume, truth, mu_reference, signal_rel, mu_water
        at = Measurement(self, *of_volume, again, signal_error_rel)
        return {
            kind.name: {one.label: kind.measured(at, one) for one in entries}
            for kind in figure_kinds().values()
            if (entries := self.section.entries(kind.name))
            if truth is not None or not kind.needs_truth
        }
