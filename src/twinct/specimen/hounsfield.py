"""From Hounsfield units to amounts of a few basis materials.

A ``TissueLine`` is a list of points (HU, amounts) with straight lines between them. Between two
tissues, a line in HU is a mixture by volume, at all photon energies: so Schneider, Bortfeld and
Schlegel (Phys. Med. Biol. 45 (2000) 459) interpolate compositions, and so do tables of users.

The built-in line follows their choice of tissues. The HU of these tissues are those at the
effective energy of the scanner,

    HU = 1000 (mu(E) / mu_water(E) - 1),

so that the line is valid for one tube voltage. Air is nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from twinct.geometry import Floats
from twinct.geometry.arrays import lock
from twinct.specimen import sections
from twinct.specimen.ct_image import AIR_HU
from twinct.specimen.materials import BUILT_IN, Material, material

FIT_KEV = np.arange(40.0, 151.0, 5.0)
"""Photon energies at which tissues are expressed by basis materials, keV."""

STEP_HU = 1.0
"""Width of a step between two lines of tissues, such as of connective tissue and of bone."""

LUNG_END_HU = -120.0
"""HU up to which lung fills the gap between air and fat (Schneider et al., table 6)."""

EFFECTIVE_KEV = {80: 57.9, 100: 65.3, 120: 71.6, 140: 77.4}
"""Photon energy at which cortical bone has the HU of a scanner, by its tube voltage in kV.

Computed for a tungsten tube (8 deg, 6 mm Al, 0.9 mm Ti), an energy-integrating detector, and bone
within 25 cm of water; Schneider's scanner, 120 kV, has 71.3 keV by its HU of cortical bone.
"""


@dataclass(frozen=True, eq=False)
class TissueLine:
    """Amounts of basis materials, linear in HU between given points.

    Attributes:
        materials: basis materials.
        hu: HU of the points, (points,), increasing. The first point holds for all lower values.
        amounts: (points, materials), not negative. Beyond the last point, amounts grow with the
            attenuation, as those of a denser material.
        energy_kev: photon energy at which HU are relative to water; NaN if unknown.
    """

    materials: tuple[Material, ...]
    hu: Floats
    amounts: Floats
    energy_kev: float = float("nan")

    def __post_init__(self) -> None:
        """Lock the arrays."""
        lock(self, "hu", "amounts")

    @property
    def nothing_hu(self) -> float:
        """HU up to which voxels attenuate nothing; -inf if the first point attenuates."""
        empty = np.asarray(~self.amounts.any(axis=1))
        return float(self.hu[empty.argmin() - 1]) if empty[0] else -np.inf

    def __call__(self, hu: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return the amounts (..., materials) of voxels with these HU."""
        inside = np.minimum(hu, self.hu[-1])
        beyond = np.maximum(np.asarray(hu) - AIR_HU, self.hu[-1] - AIR_HU)
        beyond = beyond / (self.hu[-1] - AIR_HU)
        amounts = np.empty((*np.shape(hu), len(self.materials)), dtype=np.float32)
        for m in range(len(self.materials)):
            amounts[..., m] = np.interp(inside, self.hu, self.amounts[:, m]) * beyond
        return amounts

    def mu_per_mm(self, hu: NDArray[np.floating], energy_kev: float) -> Floats:
        """Return the attenuation of voxels with these HU at a photon energy, 1/mm."""
        of_materials = np.array([m.mu_per_mm(energy_kev) for m in self.materials])
        return self(hu).astype(np.float64) @ of_materials


def line_of(section: sections.Calibration, key: str, pure: bool = False) -> TissueLine:
    """Return the line that a part's key ``calibration`` describes.

    Args:
        section: the calibration.
        key: its key, for messages.
        pure: True if each row of a table is a material of its own, with the density of the row.

    Raises:
        SpecimenError: a material is unknown; begins with the key.
    """
    match section:
        case sections.Tissues():
            energy = section.energy_kev or EFFECTIVE_KEV[section.kv]
            return tissue_line(energy)
        case sections.AttenuationValues():
            return tissue_line(section.energy_kev)
        case sections.TissueTable():
            return _table_line(section, key, pure)
        case sections.ElectronDensities():
            return _electron_line(section)


def values_line(section: sections.Calibration) -> sections.HuLine | None:
    """Return the line from a file's attenuation values to HU; None if they are HU."""
    if not isinstance(section, sections.AttenuationValues):
        return None
    per_unit = {"1/mm": 1.0, "1/cm": 0.1}[section.unit]
    water = BUILT_IN["water"].mu_per_mm(section.energy_kev)
    return sections.HuLine(slope=-AIR_HU * per_unit / water, intercept=AIR_HU)


def tissue_line(energy_kev: float) -> TissueLine:
    """Return the built-in line for a scanner of an effective energy.

    Air and lung, adipose tissue, adrenal gland, small intestine, connective tissue, and mixtures
    of marrow and cortical bone. Basis materials are adipose tissue, water and cortical bone, which
    represent all of these tissues within 0.01 % from 40 to 150 keV.
    """
    basis = TISSUES["adipose tissue"], BUILT_IN["water"], TISSUES["cortical bone"]
    amounts = {name: _amounts_of(tissue, basis) for name, tissue in TISSUES.items()}
    hu = {name: hu_of(tissue, energy_kev) for name, tissue in TISSUES.items()}
    points = [(AIR_HU, np.zeros(len(basis)))]
    points += [(LUNG_END_HU, amounts["lung"] * _denser(hu["lung"], LUNG_END_HU))]
    points += [
        (hu[name], amounts[name])
        for name in ("adipose tissue", "adrenal gland", "small intestine", "connective tissue")
    ]
    start, low, high = points[-1][0] + STEP_HU, hu["marrow"], hu["cortical bone"]
    share = (start - low) / (high - low)
    points += [(start, (1 - share) * amounts["marrow"] + share * amounts["cortical bone"])]
    points += [(high, amounts["cortical bone"])]
    places, values = zip(*points, strict=True)
    return TissueLine(basis, np.array(places), np.array(values), energy_kev)


def hu_of(substance: Material, energy_kev: float) -> float:
    """Return the HU of a material at a photon energy."""
    water = BUILT_IN["water"].mu_per_mm(energy_kev)
    return 1000.0 * (substance.mu_per_mm(energy_kev) / water - 1.0)


def _denser(hu: float, other: float) -> float:
    """Return the factor on the density that changes a material's HU."""
    return (other - AIR_HU) / (hu - AIR_HU)


def _amounts_of(tissue: Material, basis: Sequence[Material]) -> Floats:
    """Return amounts of basis materials, not negative, with nearly the attenuation of a tissue."""
    wanted = np.array([tissue.mu_per_mm(e) for e in FIT_KEV])
    given = np.array([[m.mu_per_mm(e) for m in basis] for e in FIT_KEV])
    amounts, _ = scipy.optimize.nnls(given / wanted[:, None], np.ones(len(wanted)))
    return amounts


def _table_line(section: sections.TissueTable, key: str, pure: bool) -> TissueLine:
    """Return a user's table: each row has one material at one density."""
    of_rows = []
    for i, row in enumerate(section.rows):
        substance = material(row.material, f"{key}.rows.{i}.material")
        if pure and row.density_g_cm3:
            substance = replace(substance, density_g_cm3=row.density_g_cm3)
        of_rows.append(substance)
    filled = (m for m, row in zip(of_rows, section.rows, strict=True) if row.density_g_cm3)
    basis = tuple(dict.fromkeys(filled if pure else of_rows))
    amounts = np.zeros((len(section.rows), len(basis)))
    for i, (row, substance) in enumerate(zip(section.rows, of_rows, strict=True)):
        if row.density_g_cm3:
            amounts[i, basis.index(substance)] = row.density_g_cm3 / substance.density_g_cm3
    return TissueLine(basis, np.array([row.hu for row in section.rows]), amounts)


def _electron_line(section: sections.ElectronDensities) -> TissueLine:
    """Return the built-in tissues at the HU where a scanner shows their electron densities."""
    line = tissue_line(EFFECTIVE_KEV[120])
    water = _electrons(BUILT_IN["water"])
    relative = line.amounts @ np.array([_electrons(m) / water for m in line.materials])
    # Only where it rises has the curve an inverse: connective tissue is denser than soft bone.
    rises = np.minimum.accumulate(relative[::-1])[::-1] >= relative
    points = np.array(section.points)
    hu = _extended(relative[rises], points[:, 1], points[:, 0])
    return TissueLine(line.materials, hu, line.amounts[rises])


def _extended(x: Floats, known: Floats, values: Floats) -> Floats:
    """Interpolate between known values, and extrapolate straight beyond them."""
    slopes = np.diff(values) / np.diff(known)
    extended = np.interp(x, known, values)
    extended += slopes[0] * np.minimum(x - known[0], 0) + slopes[-1] * np.maximum(x - known[-1], 0)
    return extended


def _electrons(substance: Material) -> float:
    """Return the electron density of a material, mol/cm^3."""
    import xraylib

    numbers = {s: xraylib.SymbolToAtomicNumber(s) for s in substance.mass_fractions}
    per_gram = sum(
        share * numbers[symbol] / xraylib.AtomicWeight(numbers[symbol])
        for symbol, share in substance.mass_fractions.items()
    )
    return substance.density_g_cm3 * per_gram


def _tissue(name: str, density: float, **percent: float) -> Material:
    return Material(name, density, {s: share / 100 for s, share in percent.items()})


# Woodard and White, Br. J. Radiol. 59 (1986) 1209, as chosen by Schneider et al., table 1 and 2;
# marrow is red and yellow marrow to equal masses.
TISSUES = {
    tissue.name: tissue
    for tissue in (
        _tissue(
            "lung", 0.26, H=10.3, C=10.5, N=3.1, O=74.9, Na=0.2, P=0.2, S=0.3, Cl=0.3, K=0.2
        ),
        _tissue("adipose tissue", 0.93, H=11.6, C=68.1, N=0.2, O=19.8, Na=0.1, S=0.1, Cl=0.1),
        _tissue(
            "adrenal gland", 1.03, H=10.6, C=28.4, N=2.6, O=57.8, P=0.1, S=0.2, Cl=0.2, K=0.1
        ),
        _tissue(
            "small intestine", 1.03, H=10.6, C=11.5, N=2.2, O=75.1, Na=0.1, P=0.1, S=0.1, Cl=0.2,
            K=0.1,
        ),
        _tissue("connective tissue", 1.12, H=9.4, C=20.7, N=6.2, O=62.2, Na=0.6, S=0.6, Cl=0.3),
        _tissue(
            "marrow", 1.005, H=11.0, C=52.9, N=2.05, O=33.5, Na=0.05, P=0.05, S=0.15, Cl=0.15,
            K=0.1, Fe=0.05,
        ),
    )
} | {"cortical bone": BUILT_IN["bone"]}  # fmt: skip
"""Tissues of the built-in line, and lung as the filling between air and fat."""
