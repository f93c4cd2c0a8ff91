"""Parts of other packages that are cast as they are: voxels, and solids with rays of their own."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinct.core.errors import SpecimenError
from twinct.core.foreign_text import quoted
from twinct.geometry import Floats, Panel, Pose, ScanGeometry, VolumeGrid
from twinct.geometry.bodies import Solid, Voxels
from twinct.specimen.grey import GreyField
from twinct.specimen.grey_part import GreyPart
from twinct.specimen.materials import Material, material
from twinct.specimen.part import Part, add_mesh
from twinct.specimen.sections import Shape, part_kinds
from twinct.specimen.shapes import shape_surface
from twinct.specimen.surface import (
    ToSolid,
    boxes_meet,
    corners,
    enclosed_volume,
    isosurface,
    simplified,
    subtract,
    surface,
    to_manifold,
)

if TYPE_CHECKING:
    import trimesh

SKIN_TRIANGLES = 200_000
"""Maximum number of triangles around voxels."""

ROWS = 64
"""Rows of a panel whose rays a solid takes at a time, which bounds their memory."""

OVERLAP = 1e-9
"""Share of a solid's volume below which later parts only touch it."""


def own_part(shape: Shape, name: str, substance: Material, specimen_from_part: Pose) -> Part | None:
    """Return a part of another package in the specimen's frame; None if it is a plain surface.

    Raises:
        SpecimenError: the package returns no voxels or no solid; names the part.
    """
    kind = part_kinds().get(shape.kind)
    if kind is None or kind.surface is not None:
        return None
    where = f"part {quoted(name)} of kind {shape.kind}"
    if kind.voxels is not None:
        return _of_voxels(kind.voxels(shape), name, substance, specimen_from_part, where)
    assert kind.solid is not None
    solid: Solid = kind.solid(shape)
    mesh = shape_surface(shape, name)
    placed = surface(specimen_from_part.apply(mesh.vertices), mesh.faces)
    told = shape.model_dump_json()
    return SolidPart(name, substance, placed, solid, specimen_from_part, told, where)


def _of_voxels(
    voxels: Voxels, name: str, substance: Material, specimen_from_part: Pose, where: str
) -> GreyPart:
    given = voxels.amounts
    if isinstance(given, Mapping):
        named = {material(one, where): np.asarray(array) for one, array in given.items()}
    else:
        named = {substance: np.asarray(given)}
    shape = voxels.grid.shape
    if not named or any(array.shape != shape for array in named.values()):
        shapes = ", ".join(str(array.shape) for array in named.values()) or "no array"
        raise SpecimenError(f"{where}: its amounts are {shapes}; its grid has {shape} voxels")
    amounts = np.stack([*named.values()], axis=-1).astype(np.float32)
    if not np.isfinite(amounts).all() or not amounts.max() > 0:
        raise SpecimenError(f"{where}: its amounts must be finite, and some above 0")
    # The outermost layer of a grey part is empty.
    amounts = np.pad(amounts, ((1, 1), (1, 1), (1, 1), (0, 0)))
    grid = VolumeGrid(
        amounts.shape[:3], voxels.grid.voxel, specimen_from_part @ voxels.grid.world_from_grid
    )
    total = amounts.sum(axis=-1)
    skin = simplified(
        isosurface(total.transpose(2, 1, 0), float(total.max()) / 2, grid.affine), SKIN_TRIANGLES
    )
    if not skin.is_watertight:
        raise SpecimenError(f"{where}: the surface around its voxels does not close")
    field = GreyField(tuple(named), np.ascontiguousarray(amounts), grid, voxels.sharp)
    return GreyPart(name, substance, skin, field)


@dataclass(frozen=True, eq=False)
class SolidPart(Part):
    """A solid of another package, cast by its formulas.

    Attributes:
        solid: the formulas.
        specimen_from_part: pose of their frame.
        told: its kind and keys, as JSON.
        where: beginning of messages.
    """

    name: str
    material: Material
    mesh: trimesh.Trimesh
    solid: Solid
    specimen_from_part: Pose
    told: str
    where: str

    def caster(self, panel: Panel) -> SolidCaster:
        """Return rays by the solid's formulas."""
        return SolidCaster(self, panel)

    def shares(
        self, grid: VolumeGrid, world_from_specimen: Pose
    ) -> list[tuple[Material, NDArray[np.float32]]]:
        """Return the solid's fractions of the voxels of a grid."""
        share = np.zeros(grid.shape, dtype=np.float32)
        grid_from_world = grid.world_from_grid.inverse()
        ends = grid_from_world.apply(world_from_specimen.apply(corners(self.mesh)))
        index = (ends - grid.first_voxel_mm) / grid.voxel
        low = np.clip(np.floor(index.min(axis=0)), 0, grid.shape_xyz).astype(int)
        high = np.clip(np.ceil(index.max(axis=0)) + 1, 0, grid.shape_xyz).astype(int)
        if (low < high).all():
            x, y, z = (slice(int(a), int(b)) for a, b in zip(low, high, strict=True))
            part = grid.part((z, y, x))
            part_from_world = (world_from_specimen @ self.specimen_from_part).inverse()
            local = VolumeGrid(part.shape, part.voxel, part_from_world @ part.world_from_grid)
            share[z, y, x] = self._checked(self.solid.fractions(local), part.shape, "fractions")
        return [(self.material, share)]

    def without(self, meshes: Sequence[trimesh.Trimesh], solid: ToSolid = to_manifold) -> SolidPart:
        """Return the solid itself.

        Raises:
            SpecimenError: a mesh overlaps it.
        """
        near = [mesh for mesh in meshes if boxes_meet(mesh, self.mesh)]
        left = subtract(self.mesh, near, self.name, solid)
        if near and enclosed_volume(left) < (1 - OVERLAP) * self.volume_mm3:
            raise SpecimenError(
                f"{self.where} is cast by its own rays, out of which no later part can be cut: "
                "list it behind the parts that it overlaps"
            )
        return self

    def update(self, digest: hashlib._Hash) -> None:
        """Feed keys and surface to a digest."""
        digest.update(self.told.encode())
        add_mesh(digest, self.mesh)

    def path_lengths(self, source: Floats, ends: Floats) -> Floats:
        """Return the length of each way inside the solid, (rows, columns), mm.

        Args:
            source: (3,), in the specimen's frame, mm.
            ends: (rows, columns, 3), likewise.
        """
        part_from_specimen = self.specimen_from_part.inverse()
        lengths = self.solid.path_lengths(
            part_from_specimen.apply(source), part_from_specimen.apply(ends)
        )
        return self._checked(lengths, ends.shape[:-1], "path_lengths")

    def _checked(self, values: ArrayLike, shape: tuple[int, ...], method: str) -> Floats:
        array = np.asarray(values, dtype=np.float64)
        if array.shape != shape or not (np.isfinite(array) & (array >= 0)).all():
            raise SpecimenError(
                f"{self.where}: {method} returned {array.shape} numbers; they must be {shape}, "
                "finite and not negative"
            )
        return array


class SolidCaster:
    """Rays of a panel through a solid; see ``Caster``."""

    def __init__(self, part: SolidPart, panel: Panel) -> None:
        """Take the part."""
        self._part, self._panel = part, panel

    def add(self, view: ScanGeometry, into: Sequence[int], out: NDArray[np.float32]) -> None:
        """Add the length of each ray inside the solid."""
        panel, (u, v) = self._panel, (view.u[0], view.v[0])
        column, row = panel.first_pixel_mm
        across = (column + np.arange(panel.columns) * panel.pitch_u)[:, None] * u
        for start in range(0, panel.rows, ROWS):
            rows = np.arange(start, min(start + ROWS, panel.rows))
            down = (row + rows * panel.pitch_v)[:, None, None] * v
            ends = view.detector[0] + down + across
            lengths = self._part.path_lengths(view.source[0], ends)
            out[into[0], start : start + len(rows)] += lengths.astype(np.float32)
