"""Metal in the way of a region, against lengths that are known."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from twinct.geometry import Panel, Pose, ScanGeometry
from twinct.planning import metal_paths, starved_share
from twinct.shadow import Body
from twinct.trajectory import panel_axes

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
