"""Polychromatic rays through metal and its surroundings, and their line integrals without metal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twinct.geometry import Floats
from twinct.specimen.materials import Material
from twinct.xray.response import PhotonResponse
from twinct.xray.spectrum import PhotonSpectrum, attenuation

_NEWTON_STEPS = 12
_ENOUGH_MM = 1e-4
"""Accuracy of the path length in the base material."""
_SHORTEST_MM = -50.0
"""Minimum path length in the base material, for noise or overcorrected metal."""


class MetalModel:
    """The polychromatic model of known spectrum and materials, with metal in the way.

    The measured line integral is -ln(signal(L, L_dense, M) / signal(0, 0, 0)) behind a path length
    L in the base material, L_dense in a dense one and M in each metal. With L_dense and M known, it
    is solved for L, as in ``Hardening`` without metal. The line integral without metal follows from
    L and L_dense.
    """

    def __init__(
        self,
        spectrum: PhotonSpectrum,
        response: PhotonResponse,
        materials: Sequence[Material],
        metals: Sequence[Material],
        energy_kev: float | None,
    ) -> None:
        """Compute the attenuations.

        Args:
            spectrum: spectrum of the free beam.
            response: response of the detector.
            materials: the base material, and optionally the dense one.
            metals: material of each implant.
            energy_kev: target energy of the line integrals; None: they stay polychromatic.
        """
        energies = spectrum.energies_kev
        weight = spectrum.photons * response.mean(energies)
        self._weight = weight / weight.sum()
        self._mus = np.array([attenuation(material, energies) for material in materials])
        self._metals = np.array([attenuation(metal, energies) for metal in metals])
        self._at = None
        if energy_kev is not None:
            self._at = np.array([material.mu_per_mm(energy_kev) for material in materials])

    def without(
        self, measured: Floats, dense_mm: Floats | None, metal_mm: Floats
    ) -> tuple[Floats, Floats]:
        """Return line integrals without the metals, and their derivatives by each metal path.

        Args:
            measured: -ln of the transmission, (rays,).
            dense_mm: path lengths in the dense material, (rays,), or None.
            metal_mm: path lengths in the metals, (metals, rays).

        Returns:
            (rays,), and (metals, rays), 1/mm.
        """
        base = self._mus[0]
        behind = metal_mm.T @ self._metals
        if dense_mm is not None:
            behind += np.multiply.outer(dense_mm, self._mus[1])
        path = np.maximum((measured - behind.mean(axis=1)) / base.mean(), 0.0)
        passed = np.empty_like(behind)
        total = np.ones_like(measured)
        for _ in range(_NEWTON_STEPS):
            # The common part of all energies is factored out, so that no sum underflows.
            depth = np.multiply.outer(path, base) + behind
            least = depth.min(axis=1)
            passed = np.exp(least[:, None] - depth) * self._weight
            total = passed.sum(axis=1)
            step = (measured - least + np.log(total)) * total / (passed @ base)
            path = np.maximum(path + step, _SHORTEST_MM)
            if np.abs(step).max(initial=0.0) < _ENOUGH_MM:
                break
        by_metal = -(self._metals @ passed.T) / (passed @ base)
        if self._at is not None:
            left = self._at[0] * path
            if dense_mm is not None:
                left = left + self._at[1] * dense_mm
            return left, self._at[0] * by_metal
        depth = np.multiply.outer(path, base)
        if dense_mm is not None:
            depth += np.multiply.outer(dense_mm, self._mus[1])
        alone = np.exp(-depth) * self._weight
        total = alone.sum(axis=1)
        return -np.log(total), (alone @ base) / total * by_metal


@dataclass(frozen=True, eq=False)
class Corrected:
    """Line integrals of a scan corrected for one background, with the model of its implants.

    Attributes:
        model: how all attenuate together.
        measured: -ln of the transmission, (views, rows, columns).
        line_integrals: corrected as if there were no metal, (views, rows, columns).
        dense_mm: paths in the dense material, (views, rows, columns), where there is one.
    """

    model: MetalModel
    measured: NDArray[np.float32]
    line_integrals: NDArray[np.float32]
    dense_mm: NDArray[np.float32] | None

    def without(self, view: int, rays: NDArray[np.intp], lengths: Floats) -> tuple[Floats, Floats]:
        """Return line integrals of rays without metal; see ``known_components.Behind``."""
        dense = self.dense_mm
        dense_mm = None if dense is None else dense[view].flat[rays].astype(np.float64)
        measured = self.measured[view].flat[rays].astype(np.float64)
        return self.model.without(measured, dense_mm, lengths)
