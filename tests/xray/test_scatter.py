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
X = (np.arange(PIXELS) - PIXELS // 2) * PITCH
HALF_MM = 47.5
MIDDLE = np.ix_(np.abs(X) < HALF_MM, np.abs(X) < HALF_MM)


def ball_chords(radius):
    """Path in a ball half-way between a point source and the panel, (PIXELS, PIXELS), mm."""
    r = np.hypot(X[None], X[:, None])
    offset = SOD * r / np.hypot(r, SDD)
    return 2 * np.sqrt(np.maximum(radius**2 - offset**2, 0))


def primary(radius):
    """Free beam and attenuation, without coherent scatter, which is left out on both sides."""
    mu = WATER.mu_per_mm(KEV) - WATER.density_g_cm3 * xraylib.CS_Rayl_CP("H2O", KEV) / 10
    beam = (1 + (X[None] ** 2 + X[:, None] ** 2) / SDD**2) ** -1.5
    return beam * np.exp(-mu * ball_chords(radius))


def monte_carlo(radius, photons, rng):
    """Scattered over primary energy at the middle 95 mm of the panel; all orders of scattering.

    Photoelectric absorption, Compton scattering by free electrons; straight flight in a ball of
    water at the origin, the source at z = -SOD, the panel at z = SDD - SOD. Photons start towards
    the ball only; the primary energy is that of Beer and Lambert.
    """
    lowest = np.sqrt(1 - (radius / SOD) ** 2)
    cosine = rng.uniform(lowest, 1, photons)
    turn = rng.uniform(0, 2 * np.pi, photons)
    sine = np.sqrt(1 - cosine**2)
    direction = np.stack([sine * np.cos(turn), sine * np.sin(turn), cosine], axis=1)
    at_panel = direction[:, :2] / direction[:, 2:] * SDD
    inside = (np.abs(at_panel) < PIXELS * PITCH / 2).all(axis=1)
    direction = direction[inside]
    position = np.tile([0.0, 0.0, -SOD], (len(direction), 1))
    energy = np.full(len(direction), KEV)
    scattered, flown = 0.0, False
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
        middle = (np.abs(spot) < HALF_MM).all(axis=1)
        if flown:  # the first flight is the primary beam's
            scattered += energy[out][middle].sum()
        flown = True
        share = np.interp(energy, grid, compton) / np.interp(energy, grid, total)
        stays = ~leaves & (rng.random(len(position)) < share)
        position = position[stays] + flight[stays, None] * direction[stays]
        direction, energy = direction[stays], energy[stays]
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
        energy = energy[alive]
    per_sr = photons / (2 * np.pi * (1 - lowest))
    return scattered / (per_sr * KEV / SDD**2 * primary(radius)[MIDDLE].sum() * PITCH**2)


def estimate(radius):
    beam = primary(radius)
    scattered = (beam * compton_per_mm(WATER, KEV) * ball_chords(radius)).astype(np.float32)
    spread = ScatterKernel(KEV).spread(scattered, PITCH, PITCH, SDD - SOD)
    return spread[MIDDLE].sum() / beam[MIDDLE].sum()


# The estimate is short of multiple scatter, and behind the largest ball of that from rays beside
# the panel. Tolerances: three standard deviations of the reference.
@pytest.mark.parametrize(
    ("radius", "share", "tolerance"),
    [(25.0, 0.89, 0.05), (50.0, 0.82, 0.03), (80.0, 0.77, 0.11), (100.0, 0.62, 0.07)],
)
def test_the_estimate_against_monte_carlo(figure, radius, share, tolerance):
    reference = monte_carlo(radius, 800_000, np.random.default_rng(1))
    found = estimate(radius)
    figure(f"radius {radius}: scatter/primary {found:.4f}, Monte Carlo {reference:.4f}")
    assert found / reference == pytest.approx(share, rel=tolerance)


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
