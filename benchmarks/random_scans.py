"""Scans of random objects that nobody tuned on, each drawn from a seed.

A seed draws object, voxels (48 to 160 along an axis), views (30 to 400), photons (300 to infinite),
path (circle, sinusoid, saddle), cone and line integrals. The object is projected from voxels at
least three times finer, on a turned and shifted lattice, with 2 x 2 rays a pixel whose intensities
are averaged; photons are counts. The truth is the mean of the object over each voxel.

Seeds 0 to 99 are for tuning. The error is the root mean square within 3 voxels of the object,
relative to its attenuation.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from random_objects import FAMILIES, RandomObject, random_object, rotation
from scipy import ndimage

from twinct.geometry import Panel, Pose, ScanGeometry, VolumeGrid
from twinct.recon import Projector
from twinct.recon.few_photons import integrals_of_photons

FINER = 3.3
"""Fine voxels per voxel; no whole number, so that both lattices never share planes."""
POINTS = 4
"""Points along each edge of a voxel of which the truth is the mean."""
SAMPLES = 2
NEAR = 3
SPAN_MM = 100.0
TUNING = 100


@dataclass(frozen=True, eq=False)
class RandomScan:
    """One scan, and the truth.

    Attributes:
        seed: it draws everything else.
        family: family of the object.
        path: name of the trajectory.
        photons: free-beam photons of a pixel; None: no noise.
        A: the projector, with the true geometry.
        p: line integrals, (views, rows, columns).
        truth: (z, y, x), 1/mm.
        mu: attenuation of the object's densest large part, 1/mm.
    """

    seed: int
    family: str
    path: str
    photons: float | None
    A: Projector
    p: np.ndarray
    truth: np.ndarray
    mu: float

    @cached_property
    def near(self) -> np.ndarray:
        """Voxels within 3 voxels of the object, (z, y, x)."""
        away = ndimage.distance_transform_edt(self.truth < 0.02 * self.mu)
        return np.asarray(away <= NEAR)

    def error(self, x: np.ndarray) -> float:
        """Return the root mean square error near the object, relative to its attenuation."""
        return float(np.sqrt(np.mean((x - self.truth)[self.near] ** 2, dtype=np.float64))) / self.mu

    def __str__(self) -> str:
        """Return one line."""
        n = max(self.A.domain_shape)
        return f"{self.seed} {self.family} {self.path} {n} {len(self.A)} {self.photons or 0:.0f}"


def random_scan(seed: int, voxels: int | None = None, cache: Path | None = None) -> RandomScan:
    """Draw and make a scan; ``voxels`` along an axis replaces the drawn number."""
    rng = np.random.default_rng([seed, 2026])
    drawn = round(np.exp(rng.uniform(np.log(48), np.log(160))))
    views = round(np.exp(rng.uniform(np.log(30), np.log(400))))
    photons = float(np.exp(rng.uniform(np.log(300), np.log(1e6))))
    photons = None if rng.uniform() < 0.15 else photons
    path = str(rng.choice(["circle", "sinusoid", "saddle"]))
    most, family = rng.uniform(0.5, 4.0), str(rng.choice(list(FAMILIES)))
    made = random_object(rng, family)
    size = voxels or drawn
    grid, geometry = _grid(rng, size), _views(rng, path, views, size)
    A = Projector(geometry, grid)
    file = cache and cache / f"{seed}-{size}.npz"
    if file is not None and file.exists():
        kept = np.load(file)
        p, truth, mu = kept["p"], kept["truth"], float(kept["mu"])
    else:
        p, truth, mu = _measured(rng, made, A, most, photons)
        if file is not None:
            file.parent.mkdir(parents=True, exist_ok=True)
            np.savez(file, p=p, truth=truth, mu=mu)
    return RandomScan(seed, family, path, photons, A, p, truth, mu)


def _grid(rng: np.random.Generator, size: int) -> VolumeGrid:
    """Draw a grid around the ball of the object."""
    room = rng.uniform(1.02, 1.2)
    return VolumeGrid([size] * 3, SPAN_MM * room / size)


def _views(rng: np.random.Generator, path: str, views: int, size: int) -> ScanGeometry:
    """Draw the geometry: the panel sees the whole ball in each view."""
    sod = SPAN_MM * rng.uniform(2.5, 8)
    sdd = sod * rng.uniform(1.3, 2)
    angle = 2 * np.pi * np.arange(views) / views + rng.uniform(0, 2 * np.pi)
    height, waves = np.radians(rng.uniform(10, 30)), {"circle": 0, "sinusoid": 3, "saddle": 2}[path]
    tilt = height * np.cos(waves * angle) if waves else np.zeros(views)
    out = np.stack([np.cos(tilt) * np.cos(angle), np.cos(tilt) * np.sin(angle), np.sin(tilt)], 1)
    u = np.stack([-np.sin(angle), np.cos(angle), np.zeros(views)], axis=1)
    wide = 1.05 * SPAN_MM * sdd / np.sqrt(sod**2 - (SPAN_MM / 2) ** 2)
    pixels = round(size * rng.uniform(0.9, 1.3))
    panel = Panel(pixels, pixels, wide / pixels, wide / pixels)
    return ScanGeometry(sod * out, (sod - sdd) * out, u, np.cross(out, u), panel)


def _measured(
    rng: np.random.Generator, made: RandomObject, A: Projector, most: float, photons: float | None
) -> tuple[np.ndarray, np.ndarray, float]:
    """Return line integrals, the truth, and the attenuation."""
    grid, geometry, radius = A.grid, A.geometry, SPAN_MM / 2
    fine_mm = float(grid.voxel[0]) / FINER
    number = int(np.ceil(SPAN_MM / fine_mm)) + 2
    place = Pose.from_matrix(rng.uniform(-0.5, 0.5, size=3) * fine_mm, rotation(rng))
    fine = VolumeGrid([number] * 3, fine_mm, place)
    volume = made.on(fine, radius)
    panel = geometry.panel
    rows, columns = panel.rows * SAMPLES, panel.columns * SAMPLES
    rays = Panel(rows, columns, panel.pitch_u / SAMPLES, panel.pitch_v / SAMPLES)
    dense = ScanGeometry(geometry.source, geometry.detector, geometry.u, geometry.v, rays)
    lines = Projector(dense, fine)(volume)
    mu = most / float(np.percentile(lines[:: max(1, len(lines) // 16)], 99.5))
    split = np.exp(-mu * lines).reshape(len(A), panel.rows, SAMPLES, panel.columns, SAMPLES)
    beam = split.mean(axis=(2, 4))
    if photons is None:
        p = -np.log(beam)
    else:
        p = integrals_of_photons(rng.poisson(beam * photons) / photons, photons)
    truth = made.on(grid, radius, POINTS) * np.float32(mu)
    return p.astype(np.float32), truth, mu
