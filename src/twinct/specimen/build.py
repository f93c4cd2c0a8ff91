"""From the scenario's specimen to closed, disjoint meshes with attenuation, and the true volume."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import scipy
from numpy.typing import NDArray

from twinct import scenario
from twinct.core.errors import SpecimenError
from twinct.core.foreign_text import quoted
from twinct.geometry import Floats, Pose, VolumeGrid
from twinct.specimen.materials import Material, material
from twinct.specimen.shapes import shape_surface
from twinct.specimen.surface import enclosed_volume, solids_once, subtract, surface
from twinct.specimen.voxels import volume_fractions

if TYPE_CHECKING:
    import trimesh

HULL_DIRECTIONS = 4000
"""Directions in which the collision hull touches the specimen, about 3 degrees apart."""
HULL_CAPS = 200
"""Groups of these directions, for speed."""

FARTHEST_MM = 1e7
SMALLEST_MM = 1e-5
"""Limits of a part's coordinates and edges: single precision renders nothing beyond."""
FLATTEST = 1e-7
"""Minimum ratio of a part's edges: the solid modellers reject flatter bodies."""


@dataclass(frozen=True, eq=False)
class BuiltPart:
    """One body of one material, with its name for messages.

    ``mesh`` is its closed surface in the specimen's frame, mm, counter-clockwise seen from outside.
    """

    name: str
    material: Material
    mesh: trimesh.Trimesh

    @property
    def volume_mm3(self) -> float:
        """Enclosed volume, mm^3."""
        return enclosed_volume(self.mesh)


@dataclass(frozen=True, eq=False)
class BuiltSpecimen:
    """A specimen ready to be imaged: images and true volume come from the same closed meshes.

    Its parts are disjoint. Where two overlapped in the scenario, the overlap belongs to the later
    one.
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
        """The part for relative figures of merit: the named one, or the largest."""
        named = (part for part in self.parts if part.name == self.reference)
        return next(named, self.largest_part) if self.reference else self.largest_part

    @cached_property
    def digest(self) -> str:
        """SHA-256 of all surfaces, in their order."""
        digest = hashlib.sha256()
        for part in self.parts:
            for array in (part.mesh.vertices, part.mesh.faces):
                digest.update(repr((array.shape, array.dtype.str)).encode())
                digest.update(np.ascontiguousarray(array).data)
        return digest.hexdigest()

    def reference_mu(self, energy_kev: float) -> float:
        """Return the attenuation of the reference part (mu of bone for a skull), 1/mm."""
        return self.reference_part.material.mu_per_mm(energy_kev)

    @cached_property
    def hull(self) -> trimesh.Trimesh:
        """Convex hull of all parts in the specimen's frame, mm, for collision checks.

        Its corners are the outermost points in ``HULL_DIRECTIONS`` directions, which keeps it small
        for round surfaces. A skull protrudes by at most 0.4 mm.
        """
        import trimesh

        points = np.concatenate([part.mesh.vertices for part in self.parts])
        try:
            points = points[scipy.spatial.ConvexHull(points).vertices]
        except scipy.spatial.QhullError:
            edges = " x ".join(f"{edge:g}" for edge in np.ptp(points, axis=0))
            raise SpecimenError(
                f"specimen.parts: all parts together measure {edges} mm, too flat for a solid body"
            ) from None
        return trimesh.convex.convex_hull(points[_outermost(points)])

    def surface(self) -> trimesh.Trimesh:
        """Return all parts' surfaces as one mesh in the specimen's frame, mm, for pictures."""
        import trimesh

        whole = trimesh.util.concatenate([part.mesh for part in self.parts])
        assert isinstance(whole, trimesh.Trimesh)
        return whole

    def truth(
        self, grid: VolumeGrid, energy_kev: float, world_from_specimen: Pose | None = None
    ) -> NDArray[np.float32]:
        """Return the attenuation per voxel: volume fraction of each part times its mu.

        Args:
            grid: voxel grid to sample.
            energy_kev: photon energy, keV.
            world_from_specimen: pose of the specimen; its own pose by default.

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
    """Build every part, then subtract from each the volume that later parts cover.

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
                problems.append(f"specimen.parts.{i}.shape: part {quoted(part.label)} {why}")
                continue
            built.append(BuiltPart(part.label, substance, placed))
    if problems:
        raise SpecimenError(problems)
    return BuiltSpecimen(_disjoint(built), section.world_from_specimen, section.reference)


def _no_body(mesh: trimesh.Trimesh) -> str:
    """Return the reason why no simulation can handle a part; empty if valid."""
    if not len(mesh.faces):
        return "has no surface"
    edges = np.ptp(mesh.bounds, axis=0)
    told = " x ".join(f"{edge:g}" for edge in edges)
    if not np.abs(mesh.bounds).max() <= FARTHEST_MM:
        return f"reaches beyond {FARTHEST_MM:g} mm: it measures {told} mm"
    if not edges.min() >= max(SMALLEST_MM, FLATTEST * edges.max()):
        return f"is too small or too flat: it measures {told} mm"
    return ""


def _outermost(points: Floats) -> NDArray[np.intp]:
    """Return the sorted indices of the points (n, 3) farthest in each of ``HULL_DIRECTIONS``.

    The farthest point p in a direction d near a cap's axis c fulfils, with q the farthest along c,

        c . p >= c . q - (|p| + |q|) |d - c|,

    so each cap of directions needs few points.
    """
    points = points - points.mean(axis=0)
    radius = np.linalg.norm(points, axis=1).max()
    directions, axes = _sphere_directions(HULL_DIRECTIONS), _sphere_directions(HULL_CAPS)
    nearest = (directions @ axes.T).argmax(axis=1)
    found = []
    for cap in np.unique(nearest):
        within, axis = directions[nearest == cap], axes[cap]
        heights = points @ axis
        slack = 2 * radius * np.linalg.norm(within - axis, axis=1).max()
        candidates = np.flatnonzero(heights >= heights.max() - slack)
        found.append(candidates[(within @ points[candidates].T).argmax(axis=1)])
    return np.unique(np.concatenate(found))


def _sphere_directions(count: int) -> Floats:
    """Return evenly spread unit vectors (count, 3) (a Fibonacci spiral), and the six axes."""
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
                f"part {quoted(part.name)} is empty: later parts cover it completely. Where parts "
                "overlap, the later one wins; list the outer part first"
            )
    if problems:
        raise SpecimenError(problems)
    return tuple(disjoint)
