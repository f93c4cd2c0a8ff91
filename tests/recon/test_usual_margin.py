"""Margin of the coarse grids of ``fast``."""

import numpy as np
import pytest

from twinct.core.errors import InputError
from twinct.geometry import Panel, Pose, VolumeGrid
from twinct.recon import Projector
from twinct.recon.moving import MovingProjector
from twinct.recon.usual_margin import usual_margin
from twinct.specimen.deformation import Deformation

FACTOR = 4
"""Factor of the largest voxels."""


@pytest.fixture
def scan(circle, ellipsoid_integrals):
    """A maker of scans of a body in a grid of 48 mm and others, by a panel that sees 96 mm."""

    def make(*others, panel=96, sod=200.0):
        geometry = circle(60, Panel(panel, panel, 2.0, 2.0), sod=sod, sdd=2 * sod)
        bodies = ((4, -3, 2), (9, 7, 11)), *others
        p = sum(ellipsoid_integrals(geometry, *body) for body in bodies)
        return Projector(geometry, VolumeGrid((48, 48, 48), 1.0)), p

    return make


def ending(reach):
    """Return centre and semi-axes of a body that ends so many mm beyond the grid."""
    return (0, 24 + reach - 8, 0), (16, 8, 16)


@pytest.mark.parametrize(("reach", "margin"), [(-4, 0.0), (4, 0.1), (9, 0.2), (14, 0.3), (18, 0.3)])
def test_it_ends_where_the_object_ends(scan, reach, margin):
    """A body ends ``reach`` mm beyond the grid; a tenth of the grid is 4.8 mm, 0.3 the most."""
    A, p = scan(ending(reach))
    assert usual_margin(A, p, None, FACTOR) == margin


def test_it_is_narrow_if_the_panel_cuts_the_object(scan):
    """No ray tells apart what lies beyond all of them."""
    A, p = scan(((0, 0, 0), (34, 34, 34)), panel=54)
    assert usual_margin(A, p, None, FACTOR) == 0.1


def test_it_is_the_same_for_a_body_that_could_move(scan):
    A, p = scan(ending(9))
    still = Deformation(lambda points: 0.0 * points, Pose.identity())
    moving = MovingProjector(A.geometry, A.grid, [still] * len(A))
    assert usual_margin(moving, p, None, FACTOR) == 0.2


@pytest.mark.parametrize("of_each_view", [False, True])
def test_dead_pixels_do_not_count(scan, of_each_view):
    A, p = scan(ending(9))
    mask = np.random.default_rng(1).random(p.shape if of_each_view else p.shape[1:]) > 0.05
    mask[..., 40:60, 40:56] = False  # larger pixels without any that counts
    p = np.where(mask, p, np.float32(30))
    assert usual_margin(A, p, mask, FACTOR) == 0.2


def test_it_stays_in_front_of_the_sources(scan):
    for sod, margin in ((60.0, 0.3), (54.0, 0.2), (48.0, 0.1)):
        assert usual_margin(*scan(ending(14), sod=sod), None, FACTOR) == margin
    A, p = scan(ending(14), sod=42.0)
    with pytest.raises(
        InputError, match=r"with a margin of 0\.1 .* behind .* \(reconstruction\.margin\), or 0"
    ):
        usual_margin(A, p, None, FACTOR)
