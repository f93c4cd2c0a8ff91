"""Error of the scatter kernel behind balls of water: Monte Carlo of all orders, by optical depth.

    python benchmarks/bench_scatter.py [--photons 2000000]

The ball lies between a point source and the panel. Each row compares the scattered over the primary
energy at the middle 20 mm of the panel. The reference follows photons through photoelectric
absorption and Compton scattering by free electrons, as the kernel's formulas do; coherent
scattering is left out on both sides. It counts orders apart and scores each collision by the energy
that the panel would get from it. Two sum rules check it first: energy in is energy absorbed
plus energy out, and the first order is the integral over the ball.
"""

from __future__ import annotations

import argparse
from itertools import product
from typing import NamedTuple

import numba
import numpy as np
import xraylib

from twinct.geometry import Floats
from twinct.specimen.materials import material
from twinct.xray.scatter import ELECTRON_KEV, ScatterKernel, compton_per_mm, klein_nishina

WATER = material("water")
HALF_MM = 10.0
"""Half the edge of the square at the panel's middle that counts."""
PITCH_MM = 2.0
WIDE_MM = 1600.0
"""Edge of a panel that every ray through the largest ball meets."""
SHARES = 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.2
"""Edge of smaller panels, over the diameter of the ball's shadow."""
LOWEST_KEV = 10.0
"""Photons below this energy are absorbed: their mean free path in water is 2 mm."""
DISTANCES = (300.0, 600.0), (750.0, 1000.0)
"""SOD and SDD, mm: half-way, and the ball nearer to the panel, as in the rooms of the scenarios."""
RADII = 10.0, 25.0, 50.0, 65.0, 80.0, 100.0, 125.0, 150.0
ENERGIES = 40.0, 60.0, 80.0, 100.0, 120.0


class Truth(NamedTuple):
    """Scattered over primary energy, of all orders and of the first, and the energy balance."""

    ratio: float
    first: float
    spread: float
    balance: float


def coefficients() -> tuple[Floats, Floats, Floats]:
    """Return energies, and attenuation without coherent scattering and Compton part there, 1/mm."""
    kev = np.arange(5.0, 151.0)
    coherent = [WATER.density_g_cm3 * xraylib.CS_Rayl_CP("H2O", e) / 10 for e in kev]
    total = np.array([WATER.mu_per_mm(e) for e in kev]) - coherent
    return kev, total, np.array([compton_per_mm(WATER, e) for e in kev])


@numba.njit(cache=False)
def _exit(p, d, radius):
    b = p[0] * d[0] + p[1] * d[1] + p[2] * d[2]
    return -b + np.sqrt(max(b * b - (p[0] ** 2 + p[1] ** 2 + p[2] ** 2) + radius**2, 0.0))


@numba.njit(cache=False)
def _kn(c, kev):
    r = 1 / (1 + kev / ELECTRON_KEV * (1 - c))
    return r * r * (r + 1 / r - (1 - c * c))


@numba.njit(cache=False)
def _follow(photons, seed, radius, kev, sod, sdd, half, beam, total, compton, norm):
    """Return scored energy of first and all orders per photon, energy absorbed and let out.

    Photons that would miss the square of half the edge ``beam`` on the panel are stopped: they
    count as let out.
    """
    np.random.seed(seed)
    lowest = np.sqrt(1 - (radius / sod) ** 2)
    first, every, absorbed, out = 0.0, 0.0, 0.0, 0.0
    p, d, to, side, up = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for _ in range(photons):
        c, turn = np.random.uniform(lowest, 1.0), np.random.uniform(0.0, 2 * np.pi)
        s = np.sqrt(1 - c * c)
        d[0], d[1], d[2] = s * np.cos(turn), s * np.sin(turn), c
        if max(abs(s * np.cos(turn)), abs(s * np.sin(turn))) * sdd > beam * c:
            out += kev
            continue
        near = sod * c - np.sqrt(max(radius**2 - (sod * s) ** 2, 0.0))
        p[0], p[1], p[2] = near * d[0], near * d[1], near * d[2] - sod
        energy, weight, order = kev, 1.0, 0
        while True:
            at = energy - 5.0
            i = int(at)
            mu = total[i] + (at - i) * (total[i + 1] - total[i])
            way = _exit(p, d, radius)
            if order == 0:  # the first collision is forced; the rest passes as primary
                inside = 1 - np.exp(-mu * way)
                out += (1 - inside) * energy
                weight = inside
                flight = -np.log(1 - np.random.random() * inside) / mu
            else:
                flight = -np.log(1 - np.random.random()) / mu
                if flight >= way:
                    out += weight * energy
                    break
            for k in range(3):
                p[k] += flight * d[k]
            share = (compton[i] + (at - i) * (compton[i + 1] - compton[i])) / mu
            absorbed += weight * (1 - share) * energy
            weight *= share
            order += 1
            # Energy that a random point of the square gets from this collision, per mm^2.
            to[0] = np.random.uniform(-half, half) - p[0]
            to[1] = np.random.uniform(-half, half) - p[1]
            to[2] = sdd - sod - p[2]
            far = np.sqrt(to[0] ** 2 + to[1] ** 2 + to[2] ** 2)
            for k in range(3):
                to[k] /= far
            c = d[0] * to[0] + d[1] * to[1] + d[2] * to[2]
            j = energy - 5.0
            ni = norm[int(j)] + (j - int(j)) * (norm[int(j) + 1] - norm[int(j)])
            after = energy / (1 + energy / ELECTRON_KEV * (1 - c))
            if after > 6.0:
                j = after - 5.0
                m = total[int(j)] + (j - int(j)) * (total[int(j) + 1] - total[int(j)])
                scored = weight * after * _kn(c, energy) / ni * to[2] / far**2
                scored *= np.exp(-m * _exit(p, to, radius))
                every += scored
                if order == 1:
                    first += scored
            while True:  # Klein-Nishina by rejection: at most 2
                c = np.random.uniform(-1.0, 1.0)
                if np.random.uniform(0.0, 2.0) < _kn(c, energy):
                    break
            after = energy / (1 + energy / ELECTRON_KEV * (1 - c))
            absorbed += weight * (energy - after)
            energy = after
            if energy < LOWEST_KEV:
                absorbed += weight * energy
                break
            turn, s = np.random.uniform(0.0, 2 * np.pi), np.sqrt(1 - c * c)
            k = 0 if abs(d[0]) < 0.6 else 1
            dot = d[k]
            for n in range(3):
                side[n] = (1.0 if n == k else 0.0) - dot * d[n]
            length = np.sqrt(side[0] ** 2 + side[1] ** 2 + side[2] ** 2)
            for n in range(3):
                side[n] /= length
            up[0] = d[1] * side[2] - d[2] * side[1]
            up[1] = d[2] * side[0] - d[0] * side[2]
            up[2] = d[0] * side[1] - d[1] * side[0]
            for n in range(3):
                d[n] = c * d[n] + s * (np.cos(turn) * side[n] + np.sin(turn) * up[n])
    return first / photons, every / photons, absorbed / photons, out / photons


def monte_carlo(
    radius: float, kev: float, sod: float, sdd: float, photons: int, beam: float = np.inf
) -> Truth:
    """Return the reference behind a ball; ``spread`` is one standard deviation of the ratio.

    ``beam`` is half the edge of the square on the panel that a collimator lets the beam reach, mm.
    """
    grid, total, compton = coefficients()
    angles = np.linspace(-1, 1, 2001)
    norm = np.array([2 * np.pi * np.trapezoid([_kn(c, e) for c in angles], angles) for e in grid])
    batches = 8
    runs = np.array(
        [
            _follow(
                photons // batches, seed, radius, kev, sod, sdd, HALF_MM, beam, total, compton, norm
            )
            for seed in range(batches)
        ]
    )
    solid = 2 * np.pi * (1 - np.sqrt(1 - (radius / sod) ** 2))
    x = ((np.arange(200) + 0.5) / 100 - 1) * HALF_MM
    direct = kev / solid * np.mean(_primary(x, radius, kev, sod, sdd)) / sdd**2
    ratio = runs[:, 1] / direct
    balance = float((runs[:, 2] + runs[:, 3]).mean() / kev)
    spread = float(ratio.std(ddof=1) / np.sqrt(batches))
    return Truth(float(ratio.mean()), float(runs[:, 0].mean() / direct), spread, balance)


def first_order(radius: float, kev: float, sod: float, sdd: float, cells: int = 160) -> float:
    """Return the first order's ratio at the panel's middle, as an integral over the ball."""
    grid, total, _ = coefficients()
    edges: Floats = (np.arange(cells) + 0.5) / cells * 2 - 1
    z, r = np.meshgrid(edges * radius, (edges + 1) / 2 * radius, indexing="ij")
    keep = np.hypot(z, r) < radius
    z, r = z[keep], r[keep]
    volume = 2 * np.pi * r * (2 * radius / cells) * (radius / cells)
    point = np.stack([r, 0 * r, z], axis=1)
    incoming = point + [0, 0, sod]
    before = np.linalg.norm(incoming, axis=1)
    incoming /= before[:, None]
    to = [0, 0, sdd - sod] - point
    far = np.linalg.norm(to, axis=1)
    to /= far[:, None]
    cosine = (incoming * to).sum(1)
    after = kev / (1 + kev / ELECTRON_KEV * (1 - cosine))

    def out(d: Floats) -> Floats:
        b = (point * d).sum(1)
        return -b + np.sqrt(np.maximum(b**2 - (point**2).sum(1) + radius**2, 0))

    mu = np.interp(kev, grid, total)
    flux = np.exp(-mu * out(-incoming)) / before**2
    gets = flux * compton_per_mm(WATER, kev) * klein_nishina(cosine, kev) * after / kev
    gets *= np.exp(-np.interp(after, grid, total) * out(to)) * to[:, 2] / far**2
    return float((gets * volume).sum() * sdd**2 / np.exp(-mu * 2 * radius))


def _primary(x: Floats, radius: float, kev: float, sod: float, sdd: float) -> Floats:
    grid, total, _ = coefficients()
    beam = (1 + (x[None] ** 2 + x[:, None] ** 2) / sdd**2) ** -1.5
    return beam * np.exp(-np.interp(kev, grid, total) * chords(x, radius, sod, sdd))


def chords(x: Floats, radius: float, sod: float, sdd: float) -> Floats:
    """Return the path in the ball of the rays to a square panel's points, mm."""
    r = np.hypot(x[None], x[:, None])
    return 2 * np.sqrt(np.maximum(radius**2 - (sod * r / np.hypot(r, sdd)) ** 2, 0))


def estimate(radius: float, kev: float, sod: float, sdd: float, panel: float) -> float:
    """Return the ratio by the kernel, from the rays that a square panel of this edge gets."""
    pixels = int(panel / PITCH_MM) // 2 * 2 + 1
    x: Floats = (np.arange(pixels) - pixels // 2) * np.float64(PITCH_MM)
    beam = _primary(x, radius, kev, sod, sdd)
    scattered = beam * compton_per_mm(WATER, kev) * chords(x, radius, sod, sdd)
    spread = ScatterKernel(kev).spread(scattered.astype(np.float32), PITCH_MM, PITCH_MM, sdd - sod)
    middle = np.ix_(np.abs(x) <= HALF_MM, np.abs(x) <= HALF_MM)
    return float(spread[middle].sum() / beam[middle].sum())


def main() -> None:
    """Print a row for each ball, energy and distance, then for each width of the panel."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--photons", type=int, default=400_000)
    photons = parser.parse_args().photons
    print(f"A panel of {WIDE_MM:.0f} mm, which every ray through the ball meets")
    print("SOD / SDD   keV  radius  mu_C L  scatter/primary    first (integral)  kernel   error")
    for (sod, sdd), kev, radius in product(DISTANCES, ENERGIES, RADII):
        truth = monte_carlo(radius, kev, sod, sdd, photons)
        assert abs(truth.balance - 1) < 1e-9, truth
        kernel = estimate(radius, kev, sod, sdd, WIDE_MM)
        print(
            f"{sod:4.0f}/{sdd:4.0f}  {kev:4.0f}  {radius:6.0f}  {depth(radius, kev):6.2f}  "
            f"{truth.ratio:8.5f} ± {truth.spread:.5f}  {truth.first:.5f} "
            f"({first_order(radius, kev, sod, sdd):.5f})  {kernel:.5f}  "
            f"{100 * (kernel / truth.ratio - 1):+5.1f} %",
            flush=True,
        )
    kev = 80.0
    print(f"Smaller panels, {kev:.0f} keV; the beam is open, or its collimator opens to the panel")
    print("SOD / SDD  radius  panel/shadow   kernel   open   error   collimated   error")
    for (sod, sdd), radius, share in product(DISTANCES, (50.0, 100.0), SHARES):
        half = share * sdd * radius / np.sqrt(sod**2 - radius**2)
        kernel = estimate(radius, kev, sod, sdd, 2 * half)
        beams = [monte_carlo(radius, kev, sod, sdd, photons, beam) for beam in (np.inf, half)]
        text = "   ".join(
            f"{one.ratio:.4f}  {100 * (kernel / one.ratio - 1):+5.1f} %" for one in beams
        )
        print(
            f"{sod:4.0f}/{sdd:4.0f}  {radius:6.0f}  {share:12.2f}  {kernel:.4f}  {text}", flush=True
        )


def depth(radius: float, kev: float) -> float:
    """Return the Compton optical depth of a ball's middle."""
    return 2 * radius * compton_per_mm(WATER, kev)


if __name__ == "__main__":
    main()
