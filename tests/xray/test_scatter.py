"""The scatter estimate against a Monte Carlo calculation of our own, and its conservation laws."""

import numpy as np
import pytest
import xraylib

from twinct.specimen.materials import material
from twinct.xray.scatter import ELECTRON_KEV, ScatterKernel, compton_per_mm, klein_nishina

WATER = material("water")
KEV = 80.0
SOD, SDD = 300.0, 600.0
PITCH, PIXELS = 5.0, 61


def ball_chords(radius):
    """Path in a ball half-way between a point source and the panel, (PIXELS, PIXELS), mm."""
    x = (np.arange(PIXELS) - PIXELS // 2) * PITCH
    r = np.hypot(x[None], x[:, None])
    offset = SOD * r / np.hypot(r, SDD)
    return 2 * np.sqrt(np.maximum(radius**2 - offset**2, 0))


def monte_carlo(radius, photons, rng):
    """Scattered over primary energy at the middle 100 mm of the panel; all orders of scattering.

    Photoelectric absorption, Compton scattering by free electrons; straight flight in a ball of
    water at the origin, the source at z = -SOD, the panel at z = SDD - SOD.
    """
    half = np.arctan((PIXELS * PITCH / 2) / SDD)
    cosine = rng.uniform(np.cos(half * np.sqrt(2)), 1, photons)
    turn = rng.uniform(0, 2 * np.pi, photons)
    sine = np.sqrt(1 - cosine**2)
    direction = np.stack([sine * np.cos(turn), sine * np.sin(turn), cosine], axis=1)
    at_panel = direction[:, :2] / direction[:, 2:] * SDD
    inside = (np.abs(at_panel) < PIXELS * PITCH / 2).all(axis=1)
    direction = direction[inside]
    position = np.tile([0.0, 0.0, -SOD], (len(direction), 1))
    energy = np.full(len(direction), KEV)
    order = np.zeros(len(direction), int)
    scored = np.zeros(2)
    grid = np.linspace(5, KEV + 1, 200)
    total = np.array([WATER.mu_per_mm(e) for e in grid])
    total -= [
        WATER.density_g_cm3 * xraylib.CS_Rayl_CP("H2O", e) / 10 for e in grid
    ]  # coherent scattering is left out on both sides
    compton = np.array([compton_per_mm(WATER, e) for e in grid])
    while len(position):
        b = np.einsum("ij,ij->i", position, direction)
        root = b**2 - np.einsum("ij,ij->i", position, position) + radius**2
        hits = root > 0
        near = np.where(hits, np.maximum(-b - np.sqrt(np.maximum(root, 0)), 0), np.inf)
        far = np.where(hits, -b + np.sqrt(np.maximum(root, 0)), -np.inf)
        flight = near + rng.exponential(1 / np.interp(energy, grid, total))
        leaves = ~(flight < far)
        # Who leaves is scored where it meets the panel.
        out = leaves & (direction[:, 2] > 0)
        reach = (SDD - SOD - position[out, 2]) / direction[out, 2]
        spot = position[out, :2] + reach[:, None] * direction[out, :2]
        middle = (np.abs(spot) < 50).all(axis=1)
        scattered = order[out] > 0
        scored += [
            energy[out][middle & ~scattered].sum(),
            energy[out][middle & scattered].sum(),
        ]
        share = np.interp(energy, grid, compton) / np.interp(energy, grid, total)
        stays = ~leaves & (rng.random(len(position)) < share)
        position = position[stays] + flight[stays, None] * direction[stays]
        direction, energy, order = direction[stays], energy[stays], order[stays] + 1
        angles = np.linspace(-1, 1, 401)
        levels = np.arange(5, KEV + 1, 5)
        chosen = np.empty(len(energy))
        for level in levels:
            group = np.abs(energy - level) <= 2.5
            density = klein_nishina(angles, level)
            cumulative = np.concatenate([[0], np.cumsum((density[1:] + density[:-1]) / 2)])
            chosen[group] = np.interp(rng.random(group.sum()), cumulative / cumulative[-1], angles)
        energy = energy / (1 + energy / ELECTRON_KEV * (1 - chosen))
        turn = rng.uniform(0, 2 * np.pi, len(energy))
        helper = np.where(np.abs(direction[:, 2:]) < 0.9, [[0, 0, 1.0]], [[1.0, 0, 0]])
        side = np.cross(direction, helper)
        side /= np.linalg.norm(side, axis=1, keepdims=True)
        up = np.cross(direction, side)
        sine = np.sqrt(np.maximum(1 - chosen**2, 0))[:, None]
        direction = chosen[:, None] * direction + sine * (
            np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * up
        )
        alive = energy > 10
        position, direction = position[alive], direction[alive]
        energy, order = energy[alive], order[alive]
    return scored[1] / scored[0]


def estimate(radius):
    lengths = ball_chords(radius)
    mu = WATER.mu_per_mm(KEV) - WATER.density_g_cm3 * xraylib.CS_Rayl_CP("H2O", KEV) / 10
    x = (np.arange(PIXELS) - PIXELS // 2) * PITCH
    beam = (1 + (x[None] ** 2 + x[:, None] ** 2) / SDD**2) ** -1.5
    primary = beam * np.exp(-mu * lengths)
    scattered = (primary * compton_per_mm(WATER, KEV) * lengths).astype(np.float32)
    spread = ScatterKernel(KEV).spread(scattered, PITCH, PITCH, SDD - SOD)
    middle = (np.abs(x[None]) < 50) & (np.abs(x[:, None]) < 50)
    return spread[middle].sum() / primary[middle].sum()


@pytest.mark.parametrize(
    ("radius", "low", "high"), [(25.0, 0.85, 1.15), (50.0, 0.8, 1.1), (80.0, 0.6, 1.1)]
)
def test_the_estimate_against_monte_carlo(radius, low, high):
    reference = monte_carlo(radius, 800_000, np.random.default_rng(1))
    found = estimate(radius)
    print(f"radius {radius}: scatter/primary {found:.4f}, Monte Carlo {reference:.4f}")  # noqa: T201
    assert low < found / reference < high


def test_the_kernel_takes_no_more_than_what_was_scattered():
    one = np.zeros((201, 201), np.float32)
    one[100, 100] = 1.0
    near = ScatterKernel(60.0).spread(one, 4.0, 4.0, 30.0)
    # Nearly all that is scattered forwards meets a panel this near.
    angles = np.linspace(0, 1, 1001)
    forwards = 2 * np.pi * np.trapezoid(klein_nishina(angles, 60.0), angles)
    assert 0.9 * forwards < near.sum() < forwards
    twice = ScatterKernel(60.0, scale=2.0).spread(one, 4.0, 4.0, 30.0)
    np.testing.assert_allclose(twice, 2 * near)


def test_scatter_does_not_depend_on_the_pixels():
    rng = np.random.default_rng(2)
    coarse = rng.random((30, 40)).astype(np.float32)
    fine = np.repeat(np.repeat(coarse, 4, axis=0), 4, axis=1) / 16
    a = ScatterKernel(80.0).spread(coarse, 4.0, 4.0, 200.0)
    b = ScatterKernel(80.0).spread(fine, 1.0, 1.0, 200.0)
    np.testing.assert_allclose(b.reshape(30, 4, 40, 4).sum(axis=(1, 3)), a, rtol=0.02)
