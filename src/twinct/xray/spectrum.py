"""A spectrum: how many photons of each energy leave the source."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from twinct.errors import InputError
from twinct.geometry import Floats

if TYPE_CHECKING:
    from twinct.specimen.materials import Material


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Photons of a free beam by energy.

    Attributes:
        energies_kev: centre of each bin, rising, keV, (bins,).
        photons: photons in each bin, per mm^2 at 1 m from the focal spot and per mAs, (bins,).
            Only their ratios are meaningful where ``absolute`` is false.
        absolute: whether the photon number is known.
    """

    energies_kev: Floats
    photons: Floats
    absolute: bool = True

    def __init__(self, energies_kev: ArrayLike, photons: ArrayLike, absolute: bool = True) -> None:
        """Leave out empty bins at both ends.

        Raises:
            InputError: energies that do not rise or are not positive, negative or no photons.
        """
        energies = np.array(energies_kev, dtype=np.float64, ndmin=1)
        counts = np.array(photons, dtype=np.float64, ndmin=1)
        problems = []
        if energies.shape != counts.shape or energies.ndim != 1:
            problems.append(f"{energies.shape} energies and {counts.shape} photon numbers")
        elif not (np.isfinite(energies).all() and np.isfinite(counts).all()):
            problems.append("a spectrum must consist of finite numbers")
        elif (np.diff(energies) <= 0).any():
            problems.append("the energies of a spectrum must rise")
        elif (counts < 0).any() or not counts.any():
            problems.append("a spectrum needs photons, and no negative number of them")
        else:
            used = np.flatnonzero(counts)
            energies = energies[used[0] : used[-1] + 1]
            counts = counts[used[0] : used[-1] + 1]
            if energies[0] <= 0:
                problems.append(f"photons of {energies[0]:g} keV: energies must be positive")
        if problems:
            raise InputError(problems)
        for array in (energies, counts):
            array.setflags(write=False)
        object.__setattr__(self, "energies_kev", energies)
        object.__setattr__(self, "photons", counts)
        object.__setattr__(self, "absolute", absolute)

    @classmethod
    def monochromatic(cls, energy_kev: float, photons: float | None = None) -> Spectrum:
        """One energy; photons per mm^2 at 1 m and mAs, where they are known."""
        return cls([energy_kev], [1.0 if photons is None else photons], photons is not None)

    @classmethod
    def read(cls, path: Path, absolute: bool = False) -> Spectrum:
        """Two columns of text: energy in keV, photons of that bin; ``#`` starts a comment.

        Raises:
            InputError: the file cannot be read or is no spectrum; names it.
        """
        energies, photons = read_columns(path, 2)
        try:
            return cls(energies, photons, absolute)
        except InputError as error:
            raise InputError([f"{path}: {problem}" for problem in error.problems]) from None

    @property
    def total(self) -> float:
        """Sum of the photons of all bins."""
        return float(self.photons.sum())

    @property
    def mean_energy_kev(self) -> float:
        """Mean energy of a photon."""
        return float(self.photons @ self.energies_kev / self.total)

    def filtered(self, material: Material, thickness_mm: float) -> Spectrum:
        """The spectrum behind a plate that is crossed at right angles."""
        mu = attenuation(material, self.energies_kev)
        return Spectrum(self.energies_kev, self.photons * np.exp(-mu * thickness_mm), self.absolute)

    def scaled(self, total: float) -> Spectrum:
        """The same shape with a known number of photons per mm^2 at 1 m and mAs."""
        return Spectrum(self.energies_kev, self.photons * (total / self.total), True)

    def rebinned(self, bins: int) -> Spectrum:
        """At most ``bins`` bins of equal width; photon number and mean energy are kept.

        The energy of a new bin is the mean of its photons.
        """
        energies, photons = self.energies_kev, self.photons
        if len(energies) <= bins:
            return self
        edges = np.linspace(energies[0], energies[-1], bins + 1)
        place = np.clip(np.searchsorted(edges, energies, side="right") - 1, 0, bins - 1)
        counts = np.bincount(place, photons, bins)
        sums = np.bincount(place, photons * energies, bins)
        some = counts > 0
        return Spectrum(sums[some] / counts[some], counts[some], self.absolute)


def attenuation(material: Material, energies_kev: Floats) -> Floats:
    """Linear attenuation coefficient at each energy, 1/mm.

    Raises:
        SpecimenError: xraylib has no data at an energy.
    """
    return np.array([material.mu_per_mm(float(energy)) for energy in energies_kev])


def read_columns(path: Path, columns: int) -> Floats:
    """Columns of numbers from a text file, (columns, rows); more columns are left out.

    Blanks, commas or semicolons stand between them.

    Raises:
        InputError: it cannot be read; names the file.
    """
    try:
        lines = path.read_text(encoding="utf-8").replace(",", " ").replace(";", " ").splitlines()
        table = np.loadtxt(lines, comments="#", ndmin=2, usecols=range(columns))
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: not {columns} columns of numbers: {error}") from None
    if not len(table):
        raise InputError(f"{path}: the file is empty")
    return table.T
