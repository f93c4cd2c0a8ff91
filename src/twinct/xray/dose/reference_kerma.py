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
from twinct.xray.beam_shape import BeamShape
from twinct.xray.dose.place_doses import GY_PER_KEV_G
from twinct.xray.spectrum import PhotonSpectrum

BEFORE_ISOCENTRE_MM = 150.0

_MM_PER_M = 1000.0
_MM2_PER_CM2 = 100.0
_NODES = 32
"""Gauss-Legendre nodes along each edge of the field."""


def kerma_at_1_m_gy(spectrum: PhotonSpectrum) -> float:
    """Return the air kerma of the free beam 1 m from the focal spot, Gy per mAs."""
    return float(_kerma_of_bins(spectrum).sum())


def _kerma_of_bins(spectrum: PhotonSpectrum) -> Floats:
    air = material("air")
    absorbed = [energy * air.absorption_cm2_g(energy) for energy in spectrum.energies_kev.tolist()]
    return spectrum.photons * absorbed * (_MM2_PER_CM2 * GY_PER_KEV_G)


def reference_kerma_gy(free: BeamShape, views: ScanGeometry, isocentre_mm: ArrayLike) -> Floats:
    """Return the air kerma of each view at the reference point, Gy per mAs, (views,).

    NaN where the focal spot is less than 15 cm from the isocentre.
    """
    centre = np.asarray(isocentre_mm, np.float64)
    away = np.linalg.norm(views.source - centre, axis=1) - BEFORE_ISOCENTRE_MM
    square = np.where(away > 0, (away / _MM_PER_M) ** 2, np.nan)
    kerma = _kerma_of_bins(free.spectrum)
    number = np.empty(len(views))
    for n, view in enumerate(views):
        if not away[n] > 0:
            number[n] = np.nan
            continue
        # Where the ray through the isocentre meets the panel.
        way = centre - view.source[0]
        depth = (view.source[0] - view.detector[0]) @ view.normal[0]
        at = view.source[0] - view.detector[0] - way * depth / (way @ view.normal[0])
        u, v = (np.array([at @ axis[0]], np.float64) for axis in (view.u, view.v))
        number[n] = kerma @ free.factors(view, u, v)[:, 0, 0]
    return number / square


def kerma_area_product_gy_cm2(free: BeamShape, views: ScanGeometry) -> Floats:
    """Return the kerma-area product of each view, Gy cm^2 per mAs, (views,).

    Air kerma is integrated over the field in a plane parallel to the panel; all such planes have
    one value.
    """
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    half_u, half_v = (size / 2 for size in views.panel.size_mm)
    u, v = half_u * nodes, half_v * nodes
    area = half_u * half_v * np.multiply.outer(weights, weights)
    kerma = _kerma_of_bins(free.spectrum)
    product = np.empty(len(views))
    for n in range(len(views)):
        points = views.detector[n] + u[:, None] * views.u[n] + v[:, None, None] * views.v[n]
        square = ((points - views.source[n]) ** 2).sum(axis=-1)
        here = np.tensordot(kerma, free.factors(views[n], u, v), axes=1)
        product[n] = (area * here / square).sum() * _MM_PER_M**2
    return product / _MM2_PER_CM2
