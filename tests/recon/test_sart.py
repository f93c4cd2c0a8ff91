from itertools import pairwise

import numpy as np
import pytest

from twinct.core.errors import InputError
from twinct.geometry import Panel, VolumeGrid
from twinct.recon import Projector, sart, spread_order

pytestmark = pytest.mark.usefixtures("engine")

FLOAT32 = 2e-4
"""Float32 against a float64 formulation, relative to the largest voxel, after 8 updates."""


def test_equals_the_update_rule_written_densely(
    random_geometry, dense_matrix, dense_back_projection
):
    rng = np.random.default_rng(0)
    grid = VolumeGrid((5, 6, 4), (3.0, 2.5, 2.0))
    # Small and large panels: truncated views, and rays that miss the grid.
    for panel in (Panel(7, 8, 2.0, 2.0), Panel(9, 9, 8.0, 8.0)):
        A = Projector(random_geometry(4, panel, rng), grid)
        p = A(rng.random(A.domain_shape, dtype=np.float32))
        order = [2, 0, 3, 1]
        ours = sart(A, p, iterations=2, relaxation=0.7, order=order).array
        dense = dense_matrix(A)
        lengths = A.chords().astype(float)
        x = np.zeros(dense.shape[-1])
        for view in order * 2:
            B = dense_back_projection(A, view)
            counts = (lengths[view] >= grid.voxel.min()).ravel()
            residual = (p[view] - dense[view] @ x).ravel()
            ratio = np.divide(residual, lengths[view].ravel(), where=counts, out=0 * residual)
            weight = B @ counts
            seen = weight > 1e-3
            x[seen] += 0.7 * (B @ ratio)[seen] / weight[seen]
        assert np.abs(ours.ravel() - x).max() < FLOAT32 * np.abs(x).max()


def test_unmatched_back_projection_changes_little(random_geometry, turned_grid):
    """Against SART with the exact adjoint: the same object to 5 % of its range after 3 passes."""
    rng = np.random.default_rng(1)
    A = Projector(random_geometry(16, Panel(41, 41, 2.0, 2.0), rng), turned_grid)
    truth = np.zeros(A.domain_shape, np.float32)
    truth[5:12, 6:15, 8:16] = 1.0
    p = A(truth)
    order = [int(view) for view in spread_order(16)]
    x = np.zeros_like(truth)
    for view in order * 3:
        one, length = A[view], A[view].chords()
        counts = length >= A.grid.voxel.min()
        ratio = np.where(counts, (p[view] - one(x)) / np.where(counts, length, 1), 0)
        weight = one.T(counts)
        x += 0.3 * np.where(weight > 1e-3, one.T(ratio) / np.maximum(weight, 1e-3), 0)
    ours = sart(A, p, iterations=3, relaxation=0.3, order=order).array
    assert np.sqrt(np.mean((ours - x) ** 2)) < 0.05


def test_restart_is_bit_identical(random_geometry, turned_grid, panel):
    rng = np.random.default_rng(2)
    A = Projector(random_geometry(6, panel, rng), turned_grid)
    p = A(rng.random(A.domain_shape, dtype=np.float32))
    whole = sart(A, p, iterations=5, relaxation=0.5)
    half = sart(A, p, iterations=2, relaxation=0.5)
    np.testing.assert_array_equal(sart(A, p, iterations=3, relaxation=0.5, x0=half), whole)


def test_residual_falls_and_blobs_come_back_in_place(random_geometry, turned_grid, panel):
    A = Projector(random_geometry(40, panel, np.random.default_rng(3)), turned_grid)
    truth = np.zeros(A.domain_shape, np.float32)
    truth[3:6, 20:23, 4:7] = 1.0
    truth[12:16, 5:9, 15:18] = 0.5
    p = A(truth)
    seen = []

    def watch(step):
        if step.update == step.updates - 1:
            seen.append(np.linalg.norm(A(step.volume) - p))

    x = sart(A, p, iterations=6, relaxation=0.5, nonnegative=True, callback=watch).array
    assert all(later < earlier for earlier, later in pairwise(seen))
    assert x.min() >= 0
    assert np.corrcoef(x.ravel(), truth.ravel())[0, 1] > 0.95


def test_order_is_a_permutation_that_jumps():
    for views in (1, 2, 7, 399):
        assert sorted(spread_order(views)) == list(range(views))
    assert np.abs(np.diff(spread_order(399))).min() > 100


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"iterations": 0}, "iterations is 0; .* at least 1"),
        ({"relaxation": 2.0}, "relaxation is 2.0; it must be above 0 and below 2"),
        ({"relaxation": float("nan")}, "relaxation is nan"),
        ({"order": [0, 0, 1]}, "not a permutation of the views 0 to 2"),
        ({"line_integrals": np.zeros((2, 31, 37))}, "have shape .* needs"),
        ({"line_integrals": np.full((3, 31, 37), np.nan)}, "view 0 .* 1147 pixels"),
        ({"x0": np.zeros((2, 2, 2))}, "x0 has shape"),
    ],
)
def test_wrong_arguments_are_named(change, message, random_geometry, turned_grid, panel):
    A = Projector(random_geometry(3, panel, np.random.default_rng(4)), turned_grid)
    arguments = {"line_integrals": np.zeros(A.range_shape), "iterations": 1, "relaxation": 0.3}
    with pytest.raises(InputError, match=message):
        sart(A, **(arguments | change))
