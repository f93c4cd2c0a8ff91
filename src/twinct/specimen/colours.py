"""Colours of materials in pictures."""

from __future__ import annotations

from twinct.specimen.materials import Material

Rgb = tuple[float, float, float]

BONE: Rgb = (0.91, 0.86, 0.74)
SKIN: Rgb = (0.85, 0.69, 0.60)
METAL: Rgb = (0.72, 0.74, 0.77)
WATER: Rgb = (0.62, 0.77, 0.88)
PLASTIC: Rgb = (0.86, 0.88, 0.89)

_WORDS = {
    **dict.fromkeys(("bone", "enamel", "dentin", "hydroxyapatite"), BONE),
    **dict.fromkeys(("tissue", "brain", "lens", "muscle", "skin", "adipose"), SKIN),
    "water": WATER,
}
LEAST_METAL_G_CM3 = 2.5
"""Density from which any other material looks like a metal; aluminium has 2.7."""


def colour_of(material: Material) -> Rgb:
    """Return red, green and blue of a material, in [0, 1], by its name or else its density."""
    name = material.name.lower()
    other = METAL if material.density_g_cm3 >= LEAST_METAL_G_CM3 else PLASTIC
    return next((colour for word, colour in _WORDS.items() if word in name), other)
