"""FDK against the values of phantoms whose line integrals are exact, and its refusals."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from twinct.core.errors import InputError
from twinct.geometry import Panel, Pose, ScanGeometry, VolumeGrid
from twinct.recon import Projector, fdk, fit_circle

pytestmark = pytest.mark.usefixtures("engine")

MID_PLANE = 0.01
"""Share of the true value. Measured at most 0.0004 for the mean."""
PANEL = Panel(96, 100, 1.5, 1.5)
SPHERE = [((4.0, -3.0, 2.0), (20.0, 20.0, 20.0))]
DEFRISE = [((2.0, 1.0, z), (24.0, 22.0, 3.0)) for z in (-24.0, -12.0, 0.0, 12.0, 24.0)]
SCANS = {"full": (200, 360), "short": (130, 205), "long arc": (150, 270)}


def phantom(geometry, bodies, ellipsoid_integrals):
    return sum(ellipsoid_integrals(geometry, *body) for body in bodies)


@pytest.mark.parametrize("window", ["ramp", "hann"])
@pytest.mark.parametrize("arc", SCANS)
@pytest.mark.parametrize("bodies", [SPHERE, DEFRISE], ids=["sphere", "defrise"])
def test_mid_plane_has_the_true_value(arc, bodies, window, circle, ellipsoid_integrals):
    views, degrees = SCANS[arc]
    geometry = circle(views, PANEL, arc_deg=degrees)
    grid = VolumeGrid((3, 64, 64), 1.2)
    volume = fdk(
        Projector(geometry, grid), phantom(geometry, bodies, ellipsoid_integrals), window=window
    ).array
    (cx, cy, cz), (a, b, c) = bodies[len(bodies) // 2]
    x, y, _ = grid.axes()
    square = ((x - cx) / a) ** 2 + (((y - cy) / b) ** 2)[:, None] + (cz / c) ** 2
    body, air = volume[1][square < 0.7], volume[1][(square > 1.4) & (square < 2)]
    assert abs(body.mean() - 1) < MID_PLANE
    assert np.abs(body - 1).max() < 2 * MID_PLANE
    assert abs(air.mean()) < MID_PLANE


def test_half_a_turn_of_a_parallel_beam_has_the_true_value(circle, ellipsoid_integrals):
    """Its fan of 0.04 degrees is within half a step."""
    far = circle(180, PANEL, arc_deg=179, sod=1e5, sdd=1e5 + 100)
    volume = fdk(
        Projector(far, VolumeGrid((3, 64, 64), 1.2)), phantom(far, SPHERE, ellipsoid_integrals)
    )
    x, y, _ = volume.grid.axes()
    (cx, cy, _), (a, b, _) = SPHERE[0]
    inside = ((x - cx) / a) ** 2 + (((y - cy) / b) ** 2)[:, None] < 0.7
    assert abs(volume.array[1][inside].mean() - 1) < MID_PLANE
    with pytest.raises(InputError, match=r"the arc covers 179 deg; fdk needs .* 180.1 deg"):
        fdk(Projector(far[:-1], volume.grid), phantom(far, SPHERE, ellipsoid_integrals)[:-1])


def test_turned_scan_gives_the_same_volume(circle, ellipsoid_integrals):
    """The circle is found wherever it lies, and in either direction."""
    geometry = circle(90, PANEL, arc_deg=215)
    p = ellipsoid_integrals(geometry, *SPHERE[0])
    grid = VolumeGrid((24, 24, 24), 2.0, Pose.from_euler((1, 2, 3), (10, 20, 30)))
    upright = fdk(Projector(geometry, grid), p)
    move = Pose((30, -20, 10), Rotation.from_euler("xyz", [40, 80, -30], degrees=True).as_quat())
    moved_grid = VolumeGrid(grid.shape, grid.voxel, move @ grid.world_from_grid)
    moved = fdk(Projector(move @ geometry, moved_grid), p)
    np.testing.assert_allclose(moved, upright, atol=2e-4)
    back = fdk(Projector(geometry[::-1], grid), p[::-1])
    np.testing.assert_allclose(back, upright, atol=2e-4)


SAME_TURN = 1e-6
"""Largest difference from the exact turn where further views repeat its views, of the value 1."""
OVERLAP = 0.0035
"""Root mean square difference from the exact turn where the views stand elsewhere.

Measured at most 0.0028, by aliasing of the views; 0.010 if the 3 degrees of 363 counted twice.
"""


@pytest.mark.parametrize("further", [[0], [0, 1, 2], range(90), [*range(90), 0, 1]])
def test_views_that_repeat_change_no_voxel(further, circle, ellipsoid_integrals):
    """The last view on the first, an overlap of several, and further turns share their arcs."""
    turn = circle(90, PANEL)
    p, A = ellipsoid_integrals(turn, *SPHERE[0]), Projector(turn, VolumeGrid((3, 40, 40), 1.5))
    views = [*range(90), *further]
    overlapping = fdk(Projector(turn[views], A.grid), p[views])
    assert overlapping.extras["circle"].full
    np.testing.assert_allclose(overlapping, fdk(A, p), atol=SAME_TURN)


@pytest.mark.parametrize("degrees", [363.0, 400.0, 725.0])
def test_more_than_a_turn_gives_the_volume_of_a_turn(degrees, circle, ellipsoid_integrals):
    turn = circle(240, PANEL)
    views = round(240 * degrees / 360)
    places = (Pose.from_euler((0, 0, 0), (0, 0, degrees * i / views)) for i in range(views))
    more = ScanGeometry.joined([place @ turn[:1] for place in places])
    grid = VolumeGrid((3, 40, 40), 1.5)
    exact = fdk(Projector(turn, grid), ellipsoid_integrals(turn, *SPHERE[0]))
    found = fdk(Projector(more, grid), ellipsoid_integrals(more, *SPHERE[0]))
    assert found.extras["circle"].span == pytest.approx(2 * np.pi)
    assert np.sqrt(np.mean((found.array - exact.array) ** 2)) < OVERLAP


def test_truncated_rows_do_not_brighten_the_edge(circle, ellipsoid_integrals):
    """A wide body on a narrow panel: within 15 % in the middle of what all views see."""
    geometry = circle(120, Panel(64, 50, 1.5, 1.5))
    p = ellipsoid_integrals(geometry, (0, 0, 0), (40, 34, 30))
    volume = fdk(Projector(geometry, VolumeGrid((3, 20, 20), 1.2)), p).array
    assert np.abs(volume[1] - 1).max() < 0.15


def test_pose_noise_of_the_arms_is_accepted(circle):
    geometry = circle(100, PANEL, sod=300.0, sdd=600.0)
    rng = np.random.default_rng(0)
    noisy = replace(
        geometry,
        source=geometry.source + rng.uniform(-1, 1, (100, 3)),
        detector=geometry.detector + rng.uniform(-1, 1, (100, 3)),
    )
    circle_found = fit_circle(noisy)
    assert circle_found.full
    assert np.linalg.norm(circle_found.centre) < 0.5
    assert circle_found.radius == pytest.approx(300, abs=0.5)


def shifted(array, view, by):
    array = array.copy()
    array[view] += by
    return array


def leaning(geometry, degrees, about):
    turn = Rotation.from_rotvec(np.radians(degrees) * about(geometry))
    return replace(geometry, u=turn.apply(geometry.u.copy()), v=turn.apply(geometry.v.copy()))


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (
            lambda g: replace(g, source=shifted(g.source, 7, (0, 0, 9.0))),
            r"distance of source 7 from the circle is .* mm; at most 2 mm",
        ),
        (
            lambda g: replace(g, detector=shifted(g.detector, 5, 12 * g.normal[5])),
            r"panel 5 from the mean distance of 399.* mm is .* mm; at most .* mm",
        ),
        (lambda g: leaning(g, 3, lambda g: g.v), "normal and the radius of panel .* at most 1 deg"),
        (lambda g: leaning(g, 3, lambda g: g.normal), "axis and v of panel .* at most 1 deg"),
        (
            lambda g: replace(g[:45], detector=g.detector[:45] + 15 * g.u[:45]),
            r"needs a full turn .* middle column of view \d+ is 10 px; at most 5 px",
        ),
        (
            lambda g: replace(g, detector=g.detector + 75 * g.u),
            r"the axis projects to column -0.5 of view \d+; .* at least 1 columns",
        ),
        (lambda g: g[[*range(30), *range(34, 60)]], "of the step after view 29 from .* is .* deg"),
        (lambda g: g[:20], r"the arc covers 120 deg; fdk needs .* 20.* deg"),
        (lambda g: g[:2], "a circular scan of at least 3 views, not 2"),
        (lambda g: g[[0] * 5], "coincide"),
    ],
)
def test_what_is_no_circle_is_refused_with_deviation_and_bound(spoil, message, circle):
    geometry = spoil(circle(60, PANEL))
    A = Projector(geometry, VolumeGrid((4, 4, 4), 2.0))
    with pytest.raises(InputError, match=message):
        fdk(A, np.zeros(A.range_shape))


def test_free_orbit_is_refused_with_every_deviation(random_geometry):
    A = Projector(random_geometry(20, PANEL, np.random.default_rng(0)), VolumeGrid((4, 4, 4), 2.0))
    with pytest.raises(InputError) as caught:
        fdk(A, np.zeros(A.range_shape))
    (problem,) = caught.value.problems
    assert problem.count("fdk needs") == 1 and problem.count("is allowed") >= 3
    with pytest.raises(InputError, match="^calibrate circle needs a circular scan: "):
        fit_circle(A.geometry, "calibrate circle")
