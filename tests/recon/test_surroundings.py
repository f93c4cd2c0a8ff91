"""Truncation: a body beyond the grid, seen by some views."""

import numpy as np
import pytest

from twinct.core.errors import InputError
from twinct.evaluation import region_of_interest
from twinct.geometry import Panel, Pose, VolumeGrid
from twinct.recon import Projector, cgls, sart, without_surroundings
from twinct.recon.resolution import interpolated
from twinct.recon.signs_beyond import signs_beyond

pytestmark = pytest.mark.usefixtures("engine")

AROUND = {"margin_mm": 30.0, "voxel_mm": 4.0, "iterations": 6}


@pytest.fixture
def truncated(circle, ellipsoid_integrals):
    """A ball in the grid, and two bodies that stick out of it or lie outside."""
    geometry = circle(60, Panel(60, 64, 2.0, 2.0))
    grid = VolumeGrid((40, 40, 40), 1.0, Pose((2, 1, 0), (0, 0, 0, 1)))
    inside = [((4, -3, 2), (7, 7, 7))]
    outside = [((28, 8, 0), (13, 9, 20)), ((-6, -34, 10), (12, 8, 9))]
    p = sum(ellipsoid_integrals(geometry, *body) for body in inside + outside)
    x, y, z = (axis + shift for axis, shift in zip(grid.axes(), (2, 1, 0), strict=True))
    truth = np.zeros(grid.shape, np.float32)
    for (cx, cy, cz), (a, b, c) in inside + outside:
        square = (((z - cz) / c) ** 2)[:, None, None] + (((y - cy) / b) ** 2)[:, None]
        truth[square + ((x - cx) / a) ** 2 <= 1] = 1
    return geometry, grid, p, truth, region_of_interest(geometry, grid)


@pytest.mark.parametrize("algorithm", ["sart", "cgls"])
def test_error_falls_where_every_view_sees(algorithm, truncated):
    geometry, grid, p, truth, region = truncated
    assert 0.2 < region.mean()
    A = Projector(geometry, grid)
    rest = without_surroundings(A, p, **AROUND)

    def error(projections):
        volume = (
            sart(A, projections, iterations=6, relaxation=0.3)
            if algorithm == "sart"
            else cgls(A, projections, iterations=10)
        )
        return np.sqrt(np.mean((volume.array - truth)[region] ** 2))

    assert error(rest) < 0.3 * error(p)  # measured 0.18 and 0.20


def test_nothing_outside_leaves_the_line_integrals_nearly_alone(circle, ellipsoid_integrals):
    geometry = circle(60, Panel(60, 64, 2.0, 2.0))
    grid = VolumeGrid((40, 40, 40), 1.0)
    p = ellipsoid_integrals(geometry, (4, -3, 2), (9, 9, 9))
    rest = without_surroundings(Projector(geometry, grid), p, **AROUND)
    # The coarse volume blurs the ball a little, and some of the blur lies outside.
    assert np.abs(rest - p).max() < 0.1 * p.max()


def test_masked_pixels_have_no_influence(truncated):
    geometry, grid, p, _, _ = truncated
    mask = np.ones(p.shape, np.bool_)
    mask[:, :, 20] = mask[3:5] = False
    lost = np.where(mask, p, np.nan)
    A = Projector(geometry, grid)
    rest = without_surroundings(A, lost, mask=mask, **AROUND)
    np.testing.assert_array_equal(
        rest, without_surroundings(A, np.where(mask, p, 9), mask=mask, **AROUND)
    )
    assert not rest[~mask].any()
    whole = without_surroundings(A, p, **AROUND)
    assert np.abs(rest - whole)[mask].max() < 0.15 * p.max()


def test_few_views_need_to_know_what_the_grid_holds(circle, ellipsoid_integrals):
    """Nine views make a poor coarse volume; of what a known ball leaves they make a good one."""
    grid = VolumeGrid((40, 40, 40), 1.0)
    A = Projector(circle(9, Panel(60, 64, 2.0, 2.0)), grid)
    x, y, z = grid.axes()
    ball = 4 * ((z**2)[:, None, None] + (y**2)[:, None] + x**2 <= 12**2).astype(np.float32)
    p = inside = 4 * ellipsoid_integrals(A.geometry, (0, 0, 0), (12, 12, 12))
    for centre, radii in (((33, 8, 0), (12, 9, 20)), ((-6, -34, 10), (12, 12, 9))):
        p = p + ellipsoid_integrals(A.geometry, centre, radii)
    keys = {"margin_mm": 30.0, "voxel_mm": 4.0}
    kept = [without_surroundings(A, p, **keys, expected=known) for known in (None, ball)]
    plain, told = (float(np.sqrt(np.mean((rest - inside) ** 2))) for rest in kept)
    assert told < 0.75 * plain  # measured 0.65; the rest are the borders of what lies around
    with pytest.raises(InputError, match="expected has shape"):
        without_surroundings(A, p, **keys, expected=ball[1:])


def test_coarse_planes_include_the_borders_of_the_grid():
    grid = VolumeGrid((50, 40, 30), (1.0, 1.1, 0.9))
    coarse = grid.with_voxels(4.0, 11.0)
    margin = (coarse.size_mm - grid.size_mm) / 2
    assert (margin >= 11.0).all()
    np.testing.assert_allclose(margin / coarse.voxel, np.round(margin / coarse.voxel), atol=1e-9)
    np.testing.assert_allclose(grid.size_mm / coarse.voxel, [8, 11, 11], atol=1e-9)


def test_wrong_arguments_are_named(truncated):
    geometry, grid, p, _, _ = truncated
    A = Projector(geometry, grid)
    with pytest.raises(InputError) as caught:
        without_surroundings(A, p[1:], margin_mm=0, voxel_mm=float("nan"))
    assert len(caught.value.problems) == 3
    with pytest.raises(InputError, match="margin_mm 190, the grid reaches .* behind the source"):
        without_surroundings(A, p, margin_mm=190, voxel_mm=10)


def test_margins_may_differ_from_side_to_side():
    place = Pose.from_euler((5, -3, 2), (10, 20, 30))
    grid = VolumeGrid((50, 40, 30), (1.0, 1.1, 0.9), place)
    below, above = np.array([4.0, 0.0, 9.0]), np.array([0.0, 13.0, 2.0])
    coarse = grid.with_voxels(4.0, (below, above))
    middle = grid.world_from_grid.inverse().apply(coarse.world_from_grid.position)
    for side, least in ((-1, below), (1, above)):
        spare = coarse.size_mm / 2 + side * middle - grid.size_mm / 2
        assert (spare >= least - 1e-9).all() and (spare < least + coarse.voxel).all()
        np.testing.assert_allclose(spare / coarse.voxel, np.round(spare / coarse.voxel), atol=1e-9)


def test_a_volume_stays_where_it_is_between_grids():
    place = Pose.from_euler((5, -3, 2), (10, 20, 30))
    fine = VolumeGrid((12, 14, 16), 1.0, place)
    coarse = fine.with_voxels(4.0, ((4.0, 0.0, 9.0), (0.0, 13.0, 2.0)))

    def ramp(grid):
        k, j, i = np.indices(grid.shape).reshape(3, -1)
        points = (grid.affine @ np.stack([i, j, k, np.ones_like(i)]))[:3].T
        return (points @ [1.0, -2.0, 0.5]).reshape(grid.shape).astype(np.float32)

    found = interpolated(ramp(coarse), coarse, fine)
    inner = tuple(slice(2, -2) for _ in range(3))  # at the borders the outermost voxels go on
    np.testing.assert_allclose(found[inner], ramp(fine)[inner], atol=1e-4)


@pytest.fixture
def seen(circle, ellipsoid_integrals):
    """Signs that a ball off the middle gives, by its radius and the panel's columns."""

    def signs(radius, columns=64, mask=None):
        geometry = circle(30, Panel(60, columns, 2.0, 2.0))
        p = ellipsoid_integrals(geometry, (4, -3, 2), (radius, radius, radius))
        return signs_beyond(Projector(geometry, VolumeGrid((40, 40, 40), 1.0)), p, mask)

    return signs


def test_a_whole_object_in_the_grid_leaves_no_sign(seen):
    signs = seen(9)
    assert (signs.beside, signs.at_rim) == (0, 0)
    assert signs.ratio < 1.2


def test_rays_beside_the_grid_show_what_reaches_beyond_it(seen):
    assert seen(26).beside > 0.01


def test_the_panels_border_shows_an_object_that_it_cuts(seen):
    signs = seen(9, columns=20)
    assert signs.beside == 0
    assert signs.at_rim > 0.1


def test_dead_pixels_are_no_border(seen):
    """A border that does not count moves the rim; pixels within do not."""
    dead = np.ones((60, 64), np.bool_)
    dead[:, 30:33] = False
    dead[[0, -1]] = True  # a gap with an end on all sides
    assert seen(9, mask=dead).at_rim == 0
    cut = np.zeros((60, 64), np.bool_)
    cut[:, 22:42] = True
    assert seen(9, mask=cut).at_rim > 0.1


def test_errors_of_the_signs_are_those_of_noise(circle):
    """Of air alone, both signs are noise, whose deviation many draws show."""
    A = Projector(circle(16, Panel(24, 24, 20.0, 20.0)), VolumeGrid((8, 8, 8), 5.0))
    whole = A(np.full(A.domain_shape, 0.05, np.float32))
    rng = np.random.default_rng(5)
    drawn = [signs_beyond(A, whole + rng.normal(0, 0.05, A.range_shape)) for _ in range(200)]
    # ``at_rim`` and ``beside`` are never negative: half of a normal distribution.
    for size, error in (
        ([one.beside for one in drawn], drawn[0].errors[0]),
        ([one.at_rim for one in drawn], drawn[0].errors[1]),
    ):
        assert np.sqrt(2 * np.mean(np.square(size))) == pytest.approx(error, rel=0.2)


def test_no_attenuation_gives_no_sign(circle):
    A = Projector(circle(4, Panel(6, 8, 20.0, 20.0)), VolumeGrid((4, 4, 4), 10.0))
    signs = signs_beyond(A, np.zeros(A.range_shape))
    assert (signs.beside, signs.ratio, signs.at_rim) == (0, 1, 0)
