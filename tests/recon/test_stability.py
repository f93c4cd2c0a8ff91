"""Which relaxations are stable: where errors shrink from pass to pass, and where they grow.

With line integrals of zero, what an algorithm makes of its start is its error, mapped once a pass.
"""

import numpy as np
import pytest

from twinct.geometry import Panel, Pose, ScanGeometry, VolumeGrid
from twinct.recon import Projector, os_sart, sart, sirt

HIGHEST = 1.99


def growth(algorithm, A, relaxation, passes, **keys):
    """Factor by which the error grows in the last pass: the spectral radius, in the long run."""
    rng = np.random.default_rng(0)
    x = rng.standard_normal(A.domain_shape).astype(np.float32)
    nothing = np.zeros(A.range_shape, np.float32)
    keys |= {"relaxation": relaxation}
    before = algorithm(A, nothing, iterations=passes, x0=x, **keys).array
    after = algorithm(A, nothing, iterations=1, x0=before, **keys).array
    return np.linalg.norm(after) / np.linalg.norm(before)


def largest_share(A):
    """The largest A 1 / L of the rays that count."""
    lengths = A.chords()
    counts = lengths >= A.grid.voxel.min()
    return (A(np.ones(A.domain_shape))[counts] / lengths[counts]).max()


@pytest.mark.parametrize(
    "grid",
    [
        VolumeGrid((7, 7, 7), 2.5),
        VolumeGrid((5, 8, 8), (1.5, 1.5, 4.5), Pose.from_euler((0, 0, 0), (10, 20, 30))),
    ],
    ids=["cubes", "bricks"],
)
def test_many_views_are_stable_up_to_two(grid, random_geometry):
    """Though single rays are over-corrected: a voxel takes the mean over several, and views."""
    A = Projector(random_geometry(24, Panel(14, 15, 2.0, 2.0), np.random.default_rng(0)), grid)
    assert largest_share(A) > 1.3
    for relaxation in (1.0, HIGHEST):
        assert growth(sart, A, relaxation, 6) < 0.99
        assert growth(os_sart, A, relaxation, 6, subsets=6) < 0.99
        assert growth(sirt, A, min(relaxation, 1.97), 6) < 1.0


@pytest.fixture
def corner():
    """One ray of one pixel that crosses a corner of the grid, over-corrected by 40 %."""
    grid = VolumeGrid((4, 4, 4), 2.0)
    u, v = np.array([[1, -1, 0]]) / np.sqrt(2), np.array([[0, 0, 1.0]])
    normal = np.cross(u, v)
    for across in np.arange(3.0, 5.0, 0.02):
        shift = across * u
        views = ScanGeometry(
            shift + 100 * normal, shift - 100 * normal, u, v, Panel(1, 1, 30.0, 30.0)
        )
        A = Projector(views, grid)
        if A.chords()[0, 0, 0] >= 2.0 and largest_share(A) > 1.39:
            return A
    raise AssertionError("no such ray")


@pytest.mark.parametrize("algorithm", [sart, sirt])
def test_a_single_corner_ray_is_stable_up_to_two_over_its_share(algorithm, corner):
    limit = 2 / largest_share(corner)
    assert 1 < limit < 1.44
    for relaxation, stable in ((1.0, True), (0.98 * limit, True), (1.02 * limit, False)):
        # What the ray sees of the error: the rest of the voxels stays as it is.
        x = np.ones(corner.domain_shape, np.float32)
        nothing = np.zeros(corner.range_shape, np.float32)
        keys = {"iterations": 20, "relaxation": relaxation}
        seen = corner(algorithm(corner, nothing, x0=x, **keys)) / corner(x)
        assert (abs(seen[0, 0, 0]) < 1) == stable


def test_few_views_let_unmatched_modes_grow_slowly(random_geometry):
    """With one view the voxel-driven B, no adjoint of A, feeds what the rays cannot see."""
    views = random_geometry(1, Panel(31, 31, 1.0, 1.0), np.random.default_rng(3), tilt=0.0)
    A = Projector(views, VolumeGrid((7, 7, 7), 2.5))
    assert 1.005 < growth(sart, A, 1.0, 150) < 1.05
    assert growth(sirt, A, 1.0, 150) < 1 + 1e-5
