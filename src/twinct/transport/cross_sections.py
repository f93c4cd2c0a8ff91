"""Interaction data of media, tabulated once for the kernels.

Coefficients and angular distributions are those of xraylib (Schoonjans et al., Spectrochim. Acta B
66, 2011; the tables of EPDL97), for independent atoms:

    Compton   d sigma / d Omega ~ KN(E, c) S(x),         x = E / hc sqrt((1 - c) / 2),
    Rayleigh  d sigma / d Omega ~ F(x)^2 (1 + c^2) / 2,

with the cosine c of the scattering angle, the formula KN of Klein and Nishina, and F^2 and S summed
over the atoms of a unit of mass. The free electron's formula gives the energy after Compton
scattering. A photoelectric absorption may emit a K line. Other fluorescence and all electrons
deposit their energy where they start.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import xraylib
from numpy.typing import NDArray

from twinct.core.errors import InputError
from twinct.specimen.materials import Material

LOWEST_KEV = 1.0
"""Photons below it end: their mean free path in water is below 3 micrometres."""

HIGHEST_KEV = 150.0
"""An electron of this energy travels 0.3 mm in water, so that it still deposits locally."""

STEP_KEV = 0.05
"""Step of the coefficients, linear in between: within 2e-4 of xraylib from 5 keV on."""

ELECTRON_KEV = 510.99895
"""Rest energy of the electron."""

HC_KEV_ANGSTROM = 12.39841984

CELLS = 1024
"""Cells of F^2 and S, equal in sqrt(x)."""

LARGEST_X = HIGHEST_KEV / HC_KEV_ANGSTROM
"""Momentum transfer of a photon of the highest energy that returns, 1 / Angstrom."""

TOTAL, COMPTON, RAYLEIGH, TRANSFER, COMPTON_NORM, RAYLEIGH_NORM = range(6)
"""Columns of the coefficients."""

LEAST_LINE_KEV = 5.0
"""Least energy of a line that is followed; others have mean free paths below 0.3 mm in water."""

MOST_MEDIA = 256

_LEAST_X = 1e-3
"""Below it S is extrapolated by x^2: the tables of xraylib begin there."""

_SMOOTH = 400
"""Energies of the integrals, which are smooth, in equal ratios: linear between within 1e-4."""

_LIGHTEST = 20
"""Lightest element whose K lines are looked up; its energies are below the least one."""

_CM2_TO_MM2 = 100.0
_G_PER_MM3 = 1e-3
_GAUSS = np.polynomial.legendre.leggauss(4)


class Media(NamedTuple):
    """Tables of all media of a body.

    Attributes:
        coefficients: by medium, energy and column, (media, energies, 6), float32. Columns: total,
            Compton and Rayleigh in 1/mm per g/cm^3; the energy transferred to electrons in keV/mm
            per g/cm^3; the integrals of the Compton and Rayleigh shapes over all directions.
        form: F^2 at the edges of the cells, (media, CELLS + 1), float64.
        form_sum: integral of F^2 over x^2 up to each edge, 1/Angstrom^2, (media, CELLS + 1).
        incoherent: S at the edges of the cells, (media, CELLS + 1), float64.
        line_energies: energies of the K lines of each medium, keV, (media, lines); 0 without one.
        line_sums: coefficients of their emission, summed up to each line, 1/mm per g/cm^3,
            (media, energies, lines), float32.
    """

    coefficients: NDArray[np.float32]
    form: NDArray[np.float64]
    form_sum: NDArray[np.float64]
    incoherent: NDArray[np.float64]
    line_energies: NDArray[np.float64]
    line_sums: NDArray[np.float32]


def energies_kev() -> NDArray[np.float64]:
    """Return the energies of the coefficients, keV."""
    return np.linspace(LOWEST_KEV, HIGHEST_KEV, round((HIGHEST_KEV - LOWEST_KEV) / STEP_KEV) + 1)


def momentum_transfers() -> NDArray[np.float64]:
    """Return the edges of the cells of F^2 and S, 1/Angstrom."""
    return LARGEST_X * (np.arange(CELLS + 1) / CELLS) ** 2


def require_energies(energies: NDArray[np.float64], origin: str = "spectrum") -> None:
    """Refuse photon energies outside the tables.

    Raises:
        InputError: an energy lies outside.
    """
    outside = energies[~((energies >= LOWEST_KEV) & (energies <= HIGHEST_KEV))]
    if len(outside):
        raise InputError(
            f"{origin}: photons of {outside[0]:g} keV; Monte Carlo transport has data from "
            f"{LOWEST_KEV:g} to {HIGHEST_KEV:g} keV"
        )


def media_tables(materials: Sequence[Material]) -> Media:
    """Return the tables of materials; their densities do not count.

    Raises:
        InputError: there are no materials or too many, or xraylib lacks data on an element.
    """
    if not 0 < len(materials) <= MOST_MEDIA:
        raise InputError(f"{len(materials)} media: a body must have 1 to {MOST_MEDIA}")
    energies = energies_kev()
    coefficients = np.empty((len(materials), len(energies), 6), np.float32)
    form, incoherent = (np.zeros((len(materials), CELLS + 1)) for _ in range(2))
    lines = [_lines(material) for material in materials]
    most = max(len(own) for own in lines)
    line_energies = np.zeros((len(materials), most))
    line_sums = np.zeros((len(materials), len(energies), most), np.float32)
    for m, material in enumerate(materials):
        photo, compton, rayleigh, compton_norm, rayleigh_norm, given = np.zeros((6, len(energies)))
        for symbol, share in material.mass_fractions.items():
            element = _element(symbol)
            for total, part in zip((photo, compton, rayleigh), element.coefficients, strict=True):
                total += share * part
            for total, part in zip(
                (compton_norm, rayleigh_norm, given), element.norms, strict=True
            ):
                total += share * part
            form[m] += share * element.form
            incoherent[m] += share * element.incoherent
        coefficients[m, :, TOTAL] = photo + compton + rayleigh
        coefficients[m, :, COMPTON] = compton
        coefficients[m, :, RAYLEIGH] = rayleigh
        emitted = np.zeros(len(energies))
        for n, (energy, emission) in enumerate(lines[m]):
            line_energies[m, n] = energy
            line_sums[m, :, n:] += emission[:, None]
            emitted += emission * energy
        coefficients[m, :, TRANSFER] = photo * energies - emitted + compton * given / compton_norm
        coefficients[m, :, COMPTON_NORM] = compton_norm
        coefficients[m, :, RAYLEIGH_NORM] = rayleigh_norm
    steps = np.diff(momentum_transfers() ** 2)
    form_sum = np.zeros_like(form)
    np.cumsum((form[:, 1:] + form[:, :-1]) / 2 * steps, axis=1, out=form_sum[:, 1:])
    return Media(coefficients, form, form_sum, incoherent, line_energies, line_sums)


class _Element(NamedTuple):
    """Data of a gram of an element; those of a material are their sums by mass.

    Attributes:
        coefficients: photoelectric, Compton and Rayleigh, 1/mm per g/cm^3, (3, energies).
        form: F^2 at the edges of the cells.
        incoherent: S at the edges of the cells.
        norms: integrals of the Compton and Rayleigh shapes over all directions, and that of the
            Compton shape times the electron's energy in keV, (3, energies).
        lines: energy and emission coefficient of each K line that counts.
    """

    coefficients: NDArray[np.float64]
    form: NDArray[np.float64]
    incoherent: NDArray[np.float64]
    norms: NDArray[np.float64]
    lines: list[tuple[float, NDArray[np.float64]]]


@cache
def _element(symbol: str) -> _Element:
    number = xraylib.SymbolToAtomicNumber(symbol)
    energies = energies_kev()
    kinds: tuple[Any, ...] = (xraylib.CS_Photo, xraylib.CS_Compt, xraylib.CS_Rayl)
    x = momentum_transfers()
    try:
        table = np.array([[kind(number, e) for e in energies.tolist()] for kind in kinds])
        form = np.array([xraylib.FF_Rayl(number, q) for q in x.tolist()]) ** 2
        above = np.maximum(x, _LEAST_X).tolist()
        incoherent = np.array([xraylib.SF_Compt(number, q) for q in above])
    except ValueError as error:
        raise InputError(
            f"element {symbol}: xraylib has no data on its scatter ({error})"
        ) from None
    # Splines of the tables overshoot a little: the kernels rely on S that never falls.
    incoherent = np.maximum.accumulate(incoherent * np.minimum(x / _LEAST_X, 1.0) ** 2)
    atoms = 1 / xraylib.AtomicWeight(number)
    compton = _compton_integrals(incoherent, energies)
    norms = np.array([compton[0], _rayleigh_norm(form, energies), compton[1]])
    units = _CM2_TO_MM2 * _G_PER_MM3
    lines = [
        (xraylib.LineEnergy(number, line), _emission(number, line, energies) * units)
        for line in (xraylib.KA_LINE, xraylib.KB_LINE)
        if number >= _LIGHTEST and xraylib.LineEnergy(number, line) >= LEAST_LINE_KEV
    ]
    return _Element(table * units, form * atoms, incoherent * atoms, norms * atoms, lines)


def _emission(number: int, line: int, energies: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the cross section of the emission of a line, cm^2/g; 0 below the K edge."""
    edge = xraylib.EdgeEnergy(number, xraylib.K_SHELL)
    function = xraylib.CS_FluorLine_Kissel
    return np.array([function(number, line, e) if e > edge else 0.0 for e in energies.tolist()])


def _lines(material: Material) -> list[tuple[float, NDArray[np.float64]]]:
    """Return the energies of a material's K lines, and the coefficients of their emission."""
    shares = material.mass_fractions.items()
    return [(e, share * emission) for s, share in shares for e, emission in _element(s).lines]


@cache
def _gauss_nodes() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return nodes and weights of the integrals over all angles, an eigenvalue problem."""
    return np.polynomial.legendre.leggauss(256)


def _compton_integrals(
    incoherent: NDArray[np.float64], energies: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the integrals of KN S, and of KN S times the electron's energy in keV."""
    coarse = _coarse(energies)
    points, weights = _gauss_nodes()
    # sqrt(x) runs over [0, 1] of its largest value: most nodes lie where S rises.
    share = (points + 1) / 2
    c = 1 - 2 * share**4
    solid_angle = 2 * np.pi * 8 * share**3 * weights / 2
    norm, given = np.empty(len(coarse)), np.empty(len(coarse))
    for i, energy in enumerate(coarse):
        left = 1 / (1 + energy / ELECTRON_KEV * (1 - c))
        x = energy / HC_KEV_ANGSTROM * share**2
        s = np.interp(np.sqrt(x / LARGEST_X), np.linspace(0, 1, CELLS + 1), incoherent)
        shape = left**2 * (left + 1 / left - (1 - c**2)) / 2 * s * solid_angle
        norm[i] = shape.sum()
        given[i] = (shape * (1 - left)).sum() * energy
    return np.interp(energies, coarse, norm), np.interp(energies, coarse, given)


def _rayleigh_norm(form: NDArray[np.float64], energies: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the integral of F^2 (1 + c^2) / 2 over all directions."""
    coarse = _coarse(energies)
    edges = momentum_transfers() ** 2
    points, weights = _GAUSS
    norm = np.empty(len(coarse))
    for i, energy in enumerate(coarse):
        largest = (energy / HC_KEV_ANGSTROM) ** 2
        # F^2 is linear in x^2 inside a cell, so that the sum over its points is exact.
        below, above = np.minimum(edges[:-1], largest), np.minimum(edges[1:], largest)
        half = (above - below) / 2
        q = (above + below)[:, None] / 2 + half[:, None] * points
        shape = np.interp(q, edges, form) * (1 + (1 - 2 * q / largest) ** 2) / 2
        norm[i] = 4 * np.pi / largest * (shape * weights * half[:, None]).sum()
    return np.interp(energies, coarse, norm)


def _coarse(energies: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the energies at which the smooth integrals are computed."""
    return np.geomspace(energies[0], energies[-1], _SMOOTH)
