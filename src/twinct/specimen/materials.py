"""Materials of parts, and their attenuation.

X-ray simulation and true volume use one attenuation coefficient, so that both describe the same
specimen. It is the total coefficient, including coherent scatter, by the mixture rule over the
elements,

    mu = rho * sum_i w_i (mu / rho)_i(E),

with the mass attenuation coefficients of xraylib (Schoonjans et al., Spectrochim. Acta B 66, 2011).
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
import xraylib

from twinct.core.errors import SpecimenError
from twinct.core.foreign_text import quoted
from twinct.specimen.sections import Composition

FRACTION_SUM_TOLERANCE = 0.005
"""Tolerance of the sum of mass fractions: tables round about ten shares to three digits."""

MM_PER_CM = 10.0
HEAVIEST_ELEMENT = 94
"""Heaviest element of xraylib's compounds, plutonium."""


_ANGLES = 501
"""Scattering angles for the mean electron energy, which is then accurate to 1e-5."""


@dataclass(frozen=True)
class Material:
    """A homogeneous material; ``mass_fractions`` by element symbol add up to 1."""

    name: str
    density_g_cm3: float
    mass_fractions: Mapping[str, float]

    def __post_init__(self) -> None:
        """Check the elements and their shares, normalise the shares and freeze them."""
        if not self.density_g_cm3 > 0:
            raise SpecimenError(
                f"material {quoted(self.name)}: density {self.density_g_cm3:g} g/cm3 must be "
                "positive"
            )
        if not self.mass_fractions:
            raise SpecimenError(f"material {quoted(self.name)} has no elements")
        for symbol, share in self.mass_fractions.items():
            _atomic_number(symbol, self.name)
            if not share > 0:
                raise SpecimenError(
                    f"material {quoted(self.name)}: the share of {symbol} must be positive, "
                    f"got {share:g}"
                )
        total = sum(self.mass_fractions.values())
        if abs(total - 1.0) > FRACTION_SUM_TOLERANCE:
            raise SpecimenError(
                f"material {quoted(self.name)}: the mass fractions add up to {total:.4g}; "
                "they must "
                f"add up to 1 (within {FRACTION_SUM_TOLERANCE:g})"
            )
        shares = {symbol: share / total for symbol, share in self.mass_fractions.items()}
        object.__setattr__(self, "mass_fractions", MappingProxyType(shares))

    def __hash__(self) -> int:
        """Return equal hashes for equal materials."""
        return hash((self.name, self.density_g_cm3, tuple(sorted(self.mass_fractions.items()))))

    def __reduce__(self) -> tuple[type[Material], tuple[str, float, dict[str, float]]]:
        """Support pickling, which a read-only mapping lacks."""
        return Material, (self.name, self.density_g_cm3, dict(self.mass_fractions))

    def mu_per_mm(self, energy_kev: float) -> float:
        """Return the linear attenuation coefficient at a photon energy, 1/mm.

        Raises:
            SpecimenError: xraylib has no data at this energy.
        """
        try:
            mass_attenuation = sum(
                share * xraylib.CS_Total(_atomic_number(symbol, self.name), float(energy_kev))
                for symbol, share in self.mass_fractions.items()
            )
        except ValueError as error:
            raise SpecimenError(
                f"material {quoted(self.name)}: no attenuation data at {energy_kev:g} keV "
                f"({error}); "
                "xraylib covers about 0.1 to 800 keV"
            ) from None
        return self.density_g_cm3 * mass_attenuation / MM_PER_CM

    def absorption_cm2_g(self, energy_kev: float) -> float:
        """Return the mass energy-absorption coefficient mu_en / rho at a photon energy, cm^2/g.

        The mixture rule over the elements gives

            mu_en / rho = tau / rho + sigma_C / rho * <T> / E,

        with the photoelectric and Compton parts of xraylib and the electron's energy T (Klein,
        Nishina). Fluorescence and bremsstrahlung count as absorbed locally; so water is within
        1.5 % of the tables of Hubbell and Seltzer (NISTIR 5632) from 30 to 100 keV. xraylib's own
        ``CS_Energy`` is 37 % too low there at 30 keV.

        Raises:
            SpecimenError: xraylib has no data at this energy.
        """
        try:
            numbers = {s: _atomic_number(s, self.name) for s in self.mass_fractions}
            absorbed = _electrons_share(float(energy_kev))
            return sum(
                share * xraylib.CS_Photo(numbers[symbol], float(energy_kev))
                + share * absorbed * xraylib.CS_Compt(numbers[symbol], float(energy_kev))
                for symbol, share in self.mass_fractions.items()
            )
        except ValueError as error:
            raise SpecimenError(
                f"material {quoted(self.name)}: no energy-absorption data at {energy_kev:g} "
                f"keV ({error})"
            ) from None


def _electrons_share(energy_kev: float) -> float:
    """Return the mean share of the photon energy given to a Compton electron, <T> / E."""
    angle = np.linspace(0.0, np.pi, _ANGLES)
    per_angle = np.sin(angle) * [xraylib.DCS_KN(energy_kev, a) for a in angle.tolist()]
    left = np.array([xraylib.ComptonEnergy(energy_kev, a) for a in angle.tolist()])
    return float((per_angle @ (1 - left / energy_kev)) / per_angle.sum())


def material(description: str | Composition, origin: str = "material") -> Material:
    """Return a material by name, or compose it.

    Args:
        description: a built-in name (``material_names``), an element symbol, a compound from the
            NIST list in xraylib, or a composition.
        origin: key of the description, for messages.

    Raises:
        SpecimenError: the name is unknown, the formula is invalid, or the shares do not add up to
            1.
    """
    if isinstance(description, Composition):
        try:
            return _composed(description)
        except SpecimenError as error:
            raise SpecimenError(f"{origin}: {p}" for p in error.problems) from None
    wanted = description.strip()
    key = _key(wanted)
    for name, built_in in BUILT_IN.items():
        if _key(name) == key:
            return built_in
    symbol = METALS.get(key, wanted)
    if symbol in _ELEMENTS:
        number = xraylib.SymbolToAtomicNumber(symbol)
        return Material(wanted, xraylib.ElementDensity(number), {symbol: 1.0})
    for name in xraylib.GetCompoundDataNISTList():
        if _key(name) == key:
            data = xraylib.GetCompoundDataNISTByName(name)
            return Material(name, data["density"], _by_symbol(data))
    raise SpecimenError(_unknown(wanted, origin))


def material_names() -> tuple[str, ...]:
    """Return the names for ``material``: built-in ones, metals, then the NIST compounds."""
    return (*BUILT_IN, *METALS, *xraylib.GetCompoundDataNISTList())


def _composed(composition: Composition) -> Material:
    if composition.mass_fractions is not None:
        name = " ".join(f"{s} {share:g}" for s, share in composition.mass_fractions.items())
        return Material(name, composition.density_g_cm3, composition.mass_fractions)
    if composition.of is not None:
        known = material(composition.of, "of")
        name = f"{known.name} of {composition.density_g_cm3:g} g/cm3"
        return Material(name, composition.density_g_cm3, known.mass_fractions)
    formula = composition.formula or ""
    try:
        data = xraylib.CompoundParser(formula)
    except ValueError as error:
        raise SpecimenError(
            f"formula {quoted(formula)} cannot be read ({error}); write it like H2O or "
            "Ca10(PO4)6(OH)2"
        ) from None
    return Material(formula, composition.density_g_cm3, _by_symbol(data))


def _unknown(wanted: str, origin: str) -> str:
    known = {_key(name): name for name in material_names()}
    near = [known[k] for k in difflib.get_close_matches(_key(wanted), known, n=3, cutoff=0.5)]
    near += [name for k, name in known.items() if _key(wanted) in k and name not in near][:3]
    named = (*BUILT_IN, *METALS)
    hint = f"nearest: {', '.join(near)}" if near else f"built in: {', '.join(named)}"
    return (
        f"{origin}: unknown material {quoted(wanted)}; {hint}. Element symbols also work, and any "
        "other material can be given as {formula: H2O, density_g_cm3: 1.0} or "
        "{mass_fractions: {H: 0.112, O: 0.888}, density_g_cm3: 1.0}"
    )


def _key(name: str) -> str:
    return "".join(c for c in name.lower() if c.isalnum() or c == ".")


def _by_symbol(data: dict[str, Any]) -> dict[str, float]:
    """Return the mass fractions from xraylib's data on a compound."""
    shares = zip(data["Elements"], data["massFractions"], strict=True)
    return {xraylib.AtomicNumberToSymbol(z): share for z, share in shares if share > 0}


def _atomic_number(symbol: str, name: str) -> int:
    if symbol not in _ELEMENTS:
        raise SpecimenError(
            f"material {quoted(name)}: {quoted(symbol)} is not an element symbol (H to Pu, "
            "written like Ca)"
        )
    return xraylib.SymbolToAtomicNumber(symbol)


_ELEMENTS = frozenset(xraylib.AtomicNumberToSymbol(z) for z in range(1, HEAVIEST_ELEMENT + 1))

# Compositions by mass. Tissues: ICRU Report 44 (1989) as in NIST's tables (Hubbell and Seltzer,
# NISTIR 5632); teeth: Woodard and White, Br. J. Radiol. 59 (1986), ICRU Report 46. Metals: ASTM
# F136 (Ti-6Al-4V), AISI 316L, ASTM F75 (cobalt-chromium), nominal.
_TABLE: dict[str, tuple[float, dict[str, float]]] = {
    "bone": (
        1.92,
        {"H": 0.034, "C": 0.155, "N": 0.042, "O": 0.435, "Na": 0.001, "Mg": 0.002}
        | {"P": 0.103, "S": 0.003, "Ca": 0.225},
    ),
    "water": (1.0, {"H": 0.111894, "O": 0.888106}),
    "soft_tissue": (
        1.06,
        {"H": 0.102, "C": 0.143, "N": 0.034, "O": 0.708, "Na": 0.002, "P": 0.003}
        | {"S": 0.003, "Cl": 0.002, "K": 0.003},
    ),
    "brain": (
        1.04,
        {"H": 0.107, "C": 0.145, "N": 0.022, "O": 0.712, "Na": 0.002, "P": 0.004}
        | {"S": 0.002, "Cl": 0.003, "K": 0.003},
    ),
    "eye_lens": (
        1.07,
        {"H": 0.096, "C": 0.195, "N": 0.057, "O": 0.646, "Na": 0.001, "P": 0.001}
        | {"S": 0.003, "Cl": 0.001},
    ),
    "air": (0.00120479, {"C": 0.000124, "N": 0.755268, "O": 0.231781, "Ar": 0.012827}),
    "enamel": (
        2.95,
        {"H": 0.0095, "C": 0.0111, "N": 0.0023, "O": 0.4166, "Na": 0.0079, "Mg": 0.0023}
        | {"P": 0.1871, "Cl": 0.0034, "Ca": 0.3597},
    ),
    "dentine": (
        2.14,
        {"H": 0.0267, "C": 0.1277, "N": 0.0427, "O": 0.4040, "Na": 0.0065, "Mg": 0.0059}
        | {"P": 0.1186, "Cl": 0.0004, "Ca": 0.2674},
    ),
    "hydroxyapatite": (3.16, {"H": 0.00201, "O": 0.41405, "P": 0.18501, "Ca": 0.39893}),
    "aluminium": (2.699, {"Al": 1.0}),
    "titanium": (4.506, {"Ti": 1.0}),
    "titanium_alloy": (4.43, {"Ti": 0.90, "Al": 0.06, "V": 0.04}),
    "steel": (8.0, {"Fe": 0.655, "Cr": 0.17, "Ni": 0.12, "Mo": 0.025, "Mn": 0.02, "Si": 0.01}),
    "cobalt_chromium": (8.3, {"Co": 0.65, "Cr": 0.29, "Mo": 0.06}),
    "pmma": (1.19, {"H": 0.080538, "C": 0.599848, "O": 0.319614}),
    "peek": (1.32, {"H": 0.0419, "C": 0.7916, "O": 0.1665}),
}
_SYNONYMS = {"tooth": "enamel", "dentin": "dentine", "aluminum": "aluminium"}

METALS: Mapping[str, str] = MappingProxyType(
    {"copper": "Cu", "iron": "Fe", "nickel": "Ni", "zinc": "Zn", "tin": "Sn", "lead": "Pb"}
    | {"magnesium": "Mg", "chromium": "Cr", "cobalt": "Co", "molybdenum": "Mo", "rhodium": "Rh"}
    | {"silver": "Ag", "gold": "Au", "platinum": "Pt", "tungsten": "W", "tantalum": "Ta"}
    | {"beryllium": "Be", "zirconium": "Zr", "niobium": "Nb"}
)
"""Elements by name, with xraylib's density."""

BUILT_IN: Mapping[str, Material] = MappingProxyType(
    {name: Material(name, *row) for name, row in _TABLE.items()}
    | {synonym: Material(name, *_TABLE[name]) for synonym, name in _SYNONYMS.items()}
)
