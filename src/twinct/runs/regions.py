"""Figures that a scenario's section ``evaluation`` requests, for the regions that it names."""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from twinct import scenario
from twinct.core.errors import InputError
from twinct.core.signals import contrast_at
from twinct.evaluation import (
    Mtf,
    Nps,
    Voxels,
    around_axis,
    ball,
    centres,
    contrast,
    cuboid,
    cylinder,
    detectability,
    detrended,
    edge_mtf,
    edge_reach,
    noise_power_spectrum,
    part_of,
    shell,
    streak_index,
)
from twinct.geometry import Floats, Pose, VolumeGrid
from twinct.scenario import Evaluation, Scenario
from twinct.specimen import BuiltSpecimen
from twinct.specimen.voxels import volume_fractions

log = logging.getLogger(__name__)

OF_KIND = {
    "regions": ("mean_rel", "bias_rel", "rmse_rel"),
    "contrasts": ("contrast_rel", "recovery", "cnr"),
    "mtf": ("f50_per_mm", "f10_per_mm"),
    "nps": ("noise_rel", "mean_frequency_per_mm"),
    "tasks": ("detectability",),
    "streaks": ("streak_rel",),
}
"""Kinds of figures, and the scalar figures of each kind; curves are left out."""

_LEAST_RADIUS_VOXELS = 2.0
"""Smallest radius of a body whose edge gives an MTF, voxels."""


def named_figures(section: Evaluation) -> list[str]:
    """Return the dotted names, below ``image``, of the figures that a section requests."""
    names = {kind: [one.label for one in getattr(section, kind)] for kind in list(OF_KIND)[1:]}
    names["regions"] = [region.name for region in section.regions]
    return [
        f"{kind}.{label}.{figure}"
        for kind, figures in OF_KIND.items()
        for label in names[kind]
        for figure in figures
    ]


@dataclass(frozen=True, eq=False)
class Places:
    """Voxels of the regions and parts of a scenario.

    Attributes:
        scenario: scenario that names the regions.
        specimen: the built specimen with its parts.
        world_from_specimen: pose of the specimen.
        grid: grid of the voxels.
    """

    scenario: Scenario
    specimen: BuiltSpecimen
    world_from_specimen: Pose
    grid: VolumeGrid

    @property
    def section(self) -> Evaluation:
        """The section ``evaluation``, or an empty one."""
        return self.scenario.evaluation or Evaluation()

    def region(self, name: str) -> Voxels:
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

    def part(self, name: str) -> Voxels:
        """Return all voxels that a part fills, even partly."""
        mesh = next(part.mesh for part in self.specimen.parts if part.name == name)
        low, high = np.asarray(mesh.bounds)
        middle = Pose.from_euler((low + high) / 2, (0.0, 0.0, 0.0))
        place = self.world_from_specimen
        box = cuboid(self.grid, place @ middle, high - low + 2 * self.grid.voxel.max()).box
        if not all(side.stop > side.start for side in box):
            return Voxels(box, np.zeros([s.stop - s.start for s in box], dtype=np.bool_))
        grid = part_of(self.grid, box)
        return Voxels(box, volume_fractions(mesh.vertices, mesh.faces, grid, place) > 0)

    def body(self, name: str) -> tuple[Pose, scenario.Sphere | scenario.Cylinder]:
        """Return world pose and shape of a region or a part that is a sphere or a cylinder."""
        for region in self.section.regions:
            if region.name == name and isinstance(
                region.shape, scenario.Sphere | scenario.Cylinder
            ):
                return self.world_from_specimen @ region.specimen_from_region, region.shape
        parts = (part for part in self.scenario.specimen.parts if part.label == name)
        for part in parts:
            if isinstance(part.shape, scenario.Sphere | scenario.Cylinder):
                return self.world_from_specimen @ part.specimen_from_part, part.shape
        raise AssertionError(f"no sphere or cylinder {name!r}")

    def check(self) -> list[str]:
        """Return a sentence for each entry that cannot be measured, beginning with its key."""
        found: list[str] = []
        for i, region in enumerate(self.section.regions):
            if isinstance(region.shape, scenario.Shell):
                key, voxels = f"regions.{i}.shape.part", self.part(region.shape.part)
            else:
                key, voxels = f"regions.{i}", self.region(region.name)
            if not len(voxels):
                found.append(f"evaluation.{key}: {region.name!r} covers no voxel of the grid")
        for i, streaks in enumerate(self.section.streaks):
            if not len(self.part(streaks.part)):
                found.append(
                    f"evaluation.streaks.{i}.part: {streaks.part!r} covers no voxel of the grid"
                )
        least = _LEAST_RADIUS_VOXELS * float(self.grid.voxel.max())
        for i, transfer in enumerate(self.section.mtf):
            pose, shape = self.body(transfer.at)
            if shape.radius_mm < least:
                found.append(
                    f"evaluation.mtf.{i}.at: {transfer.at!r} has a radius of {shape.radius_mm:g} "
                    f"mm; its edge needs at least {least:g} mm, {_LEAST_RADIUS_VOXELS:g} voxels"
                )
            elif not len(ball(self.grid, pose, shape.radius_mm)):
                found.append(f"evaluation.mtf.{i}.at: {transfer.at!r} lies outside the grid")
        return found

    def figures(self, volume: Any, truth: Any, mu_reference: float) -> dict[str, Any]:
        """Compute all requested figures and curves, by kind and name.

        Args:
            volume: attenuation on the grid, (z, y, x), 1/mm.
            truth: true attenuation on the grid, (z, y, x), 1/mm.
            mu_reference: attenuation to which figures are relative, 1/mm.
        """
        section, found = self.section, {kind: dict[str, Any]() for kind in OF_KIND}
        places = {region.name: self.region(region.name) for region in section.regions}
        for name, voxels in places.items():
            values = voxels.of(volume)
            error = values - voxels.of(truth)
            figures = _mean(values), _mean(error), math.sqrt(_mean(error * error))
            found["regions"][name] = {
                key: figure / mu_reference
                for key, figure in zip(OF_KIND["regions"], figures, strict=True)
            }
        for one in section.contrasts:
            inner, outer = places[one.region], places[one.against]
            found["contrasts"][one.label] = contrast(
                inner.of(volume), outer.of(volume), inner.of(truth), outer.of(truth), mu_reference
            ).as_dict()
        transfers = {one.at: self._transfer(one.at, volume) for one in section.mtf}
        for one in section.mtf:
            found["mtf"][one.label] = _of_transfer(transfers[one.at])
        for one in section.nps:
            spectrum = self._spectrum(places[one.region], volume, truth, mu_reference)
            found["nps"][one.label] = _of_spectrum(spectrum)
        for task in section.tasks:
            spectrum = self._spectrum(places[task.region], volume, truth, mu_reference)
            transfer = 1.0 if task.mtf is None else transfers[task.mtf]
            signal, edges = _signal(task.signal, self.grid), self.grid.voxel[::-1].tolist()
            index = math.nan
            if transfer is not None and spectrum is not None:
                index = detectability(signal, edges, spectrum, transfer)
            found["tasks"][task.label] = {"detectability": index}
        for one in section.streaks:
            body = self.part(one.part)
            near = shell(body, self.grid, one.from_mm, one.to_mm)
            index = math.nan
            if len(near) and len(body):
                error = (near.of(volume) - near.of(truth)) / mu_reference
                where = around_axis(near.points(self.grid), body.points(self.grid))
                index = streak_index(error, *where)
            found["streaks"][one.label] = {"streak_rel": index}
        return {kind: figures for kind, figures in found.items() if figures}

    def _transfer(self, name: str, volume: Any) -> Mtf | None:
        pose, shape = self.body(name)
        voxel, radius = float(self.grid.voxel.min()), shape.radius_mm
        reach = edge_reach(radius, voxel)
        if isinstance(shape, scenario.Sphere):
            box, curved = ball(self.grid, pose, radius + reach).box, 2
        else:
            box, curved = cylinder(self.grid, pose, radius + reach, shape.height_mm).box, 1
        points = centres(self.grid, box, pose)
        offset = np.linalg.norm(points[..., : curved + 1], axis=-1) - radius
        values = volume[box]
        if isinstance(shape, scenario.Cylinder):  # the lateral surface only
            side = np.abs(points[..., 2]) <= shape.height_mm / 2
            offset, values = offset[side], values[side]
        try:
            return edge_mtf(values, offset, radius, voxel, curved)
        except InputError as error:
            log.warning("no MTF at %s: %s", name, error)
            return None

    def _spectrum(self, voxels: Voxels, volume: Any, truth: Any, mu_reference: float) -> Nps | None:
        if not len(voxels):
            return None
        error = (volume[voxels.box] - truth[voxels.box]).astype(np.float64) / mu_reference
        noise = detrended(error, voxels.mask)
        return noise_power_spectrum(noise, self.grid.voxel[::-1].tolist(), voxels.mask)


def _of_spectrum(spectrum: Nps | None) -> dict[str, Any]:
    if spectrum is None:
        return dict.fromkeys(OF_KIND["nps"], math.nan)
    return {
        "noise_rel": math.sqrt(spectrum.variance),
        "mean_frequency_per_mm": spectrum.mean_frequency_per_mm,
        "frequency_per_mm": spectrum.frequency_per_mm,
        "nps_mm3": spectrum.value,
    }


def _of_transfer(transfer: Mtf | None) -> dict[str, Any]:
    if transfer is None:
        return dict.fromkeys(OF_KIND["mtf"], math.nan)
    return {
        "f50_per_mm": transfer.falls_to(0.5),
        "f10_per_mm": transfer.falls_to(0.1),
        "frequency_per_mm": transfer.frequency_per_mm,
        "mtf": transfer.value,
    }


def _signal(signal: scenario.SphereSignal | scenario.GaussianSignal, grid: VolumeGrid) -> Floats:
    """Return the contrast on a grid of twice the sphere's size, or of 6 sigma to each side."""
    sphere = isinstance(signal, scenario.SphereSignal)
    half = 2 * signal.radius_mm if sphere else 6 * signal.sigma_mm
    count = (2 * np.ceil(half / grid.voxel[::-1]) + 1).astype(int).tolist()
    lattice = VolumeGrid(count, grid.voxel)
    z, y, x = (slice(0, n) for n in count)
    radius = np.linalg.norm(centres(lattice, (z, y, x)), axis=-1)
    return contrast_at(signal, radius, float(grid.voxel.mean()))


def _mean(values: Floats) -> float:
    return float(values.mean()) if values.size else math.nan
