"""Scores of a simulation: means of a photon, with their standard errors from batches."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import InputError
from twinct.core.files.arrays import read_npz
from twinct.core.files.writing import complete, storage_errors
from twinct.transport._histories import COLLISIONS, DEPOSITED, EMITTED, ESCAPED

ORDERS = ("single Compton", "single Rayleigh", "multiple")
"""Scatter by its collisions: the first axis of the images."""

_MOST_BYTES = 64 * 2**30
_ARRAYS = ("voxels", "voxels_squared", "regions", "rows", "images", "images_squared", "totals")


@dataclass(eq=False)
class Scores:
    """Sums over batches of equal numbers of photons.

    Every number is that of one photon that the source emits into its field. The standard error of a
    mean over B batches is their standard deviation by sqrt(B), with a relative uncertainty of
    1 / sqrt(2 B - 2).

    Attributes:
        photons: photons of a batch.
        inputs: digest of all that the scores depend on, apart from the number of batches.
        region_names: names of the regions.
        voxels: sum of the energies deposited in each voxel, keV, (z, y, x); empty without dose.
        voxels_squared: sum of their squares.
        regions: energy deposited in each region by batch, keV, (batches, regions).
        rows: energy deposited in each row of the palette by batch, keV, (batches, rows).
        images: sum of the signals by order, (3, rows, columns); empty without a panel.
        images_squared: sum of their squares.
        totals: energies emitted, deposited and escaped in keV, and collisions, (batches, 4).
    """

    photons: int
    inputs: str
    region_names: tuple[str, ...]
    voxels: NDArray[np.float64]
    voxels_squared: NDArray[np.float64]
    images: NDArray[np.float64]
    images_squared: NDArray[np.float64]
    regions: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 0)))
    rows: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 0)))
    totals: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 4)))

    @property
    def batches(self) -> int:
        """Number of batches."""
        return len(self.totals)

    def add(
        self,
        regions: NDArray[np.float64],
        rows: NDArray[np.float64],
        voxels: NDArray[np.float64],
        images: NDArray[np.float64],
        totals: NDArray[np.float64],
    ) -> None:
        """Add a batch; its voxels and images are squared in place."""
        self.regions = np.concatenate([self.regions, regions[None]])
        self.rows = np.concatenate([self.rows, rows[None]])
        for total, squared, batch in (
            (self.voxels, self.voxels_squared, voxels),
            (self.images, self.images_squared, images),
        ):
            total += batch
            squared += np.multiply(batch, batch, out=batch)
        self.totals = np.concatenate([self.totals, totals[None]])

    def voxel_energy(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the energy deposited in each voxel, and its standard error, keV per photon."""
        return self._mean(self.voxels, self.voxels_squared)

    def scatter(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the images of scatter by order, and their standard errors, per photon."""
        return self._mean(self.images, self.images_squared)

    def region_energy(self) -> dict[str, tuple[float, float]]:
        """Return energy and standard error of each region, keV per photon."""
        mean, error = self._of_batches(self.regions)
        pairs = zip(mean.tolist(), error.tolist(), strict=True)
        return dict(zip(self.region_names, pairs, strict=True))

    def label_energy(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return energy and standard error of each label or row of the palette, keV per photon."""
        return self._of_batches(self.rows)

    def _of_batches(
        self, sums: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return means and standard errors of sums by batch."""
        mean = sums.mean(axis=0)
        deviation = sums.std(axis=0, ddof=1) if self.batches > 1 else np.full_like(mean, np.nan)
        return mean / self.photons, deviation / np.sqrt(self.batches) / self.photons

    @property
    def imbalance(self) -> float:
        """Largest relative difference of a batch between energy emitted, and that accounted for."""
        emitted, accounted = self.totals[:, EMITTED], self.totals[:, [DEPOSITED, ESCAPED]]
        return float(np.abs(accounted.sum(axis=1) / emitted - 1).max())

    @property
    def absorbed_kev(self) -> float:
        """Energy that stays in the body, keV per photon."""
        return float(self.totals[:, DEPOSITED].mean()) / self.photons

    @property
    def collisions(self) -> float:
        """Collisions of a photon."""
        return float(self.totals[:, COLLISIONS].mean()) / self.photons

    def _mean(
        self, total: NDArray[np.float64], squared: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        batches = self.batches
        mean = total / batches
        if batches < 2:
            return mean / self.photons, np.full_like(mean, np.nan)
        variance = np.maximum(squared / batches - mean**2, 0) / (batches - 1)
        return mean / self.photons, np.sqrt(variance) / self.photons

    def save(self, path: Path) -> None:
        """Write a file that ``read`` continues from; it appears only when it is complete."""
        text = np.array([self.inputs, *self.region_names])
        arrays = {name: getattr(self, name) for name in _ARRAYS}
        with storage_errors(path), complete(path) as draft, draft.open("wb") as stream:
            np.savez(stream, photons=np.int64(self.photons), text=text, **arrays)

    @classmethod
    def read(cls, path: Path, inputs: str) -> Scores:
        """Read the scores of earlier batches.

        Raises:
            InputError: the file cannot be read, or belongs to other inputs.
        """
        where = f"scores {path}"
        arrays = read_npz(path, where, _MOST_BYTES)
        if missing := {"photons", "text", *_ARRAYS} - set(arrays):
            raise InputError(f"{where}: it lacks {min(missing)}; these are no scores")
        stored, *names = arrays["text"].tolist()
        if stored != inputs:
            raise InputError(
                f"{where}: they belong to another body, beam, panel, seed or number of photons of "
                "a batch; take another file, or remove this one"
            )
        kept = {name: arrays[name] for name in _ARRAYS}
        return cls(int(arrays["photons"]), stored, tuple(names), **kept)
