"""From the scenario's specimen to closed, disjoint meshes with attenuation, and the true volume."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar

import numpy as np
import scipy
from numpy.typing import NDArray

from twinct.core.errors import SpecimenError
from twinct.core.foreign_text import quoted
from twinct.geometry import Floats, Panel, Pose, VolumeGrid
from twinct.specimen import sections
from twinct.specimen.body_motion import body_motion, require_possible
from twinct.specimen.breathing import Breath
from twinct.specimen.convex_parts import ROUNDING_MM, Fit, beyond, convex_parts, fit_of
from twinct.specimen.grey_part import GreyPart
from twinct.specimen.grey_volume import grey_part
from twinct.specimen.materials import BUILT_IN, Material, material
from twinct.specimen.own_parts import own_part
from twinct.specimen.part import Caster, Part, add_mesh
from twinct.specimen.shapes import shape_surface
from twinct.specimen.surface import (
    ToSolid,
    joined,
    solids_once,
    subtract,
    surface,
    to_manifold,
)
from twinct.specimen.voxels import volume_fractions

if TYPE_CHECKING:
    import trimesh

    from twinct.specimen.body_motion import BodyMotion
    from twinct.specimen.breathing import Breath
    from twinct.specimen.colours import Rgb

HULL_DIRECTIONS = 4000
"""Directions in which the collision hull touches the specimen, about 3 degrees apart."""
HULL_CAPS = 800
"""Groups of these directions, for speed."""
GROWTH = 1.005
"""Way of a margin's corners relative to the margin: between them, the surface is nearer."""

FARTHEST_MM = 1e7
SMALLEST_MM = 1e-5
"""Limits of a part's coordinates and edges: single precision renders nothing beyond."""
FLATTEST = 1e-7
"""Minimum ratio of a part's edges: the solid modellers reject flatter bodies."""


@dataclass(frozen=True, eq=False)
class BuiltPart(Part):
    """One body of one material within a closed mesh, which X-ray engines render."""

    name: str
    material: Material
    mesh: trimesh.Trimesh
    own_rays: ClassVar[bool] = False

    def caster(self, panel: Panel) -> Caster:
        """Return rays through the mesh, for bodies that stand beside the engine's scene."""
        from twinct.specimen.mesh_caster import MeshCaster

        return MeshCaster(self.mesh, panel)

    def add_truth(
        self,
        grid: VolumeGrid,
        energy_kev: float,
        world_from_specimen: Pose,
        out: NDArray[np.float32],
    ) -> None:
        """Add the attenuation where the mesh is; see ``Part``."""
        mu, mesh = self.material.mu_per_mm(energy_kev), self.mesh
        volume_fractions(mesh.vertices, mesh.faces, grid, world_from_specimen, weight=mu, out=out)

    def shares(
        self, grid: VolumeGrid, world_from_specimen: Pose
    ) -> list[tuple[Material, NDArray[np.float32]]]:
        """Return the volume fractions of the material in the voxels of a grid."""
        mesh = self.mesh
        share = volume_fractions(mesh.vertices, mesh.faces, grid, world_from_specimen)
        return [(self.material, share)]

    def without(self, meshes: Sequence[trimesh.Trimesh], solid: ToSolid = to_manifold) -> BuiltPart:
        """Return the part outside closed meshes."""
        return replace(self, mesh=subtract(self.mesh, meshes, self.name, solid))

    def update(self, digest: hashlib._Hash) -> None:
        """Feed the surface to a digest."""
        add_mesh(digest, self.mesh)


@dataclass(frozen=True, eq=False)
class BuiltSpecimen:
    """A specimen ready to be imaged: images and true volume come from the same bodies.

    Its parts are disjoint. Where two overlapped in the scenario, the overlap belongs to the later
    one. A part that moves is in its reference state, full exhalation.
    """

    parts: tuple[Part, ...]
    world_from_specimen: Pose
    reference: str = ""
    motion: BodyMotion | None = None

    def placed(self, world_from_specimen: Pose) -> BuiltSpecimen:
        """Return the specimen in another place, with the hulls that are known."""
        moved = replace(self, world_from_specimen=world_from_specimen)
        known = {name: vars(self)[name] for name in ("hull", "hulls") if name in vars(self)}
        vars(moved).update(known)
        return moved

    @property
    def bounds(self) -> Floats:
        """Lowest and highest corner (2, 3) in the specimen's frame, mm."""
        corners = np.array([part.mesh.bounds for part in self.parts])
        return np.stack([corners[:, 0].min(axis=0), corners[:, 1].max(axis=0)])

    @property
    def pure(self) -> tuple[Part, ...]:
        """Parts of one material."""
        return tuple(part for part in self.parts if part.homogeneous)

    @property
    def mixtures(self) -> tuple[Part, ...]:
        """Parts of several materials, such as patients of voxels."""
        return tuple(part for part in self.parts if not part.homogeneous)

    def at(self, breath: Breath) -> BuiltSpecimen:
        """Return the specimen at rest in a state of breathing; itself if no part moves."""
        motion = self.motion
        if motion is None:
            return self
        parts = (
            motion.moved(p, breath) if isinstance(p, GreyPart) and p.name == motion.part else p
            for p in self.parts
        )
        return replace(self, parts=tuple(parts), motion=None)

    @property
    def materials(self) -> tuple[Material, ...]:
        """All materials that attenuate: of pure parts, then of mixtures, each once."""
        parts = (*self.pure, *self.mixtures)
        return tuple(dict.fromkeys(one for part in parts for one in part.materials))

    @property
    def largest_part(self) -> Part:
        """The part with the largest volume."""
        return max(self.parts, key=lambda part: part.volume_mm3)

    @property
    def reference_part(self) -> Part:
        """The part for relative figures of merit: the named one, or the largest.

        A label names its part.
        """
        if not self.reference:
            return self.largest_part
        named = (part for part in self.parts if part.name == self.reference)
        return next(named, None) or self.labelled(self.reference) or self.largest_part

    @property
    def reference_name(self) -> str:
        """The material, or the label, to whose attenuation figures are relative."""
        part = self.reference_part
        return self.reference if self._by_label else part.material.name

    @property
    def _by_label(self) -> bool:
        named = any(part.name == self.reference for part in self.parts)
        return bool(self.reference) and not named and self.labelled(self.reference) is not None

    def require_names(self) -> None:
        """Raise if no part and no label has the name of the reference.

        Raises:
            SpecimenError: the name is unknown.
        """
        if self.reference:
            self.named(self.reference, "specimen.reference")

    def named(self, name: str, key: str) -> Part:
        """Return the part with a name, or with a label of this name.

        Raises:
            SpecimenError: there is none; begins with the key.
        """
        match = next((part for part in self.parts if part.name == name), None)
        if (part := match or self.labelled(name)) is None:
            names = [n for part in self.parts for n in (part.name, *part.label_names)]
            raise SpecimenError(
                f"{key}: no part or label is called {quoted(name)}; there are {quoted(names, 300)}"
            )
        return part

    def labelled(self, label: str) -> Part | None:
        """Return the part with a label, if any."""
        return next((part for part in self.parts if label in part.label_names), None)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of all surfaces and voxels, in their order."""
        digest = hashlib.sha256()
        for part in self.parts:
            part.update(digest)
        return digest.hexdigest()

    def reference_mu(self, energy_kev: float) -> float:
        """Return the attenuation of the reference part (mu of bone for a skull), 1/mm.

        A label has the mean of its voxels.
        """
        part = self.reference_part
        if self._by_label:
            return part.mean_mu(energy_kev, self.reference)
        return part.material.mu_per_mm(energy_kev)

    def reference_voxels(
        self, grid: VolumeGrid, world_from_specimen: Pose
    ) -> NDArray[np.bool_] | None:
        """Return the voxels of the label that is the reference; None if a part is."""
        part = self.reference_part
        if not self._by_label:
            return None
        return part.label_on(self.reference, grid, world_from_specimen)

    @cached_property
    def hull(self) -> trimesh.Trimesh:
        """Convex hull of all parts in the specimen's frame, mm.

        Its corners are the outermost points in ``HULL_DIRECTIONS`` directions, which keeps it small
        for round surfaces. A skull protrudes by at most 0.4 mm.
        """
        points = np.concatenate([part.mesh.vertices for part in self.parts])
        if self.motion is not None:
            still = self.named(self.motion.part, "specimen.motion").mesh.vertices
            points = np.concatenate([points, *self._breathing(still)])
        try:
            points = points[scipy.spatial.ConvexHull(points).vertices]
        except scipy.spatial.QhullError:
            edges = " x ".join(f"{edge:g}" for edge in np.ptp(points, axis=0))
            raise SpecimenError(
                f"specimen.parts: all parts together measure {edges} mm, too flat for a solid body"
            ) from None
        return _hull(points)

    @cached_property
    def hulls(self) -> tuple[trimesh.Trimesh, ...]:
        """Convex bodies that hold all parts together, in the specimen's frame, mm, for collision.

        The skin of a mixture becomes several, in all states of breathing. Without mixtures, the
        whole specimen is one.
        """
        if not self.mixtures:
            return (self.hull,)
        convex: list[trimesh.Trimesh] = []
        for part in self.mixtures:
            moves = self.motion is not None and part.name == self.motion.part
            for body in convex_parts(part.mesh):
                points = np.asarray(body.vertices)
                if moves:
                    points = np.concatenate([points, *self._breathing(_skin_in(part.mesh, body))])
                convex.append(_hull(points))
        pure = (_hull(np.asarray(part.mesh.vertices)) for part in self.pure)
        return (*convex, *(one for one in pure if not any(_holds(skin, one) for skin in convex)))

    @cached_property
    def skin_fits(self) -> dict[str, Fit]:
        """Fit of the convex bodies around the skin of each mixture at rest, by the part's name."""
        return {part.name: fit_of(part.mesh, convex_parts(part.mesh)) for part in self.mixtures}

    def _breathing(self, points: Floats) -> Iterator[Floats]:
        """Yield points of the moving part in deep breaths."""
        assert self.motion is not None
        depth = float(np.exp(2 * self.motion.rhythm.irregularity))
        for phase in (0.25, 0.5, 0.75):
            yield self.motion.deformation(Breath(phase, depth)).from_reference(np.array(points))

    def obstacles(self, margin_mm: float) -> tuple[trimesh.Trimesh, ...]:
        """Return the hulls with a margin on all sides, mm, up to 0.5 % too much."""
        return tuple(_grown(hull, margin_mm) for hull in self.hulls) if margin_mm else self.hulls

    def surface(self) -> trimesh.Trimesh:
        """Return all parts' surfaces as one mesh in the specimen's frame, mm, for pictures."""
        return joined([part.mesh for part in self.parts])

    @property
    def colour(self) -> Rgb:
        """Colour of the largest part in pictures of the room."""
        return self.largest_part.colour

    def truth(
        self, grid: VolumeGrid, energy_kev: float, world_from_specimen: Pose | None = None
    ) -> NDArray[np.float32]:
        """Return the mean attenuation in each voxel, over all parts.

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
            part.add_truth(grid, energy_kev, pose, volume)
        return volume


def build_specimen(section: sections.Specimen) -> BuiltSpecimen:
    """Build every part, then subtract from each the volume that later parts cover.

    Raises:
        InputError: with one sentence for each part that cannot be built; or a motion folds its
            part, has an unusable file, or moves what lies around a part that stands still.
    """
    problems: list[str] = []
    built: list[Part] = []
    for i, part in enumerate(section.parts):
        key = f"specimen.parts.{i}"
        try:
            substance = material(part.material, origin=f"{key}.material")
        except SpecimenError as error:
            problems.extend(error.problems)
            substance = None
        try:
            made = _made(part, substance, f"{key}.shape")
        except SpecimenError as error:
            problems.extend(error.problems)
            continue
        if made is not None and (why := _no_body(made.mesh)):
            problems.append(f"{key}.shape: part {quoted(part.label)} {why}")
        elif made is not None:
            built.append(made)
    if problems:
        raise SpecimenError(problems)
    specimen = BuiltSpecimen(_disjoint(built), section.world_from_specimen, section.reference)
    specimen.require_names()
    return specimen if section.motion is None else _in_motion(specimen, section)


def _in_motion(specimen: BuiltSpecimen, section: sections.Specimen) -> BuiltSpecimen:
    motion = body_motion(section)
    require_possible(motion, specimen.mixtures)
    for part in specimen.pure:
        motion.require_apart(part.name, part.mesh)
    return replace(specimen, motion=motion)


def _made(part: sections.Part, substance: Material | None, key: str) -> Part | None:
    """Return a part in the specimen's frame; None if its material is unknown."""
    pose = part.specimen_from_part
    known = substance or BUILT_IN["bone"]  # the file's own problems are reported, too
    if isinstance(part.shape, sections.GreyVolume):
        made: Part = grey_part(part.shape, part.label, known, pose, key)
    elif (own := own_part(part.shape, part.label, known, pose)) is not None:
        made = own
    else:
        mesh = shape_surface(part.shape, part.label)
        made = BuiltPart(part.label, known, surface(pose.apply(mesh.vertices), mesh.faces))
    return None if substance is None else made


def _no_body(mesh: trimesh.Trimesh) -> str:
    """Return the reason why no simulation can handle a part; empty if valid."""
    if not len(mesh.faces):
        return "has no surface"
    edges = np.ptp(mesh.bounds, axis=0)
    size = " x ".join(f"{edge:g}" for edge in edges)
    if not np.abs(mesh.bounds).max() <= FARTHEST_MM:
        return f"reaches beyond {FARTHEST_MM:g} mm: it measures {size} mm"
    if not edges.min() >= max(SMALLEST_MM, FLATTEST * edges.max()):
        return f"is too small or too flat: it measures {size} mm"
    return ""


def _hull(points: Floats) -> trimesh.Trimesh:
    import trimesh

    return trimesh.convex.convex_hull(points[_outermost(points)])


def _holds(hull: trimesh.Trimesh, other: trimesh.Trimesh) -> bool:
    """Return True if a convex body lies in another one."""
    return bool(beyond(hull, other.vertices).max() <= 0)


def _skin_in(mesh: trimesh.Trimesh, body: trimesh.Trimesh) -> Floats:
    """Return the corners of all triangles of which a corner lies in a convex body."""
    inside = beyond(body, mesh.vertices) <= ROUNDING_MM
    return np.asarray(mesh.vertices[np.unique(mesh.faces[inside[mesh.faces].any(axis=1)])])


def _grown(hull: trimesh.Trimesh, margin_mm: float) -> trimesh.Trimesh:
    """Return a convex body with a margin on all sides: its outermost points, moved outwards."""
    import trimesh

    directions = _sphere_directions(HULL_DIRECTIONS)
    outermost = hull.vertices[(directions @ hull.vertices.T).argmax(axis=1)]
    return trimesh.convex.convex_hull(outermost + GROWTH * margin_mm * directions)


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
    bodies = []
    for cap in np.unique(nearest):
        within, axis = directions[nearest == cap], axes[cap]
        heights = points @ axis
        slack = 2 * radius * np.linalg.norm(within - axis, axis=1).max()
        candidates = np.flatnonzero(heights >= heights.max() - slack)
        bodies.append(candidates[(within @ points[candidates].T).argmax(axis=1)])
    return np.unique(np.concatenate(bodies))


def _sphere_directions(count: int) -> Floats:
    """Return evenly spread unit vectors (count, 3) (a Fibonacci spiral), and the six axes."""
    step = np.arange(count) + 0.5
    z, turn = 1 - 2 * step / count, np.pi * (1 + np.sqrt(5)) * step
    ring = np.sqrt(1 - z * z)
    spiral = np.stack([ring * np.cos(turn), ring * np.sin(turn), z], axis=1)
    return np.concatenate([spiral, np.eye(3), -np.eye(3)])


def _disjoint(parts: list[Part]) -> tuple[Part, ...]:
    """Return parts without the volume of later ones; mixtures lose voxels, not their skin."""
    disjoint: list[Part] = []
    problems: list[str] = []
    solid = solids_once()
    for i, part in enumerate(parts):
        later = [other.mesh for other in parts[i + 1 :]]
        rest = part.without(later, solid)
        disjoint.append(rest)
        if rest is not part and rest.is_empty:
            problems.append(
                f"part {quoted(part.name)} is empty: later parts cover it completely. Where parts "
                "overlap, the later one wins; list the outer part first"
            )
    if problems:
        raise SpecimenError(problems)
    return tuple(disjoint)
