"""Beam hardening: conversion of polychromatic line integrals to one energy."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy
from numpy.typing import NDArray

from twinct.specimen.materials import Material
from twinct.xray.response import PhotonResponse
from twinct.xray.spectrum import PhotonSpectrum, attenuation

_LARGEST_INTEGRAL = 17.0
"""Upper limit of line integrals: no detector can distinguish larger ones."""
_BRIGHT = 0.1
"""Extent of the table below 0, for noise, as a share of its range."""
_NODES = (129, 2049)
"""Number of nodes along the dense material, and along the line integral."""


class Hardening:
    """Inverse of the polychromatic model of known spectrum and materials.

    With one material, the line integral p(L) = -ln(signal(L) / signal(0)) is inverted, and mu(E) L
    is returned (linearisation, Herman, Phys. Med. Biol. 24 (1979) 81). With two, the path length in
    the dense material is known, p(L, L_dense) is inverted for the base material, and mu(E) L of
    both materials is added. This is the correction of Joseph and Spital (J. Comput. Assist. Tomogr.
    2 (1978) 100) with the model itself in place of their polynomial; the dense path length comes
    from a segmented first volume.
    """

    def __init__(
        self,
        spectrum: PhotonSpectrum,
        response: PhotonResponse,
        materials: Sequence[Material],
        energy_kev: float,
        longest_dense_mm: float = 0.0,
    ) -> None:
        """Tabulate the inverse.

        Args:
            spectrum: spectrum of the free beam.
            response: response of the detector.
            materials: the base material, and optionally the dense one.
            energy_kev: target energy of the line integrals.
            longest_dense_mm: longest path length in the dense material.
        """
        energies = spectrum.energies_kev
        weight = spectrum.photons * response.mean(energies)
        mus = [attenuation(material, energies) for material in materials]
        self._mu = [material.mu_per_mm(energy_kev) for material in materials]
        nodes = _NODES[0] if len(materials) == 2 else 1
        self._dense = np.linspace(0.0, max(longest_dense_mm, 1e-6), nodes)
        top = _LARGEST_INTEGRAL / max(float(mus[0].min()), 1e-9)
        base = top * np.linspace(0, 1, 8 * _NODES[1]) ** 2  # dense for short paths
        self._integrals = np.linspace(-_BRIGHT * _LARGEST_INTEGRAL, _LARGEST_INTEGRAL, _NODES[1])
        self._table = np.empty((nodes, _NODES[1]))
        for i, dense in enumerate(self._dense):
            behind = dense * mus[1] if len(materials) == 2 else 0.0
            passed = np.exp(-np.multiply.outer(base, mus[0]) - behind)
            p = -np.log(passed @ weight / weight.sum())
            slope = passed[0] @ (weight * mus[0]) / (passed[0] @ weight)
            # Below the value of the dense material alone, noise continues along the tangent.
            tangent = (self._integrals - p[0]) / slope
            inverse = np.interp(self._integrals, p, base)
            self._table[i] = np.where(self._integrals < p[0], tangent, inverse)

    def correct(
        self, integrals: NDArray[np.float32], dense_mm: NDArray[np.float32] | None = None
    ) -> NDArray[np.float32]:
        """Return polychromatic line integrals converted to the target energy; keep their shape.

        ``dense_mm`` is the path length of each in the dense material, if there is one.
        """
        at = (integrals - self._integrals[0]) / (self._integrals[1] - self._integrals[0])
        if dense_mm is None:
            base = np.interp(at, np.arange(_NODES[1]), self._table[0])
            return (self._mu[0] * base).astype(np.float32)
        dense = np.clip(dense_mm, 0.0, self._dense[-1])
        which = dense / self._dense[-1] * (_NODES[0] - 1)
        base = scipy.ndimage.map_coordinates(self._table, [which, at], order=1, mode="nearest")
        return (self._mu[0] * base + self._mu[1] * dense).astype(np.float32)
