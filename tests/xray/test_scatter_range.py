"""Warnings where the scatter kernel's error is unknown, or larger than the page states."""

import re

import numpy as np
import pytest

from twinct.runs.checks import check_sight
from twinct.scan import SimulationBuilder
from twinct.scenario import parse_scenario
from twinct.specimen.materials import material
from twinct.xray.scatter import ScatterKernel, compton_per_mm
from twinct.xray.scatter_range import MOST_DEPTH, scatter_loads

WATER = material("water")
KEV, SOD, SDD = 80.0, 300.0, 600.0
COARSE = 0.005
"""Of a ball's diameter: the mesh lies inside the ball, and no ray meets its middle exactly."""


def scan(radius: float, panel_mm: float, **keys) -> SimulationBuilder:
    pixels = 32
    detector = {"columns": pixels, "rows": pixels, "pixel_pitch_mm": panel_mm / pixels}
    ball = {"kind": "sphere", "radius_mm": radius, "mesh_resolution_mm": 4}
    data = {
        "cell": {"kind": "gantry"},
        "xray": {"engine": "mesh"},
        "trajectory": {"kind": "circle", "views": 3, "sod_mm": SOD, "sdd_mm": SDD},
        "source": {"energy_kev": KEV},
        "detector": {**detector, "scatter": {"kind": "kernel"}},
        "specimen": {"parts": [{"shape": ball, "material": "water"}]},
        "reconstruction": {"grid": {"voxels": 16, "voxel_mm": 10}},
    }
    return SimulationBuilder(parse_scenario(data | keys))


def doubts(builder: SimulationBuilder) -> list[str]:
    return [one for one in check_sight(builder) if one.startswith("detector.scatter")]


def shadow_mm(radius: float) -> float:
    return 2 * SDD * radius / np.sqrt(SOD**2 - radius**2)


def missing_by_hand(radius: float, panel_mm: float) -> float:
    """Share of the scatter on the panel from rays beside it, from chords of the ball."""
    pitch, pixels = 4.0, 301
    x = (np.arange(pixels) - pixels // 2) * pitch
    r = np.hypot(x[None], x[:, None])
    chords = 2 * np.sqrt(np.maximum(radius**2 - (SOD * r / np.hypot(r, SDD)) ** 2, 0))
    beam = (1 + r**2 / SDD**2) ** -1.5 * np.exp(-WATER.mu_per_mm(KEV) * chords)
    scattered = (beam * compton_per_mm(WATER, KEV) * chords).astype(np.float32)
    on = np.ix_(np.abs(x) < panel_mm / 2, np.abs(x) < panel_mm / 2)
    inside = np.zeros_like(scattered)
    inside[on] = scattered[on]
    own, every = (
        ScatterKernel(KEV).spread(one, pitch, pitch, SDD - SOD)[on].sum()
        for one in (inside, scattered)
    )
    return 1 - own / every


@pytest.mark.parametrize("radius", [25.0, 50.0, 100.0])
def test_the_depth_is_that_of_the_ray_through_the_middle(radius):
    builder = scan(radius, 1.2 * shadow_mm(radius))
    for load in scatter_loads(KEV, builder.specimen, builder.commanded):
        assert load.depth == pytest.approx(2 * radius * compton_per_mm(WATER, KEV), rel=COARSE)
        assert load.beside == 0


@pytest.mark.parametrize(("radius", "share"), [(50.0, 0.9), (50.0, 0.7), (100.0, 0.72)])
def test_scatter_from_rays_beside_the_panel_is_known(radius, share):
    panel_mm = share * shadow_mm(radius)
    builder = scan(radius, panel_mm)
    (load, *_) = scatter_loads(KEV, builder.specimen, builder.commanded)
    # Lattices of 20 and 4 mm: the panel's edge lies up to half a cell off in the second one.
    assert load.beside == pytest.approx(missing_by_hand(radius, panel_mm), abs=0.03)


def test_a_scan_within_the_range_is_not_doubted():
    assert doubts(scan(50.0, 1.1 * shadow_mm(50.0))) == []
    assert doubts(scan(100.0, 1.1 * shadow_mm(100.0))) == []
    free = {"columns": 32, "rows": 32, "pixel_pitch_mm": 2}
    assert doubts(scan(100.0, 100.0, detector=free)) == []  # without scatter


def test_a_panel_that_cuts_the_body_is_named():
    """The ball of 100 mm on 305 mm of panel: 52 % too low, for the rays beside the panel."""
    (one,) = doubts(scan(100.0, 305.0))
    assert "the body is wider than the panel" in one
    assert re.search(r"4[123] % of the scatter \(view \d\)", one)


def test_too_deep_a_body_is_named():
    radius = 1.05 * MOST_DEPTH / compton_per_mm(WATER, KEV) / 2
    (one,) = doubts(scan(radius, 1.1 * shadow_mm(radius)))
    assert "the Compton optical depth reaches 3.7 (view" in one
    assert "is known up to 3.5, where scatter is up to 25 % wrong" in one


def test_too_low_an_energy_is_named():
    (one,) = doubts(scan(25.0, 1.1 * shadow_mm(25.0), source={"energy_kev": 35.0}))
    assert "the mean photon energy is 35 keV" in one and "from 40 keV on" in one
