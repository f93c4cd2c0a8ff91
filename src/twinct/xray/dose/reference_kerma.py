"""Air kerma at the reference point and kerma-area product, as C-arms report them.

IEC 60601-2-43 puts the reference point of an isocentric C-arm on the reference axis, 15 cm from the
isocentre towards the focal spot. Both figures are those of the free beam, without patient and
scatter; air does not attenuate. The beam covers just the panel.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from twinct.geometry import Floats, ScanGeometry
from twinct.specimen.materials import material
from twinct.xray.dose.place_doses import GY_PER_KEV_G
from twinct.xray.spectrum import PhotonSpectrum

BEFORE_ISOCENTRE_MM = 150.0

_MM_PER_M = 1000.0
_MM2_PER_CM2 = 100.0
_NODES = 32
"""Gauss-Legendre nodes along each edge of the field."""


def kerma_at_1_m_gy(spectrum: PhotonSpectrum) -> float:
    """Return the air kerma of the free beam 1 m from the focal spot, Gy per mAs."""
    air = material("air")
    absorbed = [energy * air.absorption_cm2_g(energy) for energy in spectrum.energies_kev.tolist()]
    return float(spectrum.photons @ absorbed) * _MM2_PER_CM2 * GY_PER_KEV_G


def reference_kerma_gy(
    spectrum: PhotonSpectrum, views: ScanGeometry, isocentre_mm: ArrayLike
) -> Floats:
    """Return the air kerma of each view at the reference point, Gy per mAs, (views,).

    NaN where the focal spot is less than 15 cm from the isocentre.
    """
    away = np.linalg.norm(views.source - np.asarray(isocentre_mm), axis=1) - BEFORE_ISOCENTRE_MM
    square = np.where(away > 0, (away / _MM_PER_M) ** 2, np.nan)
    return kerma_at_1_m_gy(spectrum) / square


def kerma_area_product_gy_cm2(spectrum: PhotonSpectrum, views: ScanGeometry) -> Floats:
    """Return the kerma-area product of each view, Gy cm^2 per mAs, (views,).

    Air kerma is integrated over the field in a plane parallel to the panel; all such planes have
    one value.
    """
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    half_u, half_v = (size / 2 for size in views.panel.size_mm)
    u, v = half_u * nodes[:, None], half_v * nodes
    area = half_u * half_v * np.multiply.outer(weights, weights)
    product = np.empty(len(views))
    for n in range(len(views)):
        points = views.detector[n] + u[..., None] * views.u[n] + v[..., None] * views.v[n]
        square = ((points - views.source[n]) ** 2).sum(axis=-1)
        product[n] = (area / square).sum() * _MM_PER_M**2
    return kerma_at_1_m_gy(spectrum) * product / _MM2_PER_CM2
