"""Grey bodies: voxels that are mixtures of a few basis materials."""

from __future__ import annotations

import logging
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twinct.geometry import VolumeGrid
from twinct.geometry.arrays import Floats, lock
from twinct.specimen.materials import Material

log = logging.getLogger(__name__)

SPILLED_BYTES = 2**28
"""Smallest size of amounts that are worth a file."""


@dataclass(frozen=True, eq=False)
class GreyField:
    """Mixtures of basis materials on a voxel grid.

    An amount is the density of a basis material in a voxel, relative to the material's own density.
    So mu = sum_m amounts[..., m] mu_m(E), with the same amounts for all photon energies. Between
    the centres of voxels, amounts are linear; outside the grid there is nothing. Noise and streaks
    of a reconstruction are amounts below 0. In a sharp field, amounts are volume fractions, and
    each point is wholly of the material with the largest one there, or of nothing.

    Attributes:
        materials: basis materials.
        amounts: (nz, ny, nx, materials), float32, C-contiguous, finite.
        grid: grid of the voxels; its world is the specimen's frame.
        sharp: True for volume fractions with sharp edges.
    """

    materials: tuple[Material, ...]
    amounts: NDArray[np.float32]
    grid: VolumeGrid
    sharp: bool = False

    def __post_init__(self) -> None:
        """Check shape and values, and lock the amounts.

        Raises:
            ValueError: the amounts do not fit the grid and the materials, or are not finite.
        """
        expected = (*self.grid.shape, len(self.materials))
        if self.amounts.shape != expected or self.amounts.dtype != np.float32:
            raise ValueError(
                f"the amounts are {self.amounts.dtype} {self.amounts.shape}, expected float32 "
                f"{expected}"
            )
        low, high = self.amounts.min(), self.amounts.max()
        if not np.isfinite([low, high]).all():
            raise ValueError(f"the amounts lie between {low} and {high}; they must be finite")
        object.__setattr__(self, "amounts", np.ascontiguousarray(self.amounts))
        lock(self, "amounts")

    def spill(self, folder: Path) -> None:
        """Move large amounts from memory to a file without a name, read when they are needed.

        Args:
            folder: folder on the disk that takes them. If it has no room, they stay in memory.
        """
        if self.amounts.nbytes < SPILLED_BYTES or isinstance(self.amounts.base, np.memmap):
            return
        try:
            with tempfile.TemporaryFile(dir=folder) as file:
                self.amounts.tofile(file)
                file.flush()
                mapped = np.memmap(file, np.float32, "r", shape=self.amounts.shape)
        except OSError as error:
            log.info("%d voxels stay in memory: %s", self.amounts.size, error)
            return
        object.__setattr__(self, "amounts", np.asarray(mapped))

    def mu_per_mm(self, energy_kev: float) -> NDArray[np.float32]:
        """Return the attenuation of each voxel at a photon energy, (nz, ny, nx), 1/mm."""
        of_materials: Floats = np.array([m.mu_per_mm(energy_kev) for m in self.materials])
        return self.amounts @ of_materials.astype(np.float32)
