"""Metal in the way of a region, against lengths that are known."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from twinct.geometry import Panel, Pose, ScanGeometry, VolumeGrid
from twinct.rays import Body
from twinct.recon import Projector
from twinct.trajectory import panel_axes
from twinct.view_planning import metal_paths, spectral_shift, starved_share
from twinct.view_planning.objectives.metal_paths import lengths_in_metal, metal_lengths

FACETS = 0.01
"""A cylinder of 64 sides is this much thinner at most, as a share."""

TOWARDS = np.array([[1.0, 0, 0], [0, 1.0, 0], [np.sqrt(0.5), np.sqrt(0.5), 0]])
GEOMETRY = ScanGeometry(
    300 * TOWARDS, -300 * TOWARDS, *panel_axes(TOWARDS), Panel(121, 161, 1.0, 1.0)
)


@pytest.fixture
def screw():
    """A cylinder of 40 mm along y, 4 mm across."""
    mesh = trimesh.creation.cylinder(radius=2, height=40, sections=64)
    return Body(mesh.vertices, mesh.faces), Pose.from_euler((0, 0, 0), (90, 0, 0))


def test_a_screw_is_as_long_as_the_view_sees_it(screw) -> None:
    across, along, slanted = metal_paths(GEOMETRY, [screw], [[0.0, 0, 0]])
    assert across == pytest.approx(4, rel=FACETS)
    assert along == pytest.approx(40, rel=FACETS)
    assert slanted == pytest.approx(4 * np.sqrt(2), rel=FACETS)


def test_what_lies_beside_the_metal_is_seen_past_it(screw) -> None:
    body, pose = screw
    moved = Pose.from_euler((0, 0, 12), (0, 0, 0)) @ pose
    points = [[0.0, 0, 0], [0.0, 0, 12]]  # one below the screw, one in it
    across, along, _ = metal_paths(GEOMETRY, [(body, moved)], points)
    # Along y the upper ray climbs by 4 % and leaves the screw's 2 mm nowhere within its 20 mm.
    assert across == pytest.approx(2, rel=2 * FACETS)
    assert along == pytest.approx(20, rel=2 * FACETS)
    assert metal_paths(GEOMETRY, [(body, moved)], points[:1]) == pytest.approx(0)


def test_a_view_that_sees_nothing_of_the_region_says_nothing(screw) -> None:
    found = metal_paths(GEOMETRY, [screw], [[0.0, 70, 0]])  # seen along y alone
    assert np.isnan(found[[0, 2]]).all() and found[1] == pytest.approx(40, rel=FACETS)


def test_starved_rays_are_those_of_the_region() -> None:
    photons = np.full((3, 121, 161), 1000.0)
    photons[1, 60, 80] = 3
    photons[2] = 3
    photons[2, 60, 80] = 1000
    points = [[0.0, 0, 0], [0.0, 0, 10]]
    assert starved_share(GEOMETRY, photons, points, 10).tolist() == [0, 0.5, 0.5]


def test_metal_of_a_volume_is_as_long_as_its_mesh(screw) -> None:
    """Voxels of 0.5 mm of the same screw: half of one more or less at each end."""
    grid, points = VolumeGrid((24, 100, 24), 0.5), [[0.0, 0, 0], [0.0, 12, 0]]
    z, y, x = np.meshgrid(*grid.axes()[::-1], indexing="ij")
    there = (x * x + z * z < 4) & (abs(y) < 20)
    seen = lengths_in_metal(Projector(GEOMETRY, grid), there, points)
    for of_volume, of_mesh in zip(seen, metal_lengths(GEOMETRY, [screw], points), strict=True):
        assert of_volume == pytest.approx(of_mesh, abs=0.5)


def test_a_beam_of_two_energies_shifts_as_its_formula_says() -> None:
    mu, lengths = np.array([[0.5, 0.2]]), np.array([[0.0, 1e-3, 10.0]])
    none, thin, thick = spectral_shift(lengths, mu, [3.0, 1.0])
    assert none == pytest.approx(0, abs=1e-12)
    variance = 0.75 * 0.25 * 0.3**2
    assert thin == pytest.approx(variance * 1e-6 / 2, rel=1e-2)  # the first term of its series
    assert thick == pytest.approx(4.25 + np.log(0.75 * np.exp(-5) + 0.25 * np.exp(-2)))
    assert spectral_shift(lengths, [[0.3]], [1.0]) == pytest.approx(0, abs=1e-12)
