"""AAPM Task Group report 195 (Sechopoulos et al., Med. Phys. 42 (2015) 5679), in a few seconds.

``benchmarks/bench_tg195.py`` compares every entry.
"""

import numpy as np
import pytest
from transport_bodies import view

from twinct.geometry import Panel, VolumeGrid
from twinct.specimen.materials import Material, material
from twinct.transport import Beam, Detector, Simulation, VoxelBody

_PERCENT = {"H": 10.5, "C": 25.6, "N": 2.7, "O": 60.2, "Na": 0.1, "P": 0.2, "S": 0.3}
SOFT = Material(
    "soft tissue", 1.03, {s: p / 100 for s, p in (_PERCENT | {"Cl": 0.2, "K": 0.2}).items()}
)


@pytest.mark.parametrize("degrees, median_ev", [(0.0, 33172.85), (15.0, 30876.25)])
def test_slab_of_soft_tissue_absorbs_what_four_codes_say(degrees: float, median_ev: float) -> None:
    """Case 2 at 56.4 keV: the energy in the whole slab is the median of the codes."""
    grid = VolumeGrid((4, 39, 39), [10.0, 10.0, 50.0])
    body = VoxelBody.of_labels(grid, np.zeros(grid.shape, int), {0: SOFT}, material("air"))
    source = (0.0, -1800 * np.tan(np.radians(degrees)), -1650.0)
    beam = Beam(source, (0, 0, 150), (195, 0, 0), (0, 195, 0), 56.4)
    scores = Simulation(body, beam, dose=False).run(10_000, 20, seed=2)
    (energy,), (error,) = scores.label_energy()
    assert error / energy < 0.003
    # Three standard errors; the codes differ by 0.2 %.
    assert energy * 1000 == pytest.approx(median_ev, rel=0.009)


@pytest.mark.parametrize(
    "energy_kev, layer_mm, median", [(30.0, 2.273, 0.50041), (100.0, 15.11, 0.49907)]
)
def test_half_value_layers_halve_the_beam(
    energy_kev: float, layer_mm: float, median: float
) -> None:
    """Case 1: the transmission of a layer of aluminium, with the air that it replaces."""
    signals = []
    grid = VolumeGrid((1, 1, 1), [50.0, 50.0, layer_mm])
    geometry = view((0, 0, 100), (0, 0, -900), panel=Panel(1, 1, 1.0, 1.0))
    for name in ("air", "aluminium"):
        body = VoxelBody.of_labels(
            grid, np.zeros(grid.shape, int), {0: material(name)}, material("air")
        )
        beam = Beam.of_view(geometry, 0, energy_kev)
        image = Simulation(body, beam, dose=False, detector=Detector(geometry)).primary()
        signals.append(float(image[0, 0]))
    # The report's bins end at these energies; the codes differ by 0.1 %.
    assert signals[1] / signals[0] == pytest.approx(median, rel=0.002)
