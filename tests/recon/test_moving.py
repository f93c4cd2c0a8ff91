"""Compensation of a known motion: the operator, its adjoint, and the algorithms that use it."""

from __future__ import annotations

import numpy as np
import pytest

from twinct.core.errors import InputError
from twinct.geometry import Panel, Pose, ScanGeometry, VolumeGrid
from twinct.recon import Projector, fast, fdk, sart
from twinct.recon.moving import MovingProjector, moving_bytes
from twinct.specimen.deformation import Deformation, inverse, require_no_fold
from twinct.trajectory import CircleTrajectory, commanded_views

PANEL = Panel(20, 24, 6.0, 6.0)


def views(count: int = 12) -> ScanGeometry:
    circle = CircleTrajectory(kind="circle", views=count, sod_mm=300, sdd_mm=600)
    return commanded_views(circle, PANEL)


def swell(size: float):
    """A smooth displacement, far from a fold, that is no rigid motion."""

    def displacement(points):
        x, y, z = points.T / 18
        return size * np.stack([np.sin(y), 0.4 * np.cos(x + z), np.cos(x) * np.cos(y)], axis=1)

    return displacement


def motion(count: int, size: float = 4.0) -> list[Deformation]:
    """Three states in turn, in a frame that is turned and shifted."""
    pose = Pose.from_euler((2, -1, 3), (10, 20, -15))
    states = [Deformation(swell(size * share), pose) for share in (0.0, 0.6, 1.0)]
    return [states[view % 3] for view in range(count)]


@pytest.fixture
def grid():
    return VolumeGrid((22, 26, 24), (2.1, 2.0, 2.3), Pose.from_euler((1, 2, -1), (5, -8, 12)))


def blobs(grid: VolumeGrid, deformation: Deformation | None = None):
    """A few smooth balls, optionally deformed, sampled at the voxel centres."""
    z, y, x = np.indices(grid.shape)
    points = np.stack([x, y, z], -1).reshape(-1, 3) @ grid.affine[:3, :3].T + grid.affine[:3, 3]
    if deformation is not None:
        points = deformation.to_reference(points)
    values = np.zeros(len(points))
    for centre, width in (((0, 4, 2), 6.0), ((-8, -5, 4), 5.0), ((7, -4, -8), 4.0)):
        values += np.exp(-((points - centre) ** 2).sum(axis=1) / (2 * width**2))
    return values.reshape(grid.shape).astype(np.float32)


def test_the_adjoint_is_exact(grid, engine):
    rng = np.random.default_rng(1)
    A = MovingProjector(views(), grid, motion(12, 9.0))
    x = rng.random(A.domain_shape, dtype=np.float32)
    y = rng.random(A.range_shape, dtype=np.float32)
    forward, back = np.vdot(A(x), y.astype(float)), np.vdot(x.astype(float), A.T(y))
    assert forward == pytest.approx(back, rel=2e-6)


def test_a_body_at_rest_is_projected_as_without_motion(grid):
    still = [Deformation(swell(0.0), Pose.identity())] * 12
    A, B = Projector(views(), grid), MovingProjector(views(), grid, still)
    x = np.random.default_rng(2).random(A.domain_shape, dtype=np.float32)
    y = A(x)
    assert B(x) == pytest.approx(y, abs=1e-4 * float(y.max()))
    assert B.T(y) == pytest.approx(A.T(y), rel=1e-4)
    one, two = np.zeros_like(x), np.zeros_like(x)
    for view in (0, 5):
        A.update(one, view, y[view], relaxation=0.7, floor=0.0)
        B.update(two, view, y[view], relaxation=0.7, floor=0.0)
    assert two == pytest.approx(one, abs=1e-5)


def test_views_see_the_deformed_body(grid):
    states = motion(12)
    A = MovingProjector(views(), grid, states)
    found = A(blobs(grid))
    for view in range(12):
        there = blobs(grid, states[view])
        expected = Projector(views()[[view]], grid)(there)[0]
        still = Projector(views()[[view]], grid)(blobs(grid))[0]
        error = np.sqrt(np.mean((found[view] - expected) ** 2))
        assert error < 0.006 * expected.max()
        if view % 3 == 2:
            assert error < 0.15 * np.sqrt(np.mean((still - expected) ** 2))


def test_parts_keep_the_motion_of_their_views(grid):
    states = motion(12)
    A = MovingProjector(views(), grid, states)
    x, whole = blobs(grid), A(blobs(grid))
    for chosen in ([7, 2], slice(1, 9, 3), np.arange(12) > 8, 4):
        part = A[chosen]
        expected = whole[[chosen]] if isinstance(chosen, int) else whole[chosen]
        assert np.array_equal(part(x), expected)
    assert np.array_equal(A.on(grid)(x), whole)
    with pytest.raises(InputError, match="11 deformations for 12 views"):
        MovingProjector(views(), grid, states[:11])


ALGORITHMS = {
    "sart": lambda A, p: sart(A, p, iterations=3, relaxation=0.5),
    "fast": lambda A, p: fast(A, p, strength=0.0, levels=2, passes=2),
    "fdk": lambda A, p: fdk(A, p),
}


@pytest.fixture(scope="module")
def breathing_scan():
    """Projections of the deformed bodies, on a finer grid than that of the reconstruction."""
    geometry, states = views(48), motion(48, 5.0)
    A = Projector(geometry, VolumeGrid((40, 40, 40), 1.4))
    bodies = [blobs(A.grid, one) for one in states[:3]]
    moving = np.concatenate([A[[view]](bodies[view % 3]) for view in range(48)])
    return geometry, states, moving, A(bodies[0])


@pytest.mark.tutorial
@pytest.mark.parametrize("name", ALGORITHMS)
def test_algorithms_win_back_what_motion_costs(name, breathing_scan):
    geometry, states, moving, still = breathing_scan
    grid, solve = VolumeGrid((24, 24, 24), 2.4), ALGORITHMS[name]
    truth = blobs(grid)

    def error(B, p):
        return np.sqrt(np.mean((solve(B, p).array - truth)[5:-5, 5:-5, 5:-5] ** 2))

    plain = Projector(geometry, grid)
    best, ignored = error(plain, still), error(plain, moving)
    compensated = error(MovingProjector(geometry, grid, states), moving)
    assert ignored > 1.5 * best
    assert (ignored - compensated) / (ignored - best) > 0.8


def test_an_inverse_is_one_and_a_fold_is_refused():
    points = np.random.default_rng(3).uniform(-40, 40, (200, 3))
    move = swell(6.0)
    assert require_no_fold(move, points, "a field") > 0.2
    assert inverse(move, points + move(points)) == pytest.approx(points, abs=1e-4)
    with pytest.raises(InputError, match=r"a field folds at .* determinant .* must be above 0"):
        require_no_fold(swell(30.0), points, "a field")


def test_the_memory_of_maps_is_stated(grid):
    A = MovingProjector(views(), grid, motion(12))
    A(np.ones(A.domain_shape, np.float32))
    held = [m._to.shifts.nbytes for m in A._moved.values()]
    stated = moving_bytes(grid, 12) - 8 * int(np.prod(grid.shape))
    assert stated == pytest.approx(12 * 2 * held[0], rel=0.8)
