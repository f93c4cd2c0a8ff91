"""Anti-scatter grid: against rays through real strips, point by point, and published values."""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np
import pytest

from twinct.core.errors import InputError
from twinct.geometry import Panel, ScanGeometry, VolumeGrid
from twinct.specimen.materials import material
from twinct.transport import AntiScatterGrid, Beam, Detector, Simulation, VoxelBody

LEAD, ALUMINIUM, AIR = material("lead"), material("aluminium"), material("air")
FOCUS_MM = 1000.0


def grid(along: Literal["u", "v"] = "v", **keys: Any) -> AntiScatterGrid:
    """Return a common grid: 40 lines per cm, ratio 10, strips of 43 micrometres."""
    usual: dict[str, Any] = {"ratio": 10.0, "period_mm": 0.25, "strip_mm": 0.043}
    usual |= {"focus_mm": FOCUS_MM, "strip": LEAD, "space": ALUMINIUM}
    return AntiScatterGrid(along, **usual | keys)


def traced(one: AntiScatterGrid, energy: float, x: float, across: float, along: float) -> float:
    """Return the share that passes about a place, by rays through strips that meet at the focus.

    Every ray is followed in 400 steps through the height of the grid, and each step asks which
    strip or space it is in. Strips have their width at the panel.
    """
    rays, steps = 2000, 400
    start = x + (np.arange(rays) + 0.5) / rays * one.period_mm
    z = (np.arange(steps) + 0.5) / steps * one.height_mm
    # Back along the ray, from the panel up; a strip through (s, 0) is at s (1 - z / focus).
    at = (start[:, None] - across * z) / (1 - z / one.focus_mm)
    lead = np.mod(at, one.period_mm) < one.strip_mm
    length = one.height_mm * math.sqrt(1 + across**2 + along**2)
    space, strip = (float(m[0]) for m in one.attenuation(np.array([energy])))
    share = lead.mean(axis=1)
    return float(np.exp(-length * (strip * share + space * (1 - share))).mean())


@pytest.mark.parametrize("x", [0.0, 60.0, 200.0])
@pytest.mark.parametrize("off", [0.0, 0.01, 0.08, 0.3, 1.0])
@pytest.mark.parametrize("energy", [40.0, 100.0])
def test_transmission_is_that_of_rays_through_strips(x: float, off: float, energy: float) -> None:
    one = grid(strip=material("tin"))  # strips that let a part through
    tilt = x / FOCUS_MM
    found = one.transmission(np.array([energy]), tilt + off, 0.1, x)[0]
    # Strips that meet at the focus taper by 0.2 % at their top.
    assert float(found) == pytest.approx(
        traced(one, energy, x, tilt + off, 0.1), rel=0.01, abs=1e-4
    )


def test_parallel_strips_are_exact() -> None:
    one = grid(focus_mm=math.inf)
    for across in (1e-12, 0.013, 0.1, 0.21, 0.5, 2.0):
        found = one.transmission(np.array([80.0]), across, 0.3)[0]
        assert float(found) == pytest.approx(
            traced(one, 80.0, 0.0, across, 0.3), rel=2e-3, abs=2e-5
        )


def test_primary_transmission_and_cut_off_are_those_of_the_textbook() -> None:
    """On focus the spaces pass; off focus the loss is ratio times the lateral angle."""
    one = grid(space=AIR)
    on = one.transmission(np.array([60.0]), 0.0, 0.0)[0]
    assert float(on) == pytest.approx(1 - 0.043 / 0.25, rel=1e-3)
    # Shadow of black strips: ratio x lateral shift / focus, of the spaces (Bushberg et al.).
    shifted = one.transmission(np.array([30.0]), 30.0 / FOCUS_MM, 0.0)[0]
    assert float(shifted / on) == pytest.approx(1 - 10 * 30.0 / FOCUS_MM, abs=0.01)
    # With aluminium at the mean energy of 100 kV: 60 to 75 % (Bushberg et al., The Essential
    # Physics of Medical Imaging, table of grids of ratio 8 to 12).
    real = grid().transmission(np.array([60.0]), 0.0, 0.0)[0]
    assert 0.6 < float(real) < 0.75


def _radiograph(one: AntiScatterGrid | None) -> tuple[np.ndarray, np.ndarray]:
    """Return primary and scatter behind 200 mm of water at 60 keV."""
    box = VolumeGrid((20, 30, 30), 10.0)
    body = VoxelBody.of_labels(box, np.ones(box.shape, np.uint8), {1: material("water")})
    source, panel = np.array([[0.0, 0.0, 880.0]]), np.array([[0.0, 0.0, -120.0]])
    u, v = np.array([[1.0, 0.0, 0.0]]), np.array([[0.0, 1.0, 0.0]])
    geometry = ScanGeometry(source, panel, u, v, Panel(5, 5, 60.0, 60.0))
    simulation = Simulation(
        body, Beam.of_view(geometry, 0, 60.0), dose=False, detector=Detector(geometry, grid=one)
    )
    scatter, _ = simulation.run(20_000, 4, seed=5).scatter()
    return simulation.primary(2), scatter


def test_a_grid_holds_scatter_back_and_lets_the_primary_beam_pass() -> None:
    """Bucky factor and selectivity behind 20 cm of water lie where those of real grids do."""
    free, behind = _radiograph(None), _radiograph(grid())
    primary = behind[0][2, 2] / free[0][2, 2]
    scatter = behind[1].sum(0)[2, 2] / free[1].sum(0)[2, 2]
    bucky = (free[0][2, 2] + free[1].sum(0)[2, 2]) / (behind[0][2, 2] + behind[1].sum(0)[2, 2])
    assert 0.6 < primary < 0.75
    assert 0.05 < scatter < 0.2
    assert 3.0 < bucky < 8.0  # Bushberg et al.: 3 to 8 in abdominal radiography


def test_a_grid_of_one_direction_is_that_of_the_other_turned() -> None:
    """Strips along u: rows and columns change places, in primary and scatter."""
    one, other = _radiograph(grid("u", focus_mm=700.0)), _radiograph(grid("v", focus_mm=700.0))
    np.testing.assert_allclose(one[0], other[0].T, rtol=1e-9)
    assert one[1].sum() == pytest.approx(other[1].sum(), rel=0.03)
    # Off its focus the grid cuts off the sides, not the ends of its strips.
    assert one[0][0, 2] < 0.7 * one[0][2, 0]


def test_impossible_grids_are_refused() -> None:
    with pytest.raises(InputError, match=r"strips of 0.3 mm must be narrower than the period"):
        grid(strip_mm=0.3)
    with pytest.raises(InputError, match="ratio 0"):
        grid(ratio=0.0)
