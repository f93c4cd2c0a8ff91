"""Scatter that a first volume explains is subtracted from images of any origin."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from twinct import simulate
from twinct.core.errors import InputError
from twinct.geometry import VolumeGrid
from twinct.recon.sections.scatter import ScatterCorrection
from twinct.runs import reconstruct
from twinct.runs.scatter_correction import _shares, check_scatter_correction
from twinct.scenario import parse_scenario
from twinct.scenario.imported import ImportedSettings
from twinct.specimen.materials import material
from twinct.transport import VoxelBody

BALL: dict[str, Any] = {
    "name": "ball",
    "cell": {"kind": "gantry"},
    "xray": {"engine": "mesh"},
    "trajectory": {"kind": "circle", "views": 24, "sod_mm": 600, "sdd_mm": 1000},
    "detector": {"rows": 30, "columns": 30, "pixel_pitch_mm": 8.0, "pixel_samples": 2},
    "source": {"energy_kev": 70.0},
    "specimen": {
        "parts": [
            {"name": "water", "shape": {"kind": "sphere", "radius_mm": 60}, "material": "water"},
            {
                "name": "bone",
                "shape": {"kind": "cylinder", "radius_mm": 12, "height_mm": 60},
                "material": "bone",
                "position_mm": [25, 0, 0],
            },
        ]
    },
    "reconstruction": {"algorithm": "sart", "grid": {"voxels": 36, "voxel_mm": 4.0}},
}
SCATTER = {"kind": "monte_carlo", "photons": 20_000, "views": 4, "voxel_mm": 6.0, "pixel_mm": 40.0}
CORRECTION = {**SCATTER, "tissue": "water", "rounds": 2}


def test_scatter_of_a_ball_is_subtracted() -> None:
    """Water is as dense after the correction as without scatter, and was not before."""
    clean = simulate(parse_scenario(BALL))
    detector = BALL["detector"] | {"scatter": SCATTER}
    scan = simulate(parse_scenario(BALL | {"detector": detector}))
    primary, before = (reconstruct(one).array for one in (clean, scan))
    after = reconstruct(scan, scatter=CORRECTION).array
    x, y, z = reconstruct(clean).grid.axes()
    radius = np.sqrt(x**2 + y[:, None] ** 2 + z[:, None, None] ** 2)
    water = (radius < 45) & np.broadcast_to(np.hypot(x - 25, y[:, None]) > 24, radius.shape)
    mu = material("water").mu_per_mm(70.0)
    errors = [np.sqrt(((one - primary)[water] ** 2).mean()) / mu for one in (before, after)]
    assert errors[0] > 0.04
    assert errors[1] < 0.25 * errors[0]


def test_attenuation_becomes_a_mixture() -> None:
    """Up to tissue at a part of its density, between a mixture, beyond more of the dense one."""
    tissue, dense = material("water"), material("bone")
    low, high = tissue.mu_per_mm(60.0), dense.mu_per_mm(60.0)
    mu = np.array([-0.01, low / 10, low / 2, low, (low + high) / 2, high, 2 * high], np.float32)
    grid = VolumeGrid((1, 1, 7), 10.0)
    shares = _shares(mu.reshape(grid.shape), tissue, dense, 60.0)
    body = VoxelBody.of_shares(grid, list(zip((tissue, dense), shares, strict=True)))
    density = body.palette_densities[body.codes].ravel()
    bone = dense.density_g_cm3
    expected = [0, 0, 0.5, 1, (1 + bone) / 2, bone, 2 * bone]
    np.testing.assert_allclose(density, expected, rtol=0.01)
    media = [body.materials[n] for n in body.palette_media[body.codes].ravel()]
    attenuations = [
        one.mu_per_mm(60.0) / one.density_g_cm3 * d for one, d in zip(media, density, strict=True)
    ]
    np.testing.assert_allclose(attenuations, [0, 0, *mu[2:]], rtol=0.03)


def test_what_a_correction_needs_is_named() -> None:
    """A beam, energies in the tables, and a dense material that attenuates more."""
    measured = ImportedSettings.model_validate({"reconstruction": {"scatter": CORRECTION}})
    with pytest.raises(InputError, match=r"reconstruction\.scatter: it needs the beam"):
        check_scatter_correction(measured)
    known = measured.model_copy(update={"source": parse_scenario(BALL).source})
    check_scatter_correction(known)
    reconstruction = {"reconstruction": {"scatter": CORRECTION | {"tissue": "bone"}}}
    with pytest.raises(InputError, match=r"scatter\.dense: bone attenuates .* must exceed tissue"):
        check_scatter_correction(parse_scenario(BALL | reconstruction))
    fast = {"source": {"energy_kev": 300.0}, "reconstruction": {"scatter": CORRECTION}}
    with pytest.raises(InputError, match="photons of 300 keV"):
        check_scatter_correction(parse_scenario(BALL | fast))
    assert ScatterCorrection(kind="monte_carlo").rounds == 2
