"""Grey parts: bodies of voxels that are mixtures, with their skin and their named labels."""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np
import scipy
from numpy.typing import NDArray

from twinct.geometry import Floats, Panel, Pose, ScanGeometry, VolumeGrid
from twinct.geometry.arrays import lock
from twinct.specimen.aligned_means import add_aligned_means
from twinct.specimen.colours import SKIN, Rgb
from twinct.specimen.cut_rays import CutFace, cut_share
from twinct.specimen.grey import GreyField
from twinct.specimen.materials import Material
from twinct.specimen.part import Part, centres_of
from twinct.specimen.surface import ToSolid, boxes_meet, to_manifold
from twinct.specimen.voxels import volume_fractions

if TYPE_CHECKING:
    import trimesh

    from twinct.specimen.grey_caster import GreyCaster

FEW_SAMPLES = 4
"""Samples along an edge of a voxel of the field or of another grid, whichever is larger."""

SAMPLES_PER_VOXEL = 2
"""Samples along each edge of the field's voxels in a voxel that spans several of them."""


@dataclass(frozen=True, eq=False)
class VoxelLabels:
    """Named labels of the voxels of a grey part.

    Attributes:
        names: names of the labels; label i has the value i + 1.
        values: label of each voxel, (nz, ny, nx), uint16; 0 is none.
    """

    names: tuple[str, ...]
    values: NDArray[np.uint16]

    def __post_init__(self) -> None:
        """Lock the values."""
        lock(self, "values")

    def mask(self, name: str) -> NDArray[np.bool_]:
        """Return the voxels of a label, (nz, ny, nx)."""
        return self.values == self.names.index(name) + 1


@dataclass(frozen=True, eq=False)
class GreyPart(Part):
    """One body of voxels, each a mixture of a few basis materials.

    Attributes:
        name: name for messages.
        material: reference material of its figures, such as bone.
        mesh: skin, a closed surface in the specimen's frame, mm, for pictures, sizes and
            collisions. It takes no part in images and truth.
        field: mixtures, without the volume that later parts displace; nothing in the outermost
            layer of voxels.
        labels: named labels on the field's grid, if any.
        cuts: faces of the CT that cut the body.
    """

    name: str
    material: Material
    mesh: trimesh.Trimesh
    field: GreyField
    labels: VoxelLabels | None = None
    cuts: tuple[CutFace, ...] = ()
    homogeneous: ClassVar[bool] = False

    def __post_init__(self) -> None:
        """Check that the labels fit the field.

        Raises:
            ValueError: labels have another shape.
        """
        if self.labels and self.labels.values.shape != self.field.grid.shape:
            raise ValueError(
                f"the labels have the shape {self.labels.values.shape}, the field "
                f"{self.field.grid.shape}"
            )

    @property
    def materials(self) -> tuple[Material, ...]:
        """The basis materials."""
        return self.field.materials

    @property
    def is_empty(self) -> bool:
        """True if no voxel attenuates."""
        return not self.field.amounts.any()

    @property
    def colour(self) -> Rgb:
        """Colour of skin."""
        return SKIN

    @property
    def bulk(self) -> Material:
        """Basis material with the largest mass."""
        layers = (layer.sum(axis=(0, 1), dtype=np.float64) for layer in self.field.amounts)
        mass = sum(layers) * [m.density_g_cm3 for m in self.field.materials]
        return self.field.materials[int(np.argmax(mass))]

    @property
    def in_words(self) -> str:
        """Names of the basis materials."""
        *names, last = (m.name for m in self.field.materials)
        return f"voxels of {', '.join(names)} and {last}" if names else f"voxels of {last}"

    @property
    def label_names(self) -> tuple[str, ...]:
        """Names of the labels."""
        return self.labels.names if self.labels else ()

    def mixture(self, label: str = "") -> Material:
        """Return the mean mixture in the voxels of a label, or in all that are not empty."""
        if label in self._mixtures:
            return self._mixtures[label]
        amounts, count = self.field.amounts, 0
        total = np.zeros(amounts.shape[-1])
        number = self.label_names.index(label) + 1 if label else 0
        for k, layer in enumerate(amounts):  # copies of all voxels at once would not fit
            there = self.labels.values[k] == number if self.labels and label else layer.any(axis=-1)
            total += layer[there].sum(axis=0, dtype=np.float64)
            count += int(np.count_nonzero(there))
        mean = total / count
        masses = [
            (a * m.density_g_cm3, m) for a, m in zip(mean, self.field.materials, strict=True) if a
        ]
        density = sum(mass for mass, _ in masses)
        shares: dict[str, float] = {}
        for mass, substance in masses:
            for symbol, share in substance.mass_fractions.items():
                shares[symbol] = shares.get(symbol, 0.0) + mass / density * share
        self._mixtures[label] = Material(label or self.name, float(density), shares)
        return self._mixtures[label]

    @cached_property
    def _mixtures(self) -> dict[str, Material]:
        """Mixtures that are known, by label."""
        return {}

    def points(self, label: str, most: int, rng: np.random.Generator) -> Floats:
        """Return centres of voxels of a label, or points within the skin; see ``Part``."""
        if not label:
            return super().points(label, most, rng)
        assert self.labels is not None
        index = np.argwhere(self.labels.mask(label))[:, ::-1]
        return centres_of(self.field.grid, index, most, rng)

    def caster(self, panel: Panel) -> GreyCaster:
        """Return rays through the voxels."""
        from twinct.specimen.grey_caster import GreyCaster

        return GreyCaster(self.field, panel)

    def cut_share(self, views: ScanGeometry) -> Floats:
        """See ``Part``; of the rays through the box of the voxels."""
        return cut_share(self.cuts, self.field.grid, views)

    def spill(self, folder: Path) -> None:
        """Move the amounts to a file; see ``GreyField.spill``."""
        self.field.spill(folder)

    def without(self, meshes: Sequence[trimesh.Trimesh], solid: ToSolid = to_manifold) -> GreyPart:
        """Return the part without the volume inside closed meshes; it keeps its skin."""
        grid, lost = self.field.grid, None
        for mesh in meshes:
            if not boxes_meet(mesh, self.mesh):
                continue
            lost = volume_fractions(mesh.vertices, mesh.faces, grid, Pose.identity(), out=lost)
        if lost is None:
            return self
        left = np.maximum(1 - lost, 0)
        amounts = self.field.amounts * left[..., None]
        labels = self.labels
        if labels:
            values = np.where(left > 0.5, labels.values, np.uint16(0))
            labels = replace(labels, values=values)
        return replace(self, field=replace(self.field, amounts=amounts), labels=labels)

    def add_truth(
        self,
        grid: VolumeGrid,
        energy_kev: float,
        world_from_specimen: Pose,
        out: NDArray[np.float32],
    ) -> None:
        """Add the mean attenuation in each voxel of a grid, 1/mm, to ``out`` (nz, ny, nx)."""
        weights = [m.mu_per_mm(energy_kev) for m in self.field.materials]
        self._add_weighted(np.array(weights), grid, world_from_specimen, out)

    def shares(
        self, grid: VolumeGrid, world_from_specimen: Pose
    ) -> list[tuple[Material, NDArray[np.float32]]]:
        """Return the mean amount of each basis material in the voxels of a grid."""
        by_material = []
        for substance, weights in zip(
            self.field.materials, np.eye(len(self.field.materials)), strict=True
        ):
            share = np.zeros(grid.shape, dtype=np.float32)
            self._add_weighted(weights, grid, world_from_specimen, share)
            by_material.append((substance, share))
        return by_material

    def _add_weighted(
        self, weights: Floats, grid: VolumeGrid, pose: Pose, out: NDArray[np.float32]
    ) -> None:
        """Add the mean of the weighted sum of amounts in each voxel of a grid to ``out``."""
        field = self.field
        if field.sharp:
            _add_sharp_means(field, weights, grid, pose, out)
        else:
            add_means(field.amounts @ weights.astype(np.float32), field.grid, grid, pose, out)

    def label_on(self, name: str, grid: VolumeGrid, world_from_specimen: Pose) -> NDArray[np.bool_]:
        """Return the voxels of a grid that a label fills by half at least."""
        assert self.labels is not None
        share = np.zeros(grid.shape, dtype=np.float32)
        mask = self.labels.mask(name)
        for z, y, x in scipy.ndimage.find_objects(mask.view(np.uint8)):
            values, of = mask[z, y, x].astype(np.float32), self.field.grid.part((z, y, x))
            add_means(values, of, grid, world_from_specimen, share)
        return share >= 0.5

    def update(self, digest: hashlib._Hash) -> None:
        """Feed everything that images and truth depend on to a digest."""
        grid, field = self.field.grid, self.field
        pose = [*grid.world_from_grid.position.tolist(), *grid.world_from_grid.quat.tolist()]
        facts = [grid.shape, grid.voxel.tolist(), pose, self.label_names]
        facts += [
            [m.name, m.density_g_cm3, sorted(m.mass_fractions.items())] for m in field.materials
        ]
        digest.update(repr([*facts, "sharp"] if field.sharp else facts).encode())
        digest.update(field.amounts.data)
        if self.labels:
            digest.update(np.ascontiguousarray(self.labels.values).data)


def add_means(
    values: NDArray[np.float32],
    of: VolumeGrid,
    grid: VolumeGrid,
    world_from_field: Pose,
    out: NDArray[np.float32],
) -> None:
    """Add the mean of a linear field in each voxel of a grid to ``out``.

    It is the mean of samples, whose number ``FEW_SAMPLES`` and ``SAMPLES_PER_VOXEL`` define.

    Args:
        values: field at the voxel centres of its grid, (nz, ny, nx).
        of: grid of the field; its world is the specimen's frame.
        grid: grid of the means; it may be shifted and rotated.
        world_from_field: pose of the specimen.
        out: (nz, ny, nx) float32.
    """
    first, steps, counts, box = _sampling(of, grid, world_from_field)
    if not out[box].size:
        return
    if add_aligned_means(values, first, steps, counts.tolist(), out[box]):
        return
    means = np.zeros(out[box].shape, dtype=np.float32)
    from twinct.specimen import _grey_kernels

    values = np.require(values, requirements=["C", "W"])  # one type for numba
    _grey_kernels.add_means(values, first, steps, counts, means)
    out[box] += means


def _add_sharp_means(
    field: GreyField,
    weights: Floats,
    grid: VolumeGrid,
    world_from_field: Pose,
    out: NDArray[np.float32],
) -> None:
    """Add the mean weight of the materials of a sharp field in each voxel of a grid to ``out``."""
    from twinct.specimen import _grey_kernels

    first, steps, counts, box = _sampling(field.grid, grid, world_from_field)
    means, all_weights = np.zeros(out[box].shape, dtype=np.float32), np.append(weights, 0.0)
    _grey_kernels.add_sharp_means(field.amounts, all_weights, first, steps, counts, means)
    out[box] += means


def _sampling(
    of: VolumeGrid, grid: VolumeGrid, world_from_field: Pose
) -> tuple[Floats, Floats, NDArray[np.int64], tuple[slice, slice, slice]]:
    """Return a voxel's lowest corner, steps and samples in a field, and the voxels that it fills.

    Steps are in index coordinates of the field; their rows are those along x, y and z of the grid.
    The corner is that of the first voxel of the box outside of which the field is 0.
    """
    field_from_grid = (world_from_field @ of.world_from_grid).inverse() @ grid.world_from_grid
    steps = (field_from_grid.rotation * grid.voxel).T / of.voxel
    corner = grid.first_voxel_mm - grid.voxel / 2
    first = (field_from_grid.apply(corner) - of.first_voxel_mm) / of.voxel
    spanned = np.abs(steps).max(axis=1)
    counts = np.maximum(FEW_SAMPLES * np.minimum(spanned, 1), SAMPLES_PER_VOXEL * spanned)
    counts = np.ceil(counts - 1e-9).astype(np.int64)
    box = _touched(of.shape, first, steps, grid.shape)
    return first + np.array([side.start for side in box[::-1]]) @ steps, steps, counts, box


def _touched(
    of: tuple[int, ...], first: NDArray[np.float64], steps: NDArray[np.float64], shape: tuple
) -> tuple[slice, slice, slice]:
    """Return the box of the grid outside of which the field is 0."""
    ends = itertools.product(*((-1.0, float(n)) for n in of[::-1]))
    corners = (np.array(list(ends)) - first) @ np.linalg.inv(steps)
    low = np.clip(np.floor(corners.min(axis=0)), 0, shape[::-1]).astype(int)
    high = np.clip(np.ceil(corners.max(axis=0)), 0, shape[::-1]).astype(int)
    x, y, z = (slice(int(a), int(b)) for a, b in zip(low, high, strict=True))
    return z, y, x
