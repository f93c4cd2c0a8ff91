"""The algorithms on 12^3 voxels against dense linear algebra in float64."""

import numpy as np
import pytest

from twinct.geometry import Panel, VolumeGrid
from twinct.recon import Projector, cgls, os_sart, sart, sirt
from twinct.recon.order import subsets_of

pytestmark = pytest.mark.usefixtures("engine")

DENSE = 1e-4
"""Relative to the largest voxel; float32 rounding, measured 1e-7 to 1e-6."""


@pytest.fixture(scope="module")
def problem():
    return {}


@pytest.fixture
def small(problem, engine, random_geometry, dense_matrix):
    """Projector, its matrix (rays, voxels), noisy projections and the rays that count."""
    if engine not in problem:
        rng = np.random.default_rng(0)
        grid = VolumeGrid((12, 12, 12), (2.0, 2.5, 2.2))
        A = Projector(random_geometry(9, Panel(17, 19, 3.0, 3.2), rng), grid)
        p = A(rng.random(grid.shape, dtype=np.float32))
        p += rng.normal(0, 0.3, p.shape).astype(np.float32)
        lengths = A.chords().astype(float).ravel()
        problem[engine] = A, dense_matrix(A).reshape(p.size, -1), p, lengths
    return problem[engine]


def close(ours, dense):
    assert np.abs(np.ravel(ours) - dense).max() < DENSE * np.abs(dense).max()


def test_cgls_is_the_best_of_each_krylov_space(small):
    A, M, p, lengths = small
    counts = lengths >= A.grid.voxel.min()
    M, b = M[counts], p.ravel()[counts].astype(float)
    start = np.random.default_rng(1).random(A.domain_shape, dtype=np.float32)
    rest = b - M @ start.ravel()
    basis = []
    for step in range(6):
        new = M.T @ (M @ basis[-1] if basis else rest)
        for _ in range(2):
            for old in basis:
                new -= (old @ new) * old
        basis.append(new / np.linalg.norm(new))
        if step in (0, 5):
            K = np.stack(basis, axis=1)
            best = start.ravel() + K @ np.linalg.lstsq(M @ K, rest, rcond=None)[0]
            close(cgls(A, p, iterations=step + 1, x0=start), best)


def test_sirt_is_its_filtered_eigenvectors(small):
    """All iterates in closed form: C^1/2 U (1 - (1 - relaxation s)^n) / s U^T C^1/2 A^T R p."""
    A, M, p, lengths = small
    counts = lengths >= A.grid.voxel.min()
    R = np.where(counts, 1 / np.where(counts, lengths, 1), 0)
    C = 1 / M[counts].sum(axis=0)
    half = np.sqrt(C)
    s, U = np.linalg.eigh(half[:, None] * ((M.T * R) @ M) * half)
    b = U.T @ (half * (M.T @ (R * p.ravel())))
    for n, relaxation in ((1, 1.0), (40, 1.0), (15, 1.6)):
        share = np.where(s > 1e-9, (1 - (1 - relaxation * s) ** n) / np.maximum(s, 1e-9), 0)
        close(sirt(A, p, iterations=n, relaxation=relaxation), half * (U @ (share * b)))


@pytest.mark.parametrize(("subsets", "nonnegative"), [(1, False), (3, True), (9, False)])
def test_os_sart_equals_its_update_rule(subsets, nonnegative, small, dense_back_projection):
    A, M, p, lengths = small
    views, voxels = len(A), M.shape[1]
    M, L = M.reshape(views, -1, voxels), lengths.reshape(views, -1)
    counts = L >= A.grid.voxel.min()
    parts = subsets_of(A.geometry, subsets)
    back = [dense_back_projection(A, view) for view in range(views)]
    x = np.zeros(voxels)
    for _ in range(2):
        for part in parts:
            change, seen = np.zeros(voxels), np.zeros(voxels)
            for view in part:
                rest = p[view].ravel() - M[view] @ x
                ratio = np.where(counts[view], rest / np.maximum(L[view], 1e-9), 0)
                weight = back[view] @ counts[view]
                seen += weight > 1e-3
                change += np.where(weight > 1e-3, back[view] @ ratio / np.maximum(weight, 1e-3), 0)
            x += 0.8 * change / np.maximum(seen, 1)
            if nonnegative:
                x = np.maximum(x, 0)
    close(os_sart(A, p, iterations=2, relaxation=0.8, subsets=subsets, nonnegative=nonnegative), x)


def test_os_sart_of_single_views_is_sart(small):
    A, _, p, _ = small
    ours = os_sart(A, p, iterations=2, relaxation=0.3, subsets=len(A))
    close(ours, np.ravel(sart(A, p, iterations=2, relaxation=0.3)).astype(float))
