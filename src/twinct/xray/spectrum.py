"""Photon spectrum of a source."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from twinct.core.errors import InputError
from twinct.core.files.tables import read_columns
from twinct.geometry import Floats
from twinct.specimen.materials import Material

XRAYLIB_KEV = (0.1, 800.0)
"""Range of xraylib's attenuation data."""


@dataclass(frozen=True, eq=False)
class PhotonSpectrum:
    """Photons of a free beam by energy.

    Attributes:
        energies_kev: centre of each bin, rising, keV, (bins,).
        photons: photons in each bin, per mm^2 at 1 m from the focal spot and per mAs, (bins,). Only
            their ratios are meaningful if ``absolute`` is false.
        absolute: True if the photon number is known.
    """

    energies_kev: Floats
    photons: Floats
    absolute: bool = True

    def __init__(self, energies_kev: ArrayLike, photons: ArrayLike, absolute: bool = True) -> None:
        """Remove empty bins at both ends.

        Raises:
            InputError: energies do not rise or are not positive, or photons are negative or all
                zero.
        """
        energies = np.array(energies_kev, dtype=np.float64, ndmin=1)
        counts = np.array(photons, dtype=np.float64, ndmin=1)
        problems = []
        if energies.shape != counts.shape or energies.ndim != 1:
            problems.append(f"{energies.shape} energies but {counts.shape} photon numbers")
        elif not (np.isfinite(energies).all() and np.isfinite(counts).all()):
            problems.append("a spectrum must consist of finite numbers")
        elif (np.diff(energies) <= 0).any():
            problems.append("the energies of a spectrum must rise")
        elif (counts < 0).any():
            problems.append(f"a bin has {counts.min():g} photons; the number must not be negative")
        elif not counts.any():
            problems.append("a spectrum needs photons, but all bins are empty")
        else:
            used = np.flatnonzero(counts)
            energies, counts = (a[used[0] : used[-1] + 1] for a in (energies, counts))
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
    def monochromatic(cls, energy_kev: float, photons: float | None = None) -> PhotonSpectrum:
        """Return a spectrum of one energy, with photons per mm^2 at 1 m and mAs if known."""
        return cls([energy_kev], [1.0 if photons is None else photons], photons is not None)

    @classmethod
    def read(cls, path: Path, absolute: bool = False) -> PhotonSpectrum:
        """Read two columns of text: energy in keV, photons of that bin; ``#`` starts a comment.

        Raises:
            InputError: the file cannot be read or holds no spectrum; names the file.
        """
        energies, photons = read_columns(path, 2)
        try:
            spectrum = cls(energies, photons, absolute)
            low, high = XRAYLIB_KEV
            ends = spectrum.energies_kev[[0, -1]]
            if ends[0] < low or ends[1] > high:
                raise InputError(
                    f"photons of {ends[0]:g} to {ends[1]:g} keV: attenuation data cover only "
                    f"{low:g} to {high:g} keV"
                )
            return spectrum
        except InputError as error:
            raise InputError([f"{path}: {problem}" for problem in error.problems]) from None

    @property
    def total(self) -> float:
        """Sum of the photons of all bins."""
        return float(self.photons.sum())

    def filtered(self, material: Material, thickness_mm: float) -> PhotonSpectrum:
        """Return the spectrum behind a plate that is crossed at right angles."""
        passed = np.exp(-attenuation(material, self.energies_kev) * thickness_mm)
        return PhotonSpectrum(self.energies_kev, self.photons * passed, self.absolute)

    def scaled(self, total: float) -> PhotonSpectrum:
        """Return a spectrum of equal shape with a known photon number per mm^2 at 1 m and mAs."""
        return PhotonSpectrum(self.energies_kev, self.photons * (total / self.total), True)

    def rebinned(self, bins: int) -> PhotonSpectrum:
        """Return at most ``bins`` bins of equal width, preserving photon number and mean energy.

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
        return PhotonSpectrum(sums[some] / counts[some], counts[some], self.absolute)


def attenuation(material: Material, energies_kev: Floats) -> Floats:
    """Return the linear attenuation coefficient at each energy, 1/mm."""
    return np.array([material.mu_per_mm(float(energy)) for energy in energies_kev])
