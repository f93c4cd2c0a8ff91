"""The materials of a CTSimU file: compositions by formula and mass fraction."""

from __future__ import annotations

import xraylib

from twinct.ctsimu.reader import Section
from twinct.errors import SpecimenError
from twinct.specimen import Material

Materials = dict[str, Material | None]
"""By id; None for one of no density: vacuum."""


def read_materials(root: Section) -> Materials:
    """All materials of the file."""
    found: Materials = {}
    for section in root.sections("materials"):
        name = section.text("id") or section.place
        section.skip("name")
        density = section.needed("density", "g/cm^3")
        shares: dict[str, float] = {}
        for part in section.sections("composition"):
            formula, weight = part.text("formula"), part.number("mass_fraction")
            weight = 1.0 if weight is None else weight
            if density > 0 and weight > 0:
                _add(part, formula or "", weight, shares)
        if density <= 0:
            found[name] = None
            continue
        total = sum(shares.values())
        if total <= 0:
            section.problem("composition", "holds no elements")
            found[name] = None
            continue
        try:
            found[name] = Material(name, density, {s: w / total for s, w in shares.items()})
        except SpecimenError as error:
            section.problem("composition", str(error))
    return found


def _add(section: Section, formula: str, weight: float, shares: dict[str, float]) -> None:
    try:
        parsed = xraylib.CompoundParser("".join(formula.split()))
    except ValueError as error:
        section.problem("formula", f"{formula!r} cannot be read: {error}")
        return
    for number, share in zip(parsed["Elements"], parsed["massFractions"], strict=True):
        symbol = xraylib.AtomicNumberToSymbol(number)
        shares[symbol] = shares.get(symbol, 0.0) + weight * share
