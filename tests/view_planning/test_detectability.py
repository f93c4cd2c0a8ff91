"""Predicted detectability: the formula where it is exact, its slopes, and a real projector."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.sparse.linalg import LinearOperator, cg

from twinct.core.errors import InputError
from twinct.geometry import Panel, VolumeGrid
from twinct.recon import Projector
from twinct.trajectory import (
    ArcTrajectory,
    CircleTrajectory,
    UniformTrajectory,
    commanded_views,
)
from twinct.view_planning import Detectability, Task, detectability_of
from twinct.view_planning.objectives.detectability import difference_spectrum

SHAPE = (6, 7, 8)


def _blurred(seed: int = 3):
    """A circulant Fisher information of two views, for which the formula is exact."""
    rng = np.random.default_rng(seed)
    columns = []
    for _ in range(2):
        kernel = rng.normal(size=SHAPE)
        columns.append(np.abs(np.fft.rfftn(kernel)) ** 2)
    return np.array(columns, np.float32), rng.normal(size=SHAPE)


def _matrix(half: np.ndarray) -> np.ndarray:
    """The circulant matrix of a half spectrum."""
    size = int(np.prod(SHAPE))
    eye = np.eye(size).reshape(size, *SHAPE)
    axes = (1, 2, 3)
    return np.fft.irfftn(np.fft.rfftn(eye, axes=axes) * half, s=SHAPE, axes=axes).reshape(size, -1)


def test_a_filter_has_the_detectability_that_its_matrices_say() -> None:
    fisher, signal = _blurred()
    beta, exposures = 5.0, np.array([0.7, 1.9])
    F = _matrix(np.tensordot(exposures, fisher.astype(float), axes=1))  # noqa: N806
    H = F + beta * _matrix(difference_spectrum(SHAPE))  # noqa: N806
    template = np.linalg.solve(H, F @ signal.ravel())
    back = np.linalg.solve(H, template)
    exact = (template @ template) / np.sqrt(back @ F @ back)
    found = Detectability(Task(signal, beta), fisher)
    assert found(exposures) == pytest.approx(exact, rel=1e-6)  # float32 spectra


def test_it_is_what_evaluate_says_of_the_same_mtf_and_nps() -> None:
    fisher, signal = _blurred()
    half = fisher.sum(axis=0, dtype=float)
    f = np.fft.fftn(np.fft.irfftn(half, s=SHAPE, axes=(0, 1, 2))).real
    r = np.fft.fftn(np.fft.irfftn(difference_spectrum(SHAPE), s=SHAPE, axes=(0, 1, 2))).real
    both = f + 5.0 * r
    found = Detectability(Task(signal, 5.0), fisher)(np.ones(2))
    # Voxels of 1 mm: f of voxels is per mm^3 alike.
    seen = np.abs(np.fft.fftn(signal) * (f / both)) ** 2 / signal.size
    expected = seen.sum() / math.sqrt((seen * f / both**2).sum())
    assert found == pytest.approx(expected, rel=1e-6)


def test_slopes_are_differences() -> None:
    fisher, signal = _blurred()
    found = Detectability(Task(signal, 5.0), fisher)
    at, step = np.array([0.7, 1.9]), 1e-4
    for view, slope in enumerate(found.slopes(at)):
        turn = step * np.eye(2)[view]
        numeric = (found(at + turn) ** 2 - found(at - turn) ** 2) / (2 * step)
        assert slope == pytest.approx(numeric, rel=1e-5)


def test_added_tells_of_every_candidate_what_its_choice_has() -> None:
    fisher, signal = _blurred()
    found = Detectability(Task(signal, 5.0), fisher)
    assert found.added([0], [0, 1]) == pytest.approx(
        [found(np.array([2.0, 0.0])), found(np.ones(2))], rel=1e-6
    )


def test_no_view_detects_nothing() -> None:
    fisher, signal = _blurred()
    assert Detectability(Task(signal, 5.0), fisher)(np.zeros(2)) == 0


@pytest.mark.parametrize("axis", [0, 1])
def test_a_flat_signal_is_seen_best_along_its_plane(axis) -> None:
    """A disc across x: beams along y run in its plane, those along x through its thin side."""
    n, voxel = 16, 2.0
    grid, panel = VolumeGrid((n, n, n), voxel), Panel(16, 20, 4.0, 4.0)
    z, y, x = np.indices((n, n, n)) - n // 2
    disc = (np.hypot(y, z) <= 4) & (x == 0) if axis == 0 else (np.hypot(x, z) <= 4) & (y == 0)
    task = Task(0.002 * disc, 100.0)
    views = {
        along: ArcTrajectory(
            kind="arc", views=6, longitude_range_deg=20, centre_longitude_deg=longitude
        )
        for along, longitude in {"x": 0, "y": 90}.items()
    }
    found = {}
    for along, section in views.items():
        projector = Projector(commanded_views(section, panel), grid)
        photons = np.full(projector.range_shape, 1e4)
        found[along] = detectability_of(projector, photons, task)(np.ones(6))
    better, worse = ("y", "x") if axis == 0 else ("x", "y")
    assert found[better] > 1.3 * found[worse]


def _differences(v: np.ndarray) -> np.ndarray:
    """R v, of the neighbours that there are."""
    out = np.zeros_like(v)
    for axis in range(3):
        step, into = np.moveaxis(np.diff(v, axis=axis), axis, 0), np.moveaxis(out, axis, 0)
        into[:-1] -= step
        into[1:] += step
    return out


def test_views_of_a_real_projector_detect_what_the_linear_reconstruction_does() -> None:
    """Rays that end with the grid give each view negative powers, which the sum needs."""
    n, beta = 16, 1e4
    section = UniformTrajectory(kind="uniform", views=16, latitude_range_deg=(-80, 80))
    views = commanded_views(section, Panel(20, 22, 4.0, 4.0))
    projector = Projector(views, VolumeGrid((n, n, n), 2.0))
    photons = np.full(projector.range_shape, 1e4, np.float32)
    radius = 2.0 * np.linalg.norm(np.indices((n, n, n)) - n // 2, axis=0)
    signal = 0.002 * np.clip((4 - radius) / 2 + 0.5, 0, 1)

    def fisher(v: np.ndarray) -> np.ndarray:
        seen = projector(v.reshape(signal.shape).astype(np.float32))
        return projector.T(photons * seen).astype(float)

    def hessian(v: np.ndarray) -> np.ndarray:
        return (fisher(v) + beta * _differences(v.reshape(signal.shape))).ravel()

    def solved(right: np.ndarray) -> np.ndarray:
        near = LinearOperator((n**3, n**3), matvec=hessian, dtype=float)
        return cg(near, right.ravel(), rtol=1e-2, maxiter=200)[0]

    template = solved(fisher(signal))
    back = solved(template)
    exact = template @ template / np.sqrt(back @ fisher(back).ravel())
    found = detectability_of(projector, photons, Task(signal, beta))
    # 1.5 % apart; 21 % where each view is kept from negative powers.
    assert found(np.ones(16)) == pytest.approx(exact, rel=0.05)


def test_bad_input_is_told() -> None:
    with pytest.raises(InputError, match="not all 0"):
        Task(np.zeros(SHAPE), 1.0)
    with pytest.raises(InputError, match="beta is 0"):
        Task(np.ones(SHAPE), 0.0)
    views = commanded_views(CircleTrajectory(kind="circle", views=2), Panel(8, 8, 8.0, 8.0))
    projector = Projector(views, VolumeGrid((8, 8, 8), 4.0))
    with pytest.raises(InputError, match=r"photons has shape \(2, 8, 7\)"):
        detectability_of(projector, np.ones((2, 8, 7)), Task(np.ones((8, 8, 8)), 1.0))
    with pytest.raises(InputError, match=r"the signal has \(6, 7, 8\)"):
        detectability_of(projector, np.ones((2, 8, 8)), Task(np.ones(SHAPE), 1.0))


@pytest.mark.parametrize("sigma", [0.0, 1.0, 2.5])
def test_blur_of_a_gaussian_is_known_by_formula(sigma) -> None:
    """Where all is seen equally well: d' is multiplied by (1 + sigma^2 / 2 s^2)^-3/2."""
    s, size = 2.0, 32
    z, y, x = np.indices((size,) * 3) - size // 2
    task = Task(np.exp(-(z * z + y * y + x * x) / (2 * s * s)), 1e-9)
    found = Detectability(task, np.full((3, size, size, size // 2 + 1), 5.0, np.float32))
    expected = found([1, 1, 1]) * (1 + sigma**2 / (2 * s * s)) ** -1.5
    assert found.blurred([0, 1, 2], sigma) == pytest.approx(expected, rel=1e-3)
