"""Materials of a CTSimU file: compositions by formula and mass fraction."""

from __future__ import annotations

import xraylib

from twinct.core.errors import SpecimenError
from twinct.ctsimu.drifts import short
from twinct.ctsimu.ranges import DENSITY, SHARE
from twinct.ctsimu.reader import JsonSection
from twinct.specimen import Material

Materials = dict[str, Material | None]
"""Materials by id; None for a vacuum, whose density is 0."""

SUM_TOLERANCE = 0.01
"""Tolerance of the sum of a material's mass fractions; rounded tables pass."""


def read_materials(root: JsonSection) -> Materials:
    """Return all materials of the file."""
    materials: Materials = {}
    for section in root.sections("materials"):
        name = section.text("id")
        section.require("id")
        if name in materials:
            section.problem("id", f"{short(name)} is already the id of an earlier material")
        section.skip("name")
        materials[name or section.place] = _read(section, name or section.place)
    return materials


def _read(section: JsonSection, name: str) -> Material | None:
    density = section.needed("density", "g/cm^3", DENSITY)
    parts = [
        (part, part.text("formula"), part.number("mass_fraction", "", SHARE))
        for part in section.sections("composition")
    ]
    if not density > 0:
        return None  # vacuum, or already reported
    if not parts:
        section.require("composition")
        return None
    weights = [1.0 if weight is None else weight for _, _, weight in parts]
    shares: dict[str, float] = {}
    for (part, formula, _), weight in zip(parts, weights, strict=True):
        if not _add(part, formula or "", weight, shares):
            return None
    if abs(sum(weights) - 1) > SUM_TOLERANCE:
        section.problem("composition", f"the mass fractions add up to {sum(weights):.4g}, not to 1")
        return None
    total = sum(shares.values())
    try:
        return Material(name, density, {s: w / total for s, w in shares.items() if w > 0})
    except SpecimenError as error:
        section.problem("composition", str(error))
        return None


def _add(section: JsonSection, formula: str, weight: float, shares: dict[str, float]) -> bool:
    """Add the elements of a formula to the shares; return False for an invalid formula."""
    try:
        parsed = xraylib.CompoundParser("".join(formula.split()))
    except ValueError as error:
        section.problem("formula", f"{short(formula)} cannot be read: {error}")
        return False
    for number, share in zip(parsed["Elements"], parsed["massFractions"], strict=True):
        symbol = xraylib.AtomicNumberToSymbol(number)
        shares[symbol] = shares.get(symbol, 0.0) + weight * share
    return True
