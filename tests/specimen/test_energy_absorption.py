"""Energy absorption of materials, by which dose is computed, against tables."""

from __future__ import annotations

import pytest

from twinct.specimen.materials import material


@pytest.mark.parametrize(
    ("kev", "water", "bone"),
    [
        # J. H. Hubbell, S. M. Seltzer, NISTIR 5632, table 4: liquid water, cortical bone (ICRU 44).
        (30.0, 0.1557, 1.069),
        (60.0, 0.03190, 0.1400),
        (100.0, 0.02546, 0.04585),
    ],
)
def test_energy_absorption_is_that_of_the_tables(kev, water, bone) -> None:
    """Within 1.5 %: coherent scatter, fluorescence and binding are small."""
    assert material("water").absorption_cm2_g(kev) == pytest.approx(water, rel=0.015)
    assert material("bone").absorption_cm2_g(kev) == pytest.approx(bone, rel=0.02)
