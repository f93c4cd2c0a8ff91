"""Effective dose with the tissue weighting factors of ICRP Publication 103 (2007), table B.2.

A label belongs to a tissue by its name, without "left" and "right". The radiation weighting factor
of photons is 1. The dose is that of this one body: ICRP's is the mean of two reference persons.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

REMAINDER = (
    "adrenal",
    "extrathoracic region",
    "gall bladder",
    "heart",
    "kidney",
    "lymphatic node",
    "muscle",
    "oral mucosa",
    "pancreas",
    "prostate|uterus",
    "small intestine",
    "spleen",
    "thymus",
)
"""Tissues whose mean dose counts with 0.12; names of one tissue are separated by ``|``."""

WEIGHTS = {
    **dict.fromkeys(("red bone marrow", "colon", "lung", "stomach", "breast"), 0.12),
    "gonad|testis|testes|ovary|ovaries": 0.08,
    **dict.fromkeys(("bladder|urinary bladder", "oesophagus|esophagus", "liver", "thyroid"), 0.04),
    **dict.fromkeys(("bone surface", "brain", "salivary gland", "skin"), 0.01),
    **dict.fromkeys(REMAINDER, 0.12 / len(REMAINDER)),
}
"""Weight of each tissue; they add up to 1."""


@dataclass(frozen=True)
class EffectiveDose:
    """Effective dose, or the tissues that it lacks.

    Attributes:
        sievert: effective dose, Sv; None if a tissue has no label.
        error: bound of its standard error, Sv, as if all errors had one cause.
        missing: tissues without a label.
    """

    sievert: float | None
    error: float | None
    missing: tuple[str, ...]


def effective_dose(doses: Mapping[str, tuple[float, float, float]]) -> EffectiveDose:
    """Return the effective dose of parts and labels.

    Args:
        doses: mean dose, Gy, its standard error, Gy, and mass, g, of each by its name. Labels of
            one tissue count by their masses.
    """
    by_tissue: dict[str, list[tuple[float, float, float]]] = {}
    for name, dose in doses.items():
        by_tissue.setdefault(_plain(name), []).append(dose)
    total, error, missing = 0.0, 0.0, []
    for names, weight in WEIGHTS.items():
        own = [dose for name in names.split("|") for dose in by_tissue.get(name, [])]
        mass = sum(one[2] for one in own)
        if not own:
            missing.append(names.split("|")[0])
            continue
        total += weight * sum(one[0] * one[2] for one in own) / mass
        error += weight * sum(one[1] * one[2] for one in own) / mass
    if missing:
        return EffectiveDose(None, None, tuple(missing))
    return EffectiveDose(total, error, ())


def _plain(name: str) -> str:
    """Return the name of a tissue in the singular, without its side."""
    words = re.split(r"[\s_]+", name.lower())
    kept = " ".join(word for word in words if word not in ("left", "right"))
    return kept[:-1] if kept.endswith("s") and kept[:-1] in _SINGULAR else kept


_SINGULAR = {name for names in WEIGHTS for name in names.split("|")}
