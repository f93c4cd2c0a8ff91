"""A part of a specimen: whatever can be cast, with a truth and a hull."""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from twinct.geometry import Floats, Panel, Pose, ScanGeometry, VolumeGrid
from twinct.specimen.colours import Rgb, colour_of
from twinct.specimen.cut_rays import CutFace
from twinct.specimen.materials import Material
from twinct.specimen.surface import ToSolid, enclosed_volume, to_manifold
from twinct.specimen.voxels import volume_fractions

if TYPE_CHECKING:
    import trimesh


class Caster(Protocol):
    """Rays of a panel through one part, each from the source to the centre of its pixel."""

    def add(self, view: ScanGeometry, into: Sequence[int], out: NDArray[np.float32]) -> None:
        """Add the line integral of each of the part's materials along each ray.

        Args:
            view: exactly one view, in the frame of the part's mesh; its pixels are the panel's.
            into: image of each material.
            out: receives the integrals, (images, rows, columns), mm: lengths in a pure material,
                else lengths times amounts.
        """
        ...


class Part(ABC):
    """One body of a specimen.

    A subclass says how rays cross it, how much of it is in a voxel, and what later parts leave of
    it. All that engines, truth and figures ask of a part has its answer here.

    Attributes:
        name: name for messages.
        material: its material, or the reference of its figures if it is a mixture.
        mesh: closed surface in the specimen's frame, mm, counter-clockwise seen from outside, for
            pictures, sizes and collisions.
        cuts: faces of a CT that cut the body.
        homogeneous: True if all within the mesh is ``material``.
        own_rays: True if an image takes the part from its caster; False if X-ray engines render its
            mesh, which is exactly the body.
    """

    name: str
    material: Material
    mesh: trimesh.Trimesh
    cuts: tuple[CutFace, ...] = ()
    homogeneous: ClassVar[bool] = True
    own_rays: ClassVar[bool] = True

    @abstractmethod
    def caster(self, panel: Panel) -> Caster:
        """Return the rays of a panel through this part."""

    @abstractmethod
    def shares(
        self, grid: VolumeGrid, world_from_specimen: Pose
    ) -> list[tuple[Material, NDArray[np.float32]]]:
        """Return the mean amount of each material in the voxels of a grid, (nz, ny, nx)."""

    @abstractmethod
    def without(self, meshes: Sequence[trimesh.Trimesh], solid: ToSolid = to_manifold) -> Part:
        """Return the part without the volume inside closed meshes.

        Args:
            meshes: surfaces of later parts, in the specimen's frame.
            solid: conversion of a mesh to a solid; see ``solids_once``.

        Raises:
            SpecimenError: they cannot be cut out of this part.
        """

    @abstractmethod
    def update(self, digest: hashlib._Hash) -> None:
        """Feed everything that images and truth depend on to a digest, materials apart."""

    def add_truth(
        self,
        grid: VolumeGrid,
        energy_kev: float,
        world_from_specimen: Pose,
        out: NDArray[np.float32],
    ) -> None:
        """Add the mean attenuation in each voxel of a grid, 1/mm, to ``out`` (nz, ny, nx)."""
        for substance, share in self.shares(grid, world_from_specimen):
            out += np.float32(substance.mu_per_mm(energy_kev)) * share

    @property
    def materials(self) -> tuple[Material, ...]:
        """Materials that attenuate; a caster has an image for each."""
        return (self.material,)

    @property
    def is_empty(self) -> bool:
        """True if nothing of the part is left."""
        return not len(self.mesh.faces)

    @property
    def volume_mm3(self) -> float:
        """Volume within the mesh, mm^3."""
        return enclosed_volume(self.mesh)

    @property
    def bulk(self) -> Material:
        """Material with the largest mass."""
        return self.material

    @property
    def in_words(self) -> str:
        """Name of the material."""
        return self.material.name

    @property
    def colour(self) -> Rgb:
        """Colour in pictures of the room."""
        return colour_of(self.material)

    @property
    def label_names(self) -> tuple[str, ...]:
        """Names of labels within the part."""
        return ()

    def label_of(self, name: str) -> str:
        """Return the label that a name means; empty if it names the part."""
        return "" if name == self.name else name

    def label_on(self, name: str, grid: VolumeGrid, world_from_specimen: Pose) -> NDArray[np.bool_]:
        """Return the voxels of a grid that a label fills by half at least."""
        raise KeyError(f"part {self.name!r} has no label {name!r}")

    def mixture(self, label: str = "") -> Material:
        """Return the mean material of a label, or of the part."""
        return self.material

    def mean_mu(self, energy_kev: float, label: str = "") -> float:
        """Return the mean attenuation of a label, or of the part, at a photon energy, 1/mm."""
        return self.mixture(label).mu_per_mm(energy_kev)

    def points(self, label: str, most: int, rng: np.random.Generator) -> Floats:
        """Return points in a label, or in the part, in the specimen's frame, (points, 3), mm."""
        mesh = self.mesh
        low, high = np.asarray(mesh.bounds)
        step = float(np.cbrt(mesh.volume / most))
        count = np.maximum(np.ceil((high - low) / step).astype(int), 2)[::-1]
        middle = Pose.from_euler((low + high) / 2, (0.0, 0.0, 0.0))
        grid = VolumeGrid(count.tolist(), (high - low) / count[::-1], middle)
        inside = volume_fractions(mesh.vertices, mesh.faces, grid, Pose.identity()) > 0.5
        index = np.argwhere(inside)[:, ::-1]
        if not len(index):  # a thin plate fills no cell by half
            index = np.array([[n // 2 for n in grid.shape_xyz]])
        return centres_of(grid, index, most, rng)

    def cut_share(self, views: ScanGeometry) -> Floats:
        """Return the share of each view's rays that cross a cut face, (views,); see ``cuts``.

        The views are in the specimen's frame.
        """
        return np.zeros(len(views))

    def spill(self, folder: Path) -> None:
        """Move large arrays from memory to a file without a name in a folder."""
        return  # most parts have none


def add_mesh(digest: hashlib._Hash, mesh: trimesh.Trimesh) -> None:
    """Feed a surface to a digest."""
    for array in (mesh.vertices, mesh.faces):
        digest.update(repr((array.shape, array.dtype.str)).encode())
        digest.update(np.ascontiguousarray(array).data)


def centres_of(
    grid: VolumeGrid, index: NDArray[np.intp], most: int, rng: np.random.Generator
) -> Floats:
    """Return the centres of voxels (x, y, z), at most so many, in the grid's world, mm."""
    if len(index) > most:
        index = rng.permutation(index)[:most]
    return grid.world_from_grid.apply(index * grid.voxel + grid.first_voxel_mm)


def rendered(parts: Iterable[Part]) -> list[Part]:
    """Return the parts whose meshes X-ray engines render."""
    return [part for part in parts if not part.own_rays]
