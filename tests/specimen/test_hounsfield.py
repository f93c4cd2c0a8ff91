"""Amounts of basis materials from HU: the attenuation of tissues that the line does not hold."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from twinct import scenario
from twinct.specimen.hounsfield import EFFECTIVE_KEV, TISSUES, hu_of, line_of, tissue_line
from twinct.specimen.materials import BUILT_IN, Material, material
from twinct.xray.tube import tube_spectrum

ENERGIES = np.arange(60.0, 121.0, 10.0)


def tissue(density: float, **percent: float) -> Material:
    return Material("tissue", density, {s: share / 100 for s, share in percent.items()})


# ICRU Report 44, as in Hubbell and Seltzer, NISTIR 5632, table 2.
SOFT = {
    "adipose": tissue(0.95, H=11.4, C=59.8, N=0.7, O=27.8, Na=0.1, S=0.1, Cl=0.1),
    "breast": tissue(1.02, H=10.6, C=33.2, N=3.0, O=52.7, Na=0.1, P=0.1, S=0.2, Cl=0.1),
    "muscle": tissue(1.05, H=10.2, C=14.3, N=3.4, O=71.0, Na=0.1, P=0.2, S=0.3, Cl=0.1, K=0.4),
    "blood": tissue(
        1.06, H=10.2, C=11.0, N=3.3, O=74.5, Na=0.1, P=0.1, S=0.2, Cl=0.3, K=0.2, Fe=0.1
    ),
    "brain": BUILT_IN["brain"],
    "eye lens": BUILT_IN["eye_lens"],
    "soft tissue": BUILT_IN["soft_tissue"],
    "water": BUILT_IN["water"],
    "lung": tissue(0.26, H=10.3, C=10.5, N=3.1, O=74.9, Na=0.2, P=0.2, S=0.3, Cl=0.3, K=0.2),
    "collapsed lung": tissue(
        1.05, H=10.3, C=10.5, N=3.1, O=74.9, Na=0.2, P=0.2, S=0.3, Cl=0.3, K=0.2
    ),
}
# ICRU Report 44, after Woodard and White, Br. J. Radiol. 59 (1986) 1209.
BONES = {
    "spongiosa": tissue(
        1.18, H=8.5, C=40.4, N=2.8, O=36.7, Na=0.1, Mg=0.1, P=3.4, S=0.2, Cl=0.2, K=0.1, Ca=7.4,
        Fe=0.1,
    ),
    "cranium": tissue(1.61, H=5.0, C=21.2, N=4.0, O=43.5, Na=0.1, Mg=0.2, P=8.1, S=0.3, Ca=17.6),
    "vertebra C4": tissue(
        1.42, H=6.3, C=26.1, N=3.9, O=43.6, Na=0.1, Mg=0.1, P=6.1, S=0.3, Cl=0.1, K=0.1, Ca=13.3
    ),
    "vertebra D6": tissue(
        1.33, H=7.0, C=28.7, N=3.8, O=43.7, Mg=0.1, P=5.1, S=0.2, Cl=0.1, K=0.1, Ca=11.1, Fe=0.1
    ),
}  # fmt: skip


@cache
def scanner(kv: int, water_mm: float = 250.0) -> Callable[[Material], float]:
    """HU of a little of a material in water, with the whole spectrum of a scanner."""
    tube = tube_spectrum(kv, 8.0)
    energies, photons = (
        array[tube.energies_kev > 15] for array in (tube.energies_kev, tube.photons)
    )

    def mu(substance: Material) -> np.ndarray:
        return np.array([substance.mu_per_mm(e) for e in energies])

    before = 6.0 * mu(material("Al")) + 0.9 * mu(material("Ti")) + water_mm * mu(BUILT_IN["water"])
    weight = photons * energies * np.exp(-before)

    def hu(substance: Material) -> float:
        return 1000 * ((weight @ mu(substance)) / (weight @ mu(BUILT_IN["water"])) - 1)

    return hu


def worst(kv: int, tissues: dict[str, Material]) -> dict[str, float]:
    """Largest relative error of mu from 60 to 120 keV, by tissue."""
    section = scenario.Tissues.model_validate({"kind": "tissues", "kv": kv})
    line, errors = line_of(section, "calibration"), {}
    for name, one in tissues.items():
        hu = np.array(scanner(kv)(one))
        ratio = [line.mu_per_mm(hu, float(e)) / one.mu_per_mm(float(e)) for e in ENERGIES]
        errors[name] = float(np.abs(np.array(ratio) - 1).max())
    return errors


@pytest.mark.parametrize("kv", [80, 100, 120, 140])
def test_mu_of_other_tissues(kv: int, figure: Callable[[str], None]) -> None:
    soft, bones = worst(kv, SOFT), worst(kv, BONES)
    for kind, errors in (("soft", soft), ("bone", bones)):
        name = max(errors, key=lambda n: errors[n])
        figure(f"{kv} kV, {kind}: at most {100 * errors[name]:.2f} %, {name}")
    assert max(soft.values()) <= 0.02
    assert max(bones.values()) <= 0.05


def test_energy_of_a_tube_voltage() -> None:
    """Cortical bone has the HU of the whole spectrum at the stated energy."""
    for kv, energy in EFFECTIVE_KEV.items():
        at_energy = hu_of(BUILT_IN["bone"], energy)
        assert at_energy == pytest.approx(scanner(kv)(BUILT_IN["bone"]), abs=5), kv


def test_tissues_have_the_hu_of_schneider() -> None:
    """Table 1 of Schneider et al. (120 kV): HU of the tissues by their scanner's parameters."""
    told = {"adipose tissue": -98, "adrenal gland": 14, "small intestine": 23}
    told |= {"connective tissue": 100, "cortical bone": 1524}
    for name, hu in told.items():
        within = 0.01 * (1000 + hu)
        assert hu_of(TISSUES[name], EFFECTIVE_KEV[120]) == pytest.approx(hu, abs=within), name


def test_hu_are_attenuation_at_the_energy() -> None:
    """At the scanner's energy, mu is (1 + HU / 1000) times that of water, whatever the tissue."""
    line, water = tissue_line(71.6), BUILT_IN["water"].mu_per_mm(71.6)
    hu = np.linspace(-1000, 2500, 701)
    assert line.mu_per_mm(hu, 71.6) / water == pytest.approx(1 + hu / 1000, abs=3e-4)
    assert not line(np.array([-2048.0, -1000.0])).any()
    assert (line(hu) >= 0).all()


def calibration(**keys: object) -> scenario.Calibration:
    return TypeAdapter(scenario.Calibration).validate_python(keys)


def test_own_table() -> None:
    rows = [
        {"hu": -1000, "density_g_cm3": 0, "material": "water"},
        {"hu": 0, "density_g_cm3": 1.0, "material": "water"},
        {"hu": 1000, "density_g_cm3": 1.92, "material": "bone"},
    ]
    line = line_of(calibration(kind="table", rows=rows), "calibration")
    assert [m.name for m in line.materials] == ["water", "bone"]
    amounts = line(np.array([-2000.0, -500.0, 0.0, 250.0, 1000.0, 3000.0]))
    assert amounts == pytest.approx(
        np.array([[0, 0], [0.5, 0], [1, 0], [0.75, 0.25], [0, 1], [0, 2]]), abs=1e-6
    )
    assert line.nothing_hu == -1000
    with pytest.raises(ValidationError, match="HU must rise"):
        calibration(kind="table", rows=rows[::-1])


def test_curve_of_electron_density() -> None:
    """A scanner that shows 10 % more contrast, and 20 HU more, still gives the right tissues."""
    line = tissue_line(EFFECTIVE_KEV[120])
    names = "adipose tissue", "small intestine", "cortical bone"
    electrons = {"adipose tissue": 0.929, "small intestine": 1.026, "cortical bone": 1.780}
    shown = {n: 1.1 * hu_of(TISSUES[n], EFFECTIVE_KEV[120]) + 20 for n in names}
    points = [[-980.0, 0.0], *([shown[n], electrons[n]] for n in names)]
    curve = line_of(calibration(kind="electron_density", points=points), "calibration")
    for name in names:
        right = line.mu_per_mm(np.array(hu_of(TISSUES[name], EFFECTIVE_KEV[120])), 80.0)
        assert curve.mu_per_mm(np.array(shown[name]), 80.0) == pytest.approx(right, rel=0.004), name
