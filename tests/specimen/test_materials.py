"""Attenuation against NIST, and what a user may get wrong."""

from __future__ import annotations

import pickle
from pathlib import Path

import pytest
from xraylib import SymbolToAtomicNumber

from twinct.core.errors import SpecimenError
from twinct.scenario import Composition
from twinct.specimen import Material, material, material_names
from twinct.specimen.materials import BUILT_IN, METALS

NIST_REL = 0.004
"""NIST's tables (XCOM) and xraylib's fits of the same cross-sections differ by a few per mille."""

ATOMIC_WEIGHTS = {"H": 1.008, "C": 12.011, "N": 14.007, "O": 15.999, "Na": 22.990, "Mg": 24.305}
ATOMIC_WEIGHTS |= {"P": 30.974, "S": 32.06, "Cl": 35.45, "K": 39.098, "Ca": 40.078}
"""IUPAC's standard ones; xraylib's have fewer digits."""


@pytest.mark.parametrize(
    ("name", "energy_kev", "density", "mass_attenuation"),
    [
        # NIST, X-Ray Mass Attenuation Coefficients, tables 3 and 4, cm2/g.
        ("bone", 80.0, 1.92, 0.2229),
        ("bone", 60.0, 1.92, 0.3148),
        ("water", 80.0, 1.0, 0.1837),
        ("soft_tissue", 80.0, 1.06, 0.1823),
        ("titanium", 80.0, 4.506, 0.4052),
        ("titanium", 100.0, 4.506, 0.2721),
        ("aluminium", 80.0, 2.699, 0.2018),
        ("pmma", 80.0, 1.19, 0.1751),
        ("Fe", 100.0, 7.874, 0.3717),
        ("air", 80.0, 1.205e-3, 0.1662),
    ],
)
def test_attenuation_equals_nist(name, energy_kev, density, mass_attenuation):
    mu = material(name).mu_per_mm(energy_kev)
    assert mu == pytest.approx(mass_attenuation * density / 10, rel=NIST_REL)


@pytest.mark.parametrize(
    ("name", "density", "electrons"),
    [
        # NIST, X-Ray Mass Attenuation Coefficients, table 2: density, g/cm3, and <Z/A>.
        ("bone", 1.92, 0.51478),
        ("soft_tissue", 1.06, 0.54996),
        ("brain", 1.04, 0.55239),
        ("eye_lens", 1.07, 0.54709),
        ("water", 1.0, 0.55508),
    ],
)
def test_density_and_electrons_per_mass_are_the_tables(name, density, electrons):
    """One share that is off by 0.001 shows in the fourth digit, hydrogen's in the third."""
    found = material(name)
    shares = found.mass_fractions.items()
    electrons_found = sum(w * SymbolToAtomicNumber(s) / ATOMIC_WEIGHTS[s] for s, w in shares)
    assert found.density_g_cm3 == density
    assert electrons_found == pytest.approx(electrons, abs=3e-5)


def test_a_known_material_at_another_density():
    dense = material(Composition(of="Brain", density_g_cm3=2.08))
    assert dense.mu_per_mm(70) == pytest.approx(2 * material("brain").mu_per_mm(70), rel=1e-12)
    assert dense.name == "brain of 2.08 g/cm3"


def test_bone_at_80_kev():
    assert material("bone").mu_per_mm(80) == pytest.approx(0.0428, abs=0.0003)
    assert material("bone").mass_fractions["Ca"] == pytest.approx(0.225)
    assert material("bone").mass_fractions["P"] == pytest.approx(0.103)


def test_every_named_material_attenuates():
    for name in material_names():
        found = material(name)
        assert sum(found.mass_fractions.values()) == pytest.approx(1, abs=1e-12)
        assert found.mu_per_mm(80) > 0


def test_formula_and_fractions_agree_with_the_named_material():
    by_formula = material(Composition(formula="H2O", density_g_cm3=1.0))
    by_shares = material(
        Composition(mass_fractions={"H": 0.111894, "O": 0.888106}, density_g_cm3=1.0)
    )
    water = material("Water, Liquid").mu_per_mm(80)
    assert by_formula.mu_per_mm(80) == pytest.approx(water, rel=3e-4)
    assert by_shares.mu_per_mm(80) == pytest.approx(water, rel=1e-9)


@pytest.mark.parametrize(("name", "symbol"), [("copper", "Cu"), ("Lead", "Pb"), ("gold", "Au")])
def test_a_metal_goes_by_its_name_as_by_its_symbol(name, symbol):
    assert material(name).mass_fractions == {symbol: 1.0}
    assert material(name).density_g_cm3 == material(symbol).density_g_cm3


def test_every_name_is_on_the_page():
    page = (Path(__file__).parents[2] / "docs" / "physics.md").read_text(encoding="utf-8")
    assert [name for name in (*BUILT_IN, *METALS) if f"`{name}`" not in page] == []


def test_density_scales_attenuation():
    thin = Material("thin", 1.0, {"Ti": 1.0})
    assert Material("thick", 3.0, {"Ti": 1.0}).mu_per_mm(50) == pytest.approx(
        3 * thin.mu_per_mm(50)
    )


def test_a_material_is_a_value():
    bone = material("bone")
    assert pickle.loads(pickle.dumps(bone)) == bone
    assert hash(bone) == hash(material("Bone"))
    with pytest.raises(TypeError):
        bone.mass_fractions["Ca"] = 1.0  # type: ignore[index]


@pytest.mark.parametrize(
    ("wanted", "words"),
    [
        ("titanum", ["'titanum'", "titanium", "formula", "specimen.parts.3.material"]),
        ("cortical", ["Bone, Cortical (ICRP)"]),
        ("unobtainium", ["unknown", "mass_fractions"]),
        (Composition(formula="Xy2", density_g_cm3=1), ["Xy2", "specimen.parts.3.material"]),
        (Composition(of="brian", density_g_cm3=1), ["specimen.parts.3.material: of", "brain"]),
        (
            Composition(mass_fractions={"Ti": 0.6, "Al": 0.3}, density_g_cm3=4),
            ["0.9", "add up to 1"],
        ),
        (Composition(mass_fractions={"ti": 1.0}, density_g_cm3=4), ["'ti'", "element"]),
    ],
)
def test_what_cannot_be_a_material_is_named(wanted, words):
    with pytest.raises(SpecimenError) as caught:
        material(wanted, "specimen.parts.3.material")
    for word in words:
        assert word in str(caught.value)


def test_energy_beyond_the_tables_is_refused():
    with pytest.raises(SpecimenError, match="5000 keV"):
        material("bone").mu_per_mm(5000)
