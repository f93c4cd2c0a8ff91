"""Path lengths through closed bodies against analytic ones, and their derivatives."""

import numpy as np
import pytest
import trimesh

from twinct.core.errors import InputError
from twinct.geometry import Panel, Pose, ScanGeometry
from twinct.rays import Body, Rays

PANEL = Panel(21, 31, 2.0, 1.5)


@pytest.fixture
def geometry(random_geometry):
    return random_geometry(3, PANEL, np.random.default_rng(3))


def ball(radius, subdivisions=4):
    mesh = trimesh.creation.icosphere(subdivisions, radius)
    return Body(mesh.vertices, mesh.faces)


def rod(radius=3.0, height=18.0):
    mesh = trimesh.creation.cylinder(radius, height, sections=64)
    return Body(mesh.vertices, mesh.faces)


def whole(body, geometry, pose, view, **keys):
    """The shadow on the whole panel."""
    shadow = Rays(geometry).shadow(body, pose, view, **keys)
    image = np.zeros((*geometry.panel.shape, *shadow.slopes.shape[2:])) if keys else None
    lengths = np.zeros(geometry.panel.shape)
    lengths[shadow.box] = shadow.lengths
    if image is not None:
        image[shadow.box] = shadow.slopes
    return lengths, image


def chords(geometry, view, centre, radius):
    ray = geometry.pixel_centres(view) - geometry.source[view]
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    to = np.asarray(centre) - geometry.source[view]
    nearest = to @ to - (ray @ to) ** 2
    return 2 * np.sqrt(np.maximum(radius**2 - nearest, 0))


def test_a_ball_has_the_chords_of_a_sphere(geometry):
    pose = Pose.from_euler((2, -1, 3), (20, 30, 40))
    for view in range(len(geometry)):
        lengths, _ = whole(ball(8.0), geometry, pose, view)
        # Facets lie at most 0.25 % of the radius below the sphere: at its rim more of the chord.
        np.testing.assert_allclose(lengths, chords(geometry, view, pose.position, 8), atol=0.9)
        assert np.abs(lengths - chords(geometry, view, pose.position, 8)).mean() < 0.03


def test_rays_along_edges_and_through_corners_are_counted_once():
    """A box seen straight on: the middle ray runs along the diagonals of two faces' triangles."""
    mesh = trimesh.creation.box((8.0, 8.0, 8.0))
    panel = Panel(11, 11, 2.0, 2.0)
    geometry = ScanGeometry([[100, 0, 0]], [[-100, 0, 0]], [[0, 1, 0]], [[0, 0, 1]], panel)
    lengths, _ = whole(Body(mesh.vertices, mesh.faces), geometry, Pose.identity(), 0)
    ray = geometry.pixel_centres(0) - geometry.source[0]
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    inner = (slice(2, 9), slice(2, 9))  # through both faces, front and back
    np.testing.assert_allclose(lengths[inner], 8 / np.abs(ray[inner][..., 0]), rtol=1e-12)
    assert lengths.min() >= 0
    assert lengths[0].max() == 0


def test_derivatives_are_those_of_finite_differences(geometry):
    body, pose, step = rod(), Pose.from_euler((2, 1, -3), (20, 30, 40)), 1e-5
    for view in range(len(geometry)):
        _, slopes = whole(body, geometry, pose, view, slopes=True)
        for axis, twist in enumerate(np.eye(6)):
            after, before = (
                whole(body, geometry, pose @ Pose.exp(sign * step * twist), view)[0]
                for sign in (1, -1)
            )
            numeric = (after - before) / (2 * step)
            # Where a ray changes facets within the step there is no derivative.
            off = np.abs(numeric - slopes[..., axis])
            smooth = off < 1e-5 * np.maximum(1, np.abs(numeric))
            assert smooth.mean() > 0.99, (view, axis)
        assert np.abs(slopes).max() > 1


def test_a_box_of_pixels_holds_the_same(geometry):
    pose = Pose.from_euler((1, 2, 3), (0, 0, 0))
    body = ball(6.0, 2)
    rays = Rays(geometry)
    small = rays.shadow(body, pose, 1)
    large = rays.shadow(body, pose, 1, box=rays.box(body, pose, 1, margin=4))
    rows, columns = (
        slice(a.start - b.start, a.stop - b.start)
        for a, b in zip(small.box, large.box, strict=True)
    )
    np.testing.assert_array_equal(large.lengths[rows, columns], small.lengths)
    assert large.lengths.sum() == pytest.approx(small.lengths.sum(), rel=1e-12)
    beside = Pose.from_euler((0, 0, 500), (0, 0, 0))
    assert rays.shadow(body, beside, 1).lengths.size == 0


def test_what_is_no_body_is_refused(geometry):
    mesh = trimesh.creation.icosphere(1, 2.0)
    with pytest.raises(InputError, match="open"):
        Body(mesh.vertices, mesh.faces[1:])
    with pytest.raises(InputError, match="inside out"):
        Body(mesh.vertices, mesh.faces[:, ::-1])
    behind = Pose.from_euler(geometry.source[1], (0, 0, 0))
    with pytest.raises(InputError, match="behind the source of view 1"):
        Rays(geometry).shadow(Body(mesh.vertices, mesh.faces), behind, 1)
