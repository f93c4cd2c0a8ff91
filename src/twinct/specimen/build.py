"""From the scenario's specimen to closed, disjoint meshes with attenuation, and their truth."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import scipy
from numpy.typing import NDArray

from twinct import scenario
from twinct.errors import SpecimenError
from twinct.geometry import Floats, Pose, VolumeGrid
from twinct.specimen.materials import Material, material
from twinct.specimen.shapes import shape_surface
from twinct.specimen.surface import solids_once, subtract, surface
from twinct.specimen.voxels import volume_fractions

if TYPE_CHECKING:
    import trimesh

HULL_DIRECTIONS = 4000
"""Directions in which the collision hull touches the specimen, about 3 degrees apart."""


FARTHEST_MM = 1e7
SMALLEST_MM = 1e-5
"""Of coordinates and edges of a part: single precision renders neither more nor less."""
FLATTEST = 1e-7
"""Least edge of a part beside its largest: what is flatter is no body to the modellers."""


@dataclass(frozen=True, eq=False)
class BuiltPart:
    """One body of one material, which messages call by its name.

    ``mesh`` is its closed surface in the specimen's frame, mm, counter-clockwise seen from outside.
    """

    name: str
    material: Material
    mesh: trimesh.Trimesh

    @property
    def volume_mm3(self) -> float:
        """Enclosed volume, mm^3."""
        return float(self.mesh.volume)


@dataclass(frozen=True, eq=False)
class BuiltSpecimen:
    """A specimen ready to be imaged: image and truth come from the same closed meshes.

    Its parts are disjoint; where two overlapped in the scenario, the later one has the overlap.
    """

    parts: tuple[BuiltPart, ...]
    world_from_specimen: Pose
    reference: str = ""

    @property
    def bounds(self) -> Floats:
        """Lowest and highest corner (2, 3) in the specimen's frame, mm."""
        corners = np.array([part.mesh.bounds for part in self.parts])
        return np.stack([corners[:, 0].min(axis=0), corners[:, 1].max(axis=0)])

    @property
    def largest_part(self) -> BuiltPart:
        """The part with the largest volume."""
        return max(self.parts, key=lambda part: part.volume_mm3)

    @property
    def reference_part(self) -> BuiltPart:
        """The part that figures are relative to: the named one, or the largest."""
        named = (part for part in self.parts if part.name == self.reference)
        return next(named, self.largest_part) if self.reference else self.largest_part

    def reference_mu(self, energy_kev: float) -> float:
        """Attenuation of the reference part (mu of bone for a skull), 1/mm."""
        return self.reference_part.material.mu_per_mm(energy_kev)

    @cached_property
    def hull(self) -> trimesh.Trimesh:
        """Convex hull of all parts in the specimen's frame, mm, for collision.

        Its corners are the outermost points in ``HULL_DIRECTIONS`` directions, so that it stays
        small where a surface is round; a skull sticks out of it by 0.4 mm at most.
        """
        import trimesh

        points = np.concatenate([part.mesh.vertices for part in self.parts])
        try:
            points = points[scipy.spatial.ConvexHull(points).vertices]
        except scipy.spatial.QhullError:
            edges = " x ".join(f"{edge:g}" for edge in np.ptp(points, axis=0))
            raise SpecimenError(
                f"specimen.parts: all of them together measure {edges} mm: too flat for a body"
            ) from None
        blocks = np.array_split(_sphere_directions(HULL_DIRECTIONS), 40)
        outermost = np.unique(np.concatenate([(points @ b.T).argmax(axis=0) for b in blocks]))
        return trimesh.convex.convex_hull(points[outermost])

    def surface(self) -> trimesh.Trimesh:
        """The surfaces of all parts as one mesh in the specimen's frame, mm, for pictures."""
        import trimesh

        whole = trimesh.util.concatenate([part.mesh for part in self.parts])
        assert isinstance(whole, trimesh.Trimesh)
        return whole

    def truth(
        self, grid: VolumeGrid, energy_kev: float, world_from_specimen: Pose | None = None
    ) -> NDArray[np.float32]:
        """Attenuation per voxel: volume fraction of each part times its mu.

        Args:
            grid: where to sample.
            energy_kev: photon energy, keV.
            world_from_specimen: where the specimen is; where it stands, unless given.

        Returns:
            (nz, ny, nx) float32, 1/mm.
        """
        volume = np.zeros(grid.shape, dtype=np.float32)
        pose = world_from_specimen or self.world_from_specimen
        for part in self.parts:
            mesh, mu_per_mm = part.mesh, part.material.mu_per_mm(energy_kev)
            volume_fractions(mesh.vertices, mesh.faces, grid, pose, weight=mu_per_mm, out=volume)
        return volume


def build_specimen(section: scenario.Specimen) -> BuiltSpecimen:
    """Build every part, then take from each what later parts cover.

    Raises:
        SpecimenError: with one sentence for each part that cannot be built.
    """
    problems: list[str] = []
    built: list[BuiltPart] = []
    for i, part in enumerate(section.parts):
        try:
            substance = material(part.material, origin=f"specimen.parts.{i}.material")
        except SpecimenError as error:
            problems.extend(error.problems)
            substance = None
        try:
            mesh = shape_surface(part.shape, part.label)
        except SpecimenError as error:
            problems.extend(error.problems)
            continue
        if substance is not None:
            placed = surface(part.specimen_from_part.apply(mesh.vertices), mesh.faces)
            if why := _no_body(placed):
                problems.append(f"specimen.parts.{i}.shape: part {part.label!r} {why}")
                continue
            built.append(BuiltPart(part.label, substance, placed))
    if problems:
        raise SpecimenError(problems)
    return BuiltSpecimen(_disjoint(built), section.world_from_specimen, section.reference)


def _no_body(mesh: trimesh.Trimesh) -> str:
    """Why no simulation could hold a part; empty if it can."""
    if not len(mesh.faces):
        return "has no surface"
    edges = np.ptp(mesh.bounds, axis=0)
    told = " x ".join(f"{edge:g}" for edge in edges)
    if not np.abs(mesh.bounds).max() <= FARTHEST_MM:
        return f"reaches beyond {FARTHEST_MM:g} mm: it measures {told} mm"
    if not edges.min() >= max(SMALLEST_MM, FLATTEST * edges.max()):
        return f"is too small or too flat: it measures {told} mm"
    return ""


def _sphere_directions(count: int) -> Floats:
    """Unit vectors (count, 3), evenly spread (a Fibonacci spiral), and the six axes."""
    step = np.arange(count) + 0.5
    z, turn = 1 - 2 * step / count, np.pi * (1 + np.sqrt(5)) * step
    ring = np.sqrt(1 - z * z)
    spiral = np.stack([ring * np.cos(turn), ring * np.sin(turn), z], axis=1)
    return np.concatenate([spiral, np.eye(3), -np.eye(3)])


def _disjoint(parts: list[BuiltPart]) -> tuple[BuiltPart, ...]:
    disjoint: list[BuiltPart] = []
    problems: list[str] = []
    solid = solids_once()
    for i, part in enumerate(parts):
        mesh = subtract(part.mesh, [later.mesh for later in parts[i + 1 :]], part.name, solid)
        disjoint.append(replace(part, mesh=mesh))
        if not len(mesh.faces):
            problems.append(
                f"part {part.name!r} is empty: later parts cover all of it. Where parts "
                "overlap the later one wins; list the outer part first"
            )
    if problems:
        raise SpecimenError(problems)
    return tuple(disjoint)
