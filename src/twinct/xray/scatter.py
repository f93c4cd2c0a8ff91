"""Scattered radiation: a forward-scatter kernel estimate.

Ohnesorge, Flohr and Klingenbeck-Regn (Eur. Radiol. 9 (1999) 563) take the scatter that leaves along
a ray as proportional to p exp(-p) and spread it over the panel by convolution. Here factor and
kernel are not fitted, but computed for single Compton scattering: of a ray's photons, mu_C L
exp(-mu L) are scattered once and attenuated like the primary ones. From the middle of the object,
they follow the Klein-Nishina cross section, and reach the panel at the distance r from their ray
with cos^3(theta) / d^2 per mm^2, tan(theta) = r / d.

The kernel neglects scatter of higher orders, coherent scatter (a narrow forward peak) and electron
binding, takes the object as thin along the beam, at its middle, and sees only rays that meet the
panel. So its range follows from the Compton optical depth of the body, from the photon energy, and
from the panel. We compared it with our own Monte Carlo calculation of all orders
(``benchmarks/bench_scatter.py``) behind balls of water from 40 to 120 keV:

- Up to a Compton optical depth mu_C L of 3.5, with the whole shadow on the panel, the ratio of
  scattered to primary energy at the middle is between 25 % too low and 22 % too high; at 60 keV and
  above between 6 and 25 % too low. At 80 keV it is 12 % too low at a radius of 25 mm, 20 % at
  50 mm, 23 % at 80 mm, and 23 % at 100 mm, where the depth is 3.4.
- Beyond, errors reach -28 % (120 keV) and +160 % (40 keV) at a radius of 150 mm.
- If the body is wider than the panel, scatter from the rays beside the panel is missing: behind a
  ball of 100 mm, of which the panel shows the middle 70 %, scatter is 55 % too low, or 39 % too low
  if a collimator holds the beam on the panel.

``twinct.xray.scatter_range`` warns of scans that leave this range. ``detector.scatter.scale``
compensates for a known error.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
import xraylib
from numpy.typing import NDArray

from twinct.geometry import Floats
from twinct.specimen.materials import MM_PER_CM, Material

ELECTRON_KEV = 510.999
_COARSE_MM = 4.0
"""Cell size of the computation, as scatter is smooth."""


def compton_per_mm(material: Material, energy_kev: float) -> float:
    """Return the linear attenuation by Compton scattering alone, 1/mm."""
    mass = sum(
        share * xraylib.CS_Compt(xraylib.SymbolToAtomicNumber(symbol), energy_kev)
        for symbol, share in material.mass_fractions.items()
    )
    return material.density_g_cm3 * mass / MM_PER_CM


def klein_nishina(cosine: Floats, energy_kev: float) -> Floats:
    """Return the share of once-scattered photons per unit solid angle, 1/sr."""
    mu = np.linspace(-1, 1, 2001)
    total = 2 * np.pi * np.trapezoid(_unscaled(mu, energy_kev), mu)
    return _unscaled(np.asarray(cosine), energy_kev) / total


def _unscaled(cosine: Floats, energy_kev: float) -> Floats:
    ratio = 1 / (1 + energy_kev / ELECTRON_KEV * (1 - cosine))
    return ratio**2 * (ratio + 1 / ratio - (1 - cosine**2))


@dataclass(frozen=True)
class ScatterKernel:
    """Spread of scatter over one panel.

    Attributes:
        energy_kev: mean energy of the detected photons.
        scale: factor on the amplitude.
    """

    energy_kev: float
    scale: float = 1.0

    def spread(
        self, scattered: NDArray[np.float32], pitch_u: float, pitch_v: float, distance_mm: float
    ) -> NDArray[np.float32]:
        """Return the scatter on the panel, in the unit of ``scattered``.

        Args:
            scattered: scatter from each pixel's ray: primary signal times mu_C L, (rows, columns).
            pitch_u: pixel pitch along the columns, mm.
            pitch_v: pixel pitch along the rows, mm.
            distance_mm: distance from the middle of the object to the panel.
        """
        rows, columns = scattered.shape
        nv = min(max(int(_COARSE_MM / pitch_v), 1), rows)
        nu = min(max(int(_COARSE_MM / pitch_u), 1), columns)
        padded = np.pad(scattered, ((0, -rows % nv), (0, -columns % nu)))
        cells = padded.reshape(padded.shape[0] // nv, nv, -1, nu).sum(axis=(1, 3), dtype=float)
        size_v, size_u = nv * pitch_v, nu * pitch_u
        kernel = self._kernel(cells.shape, size_u, size_v, distance_mm)
        shape = tuple(int(scipy.fft.next_fast_len(3 * n) or 3 * n) for n in cells.shape)
        spectra = (np.asarray(scipy.fft.rfft2(one, s=shape)) for one in (cells, kernel))
        product = np.multiply(*spectra)
        first = [n - 1 for n in cells.shape]
        full = np.asarray(scipy.fft.irfft2(product, s=shape))
        spread = full[first[0] : first[0] + cells.shape[0], first[1] : first[1] + cells.shape[1]]
        # Cell values lie at the middle of nv x nu pixels; each pixel takes the share of its area.
        at = ((np.arange(rows) + 0.5) / nv - 0.5, (np.arange(columns) + 0.5) / nu - 0.5)
        places = np.meshgrid(*at, indexing="ij")
        fine = scipy.ndimage.map_coordinates(spread, places, order=1, mode="nearest")
        return (fine * (self.scale / (nu * nv))).astype(np.float32)

    def _kernel(
        self, shape: tuple[int, ...], size_u: float, size_v: float, distance: float
    ) -> Floats:
        """Return the share of a ray's scatter in each cell around it, (2 n - 1, 2 m - 1)."""
        v = (np.arange(2 * shape[0] - 1) - (shape[0] - 1)) * size_v
        u = (np.arange(2 * shape[1] - 1) - (shape[1] - 1)) * size_u
        cosine = distance / np.sqrt(u[None] ** 2 + v[:, None] ** 2 + distance**2)
        return klein_nishina(cosine, self.energy_kev) * cosine**3 / distance**2 * size_u * size_v
