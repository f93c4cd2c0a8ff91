"""Distributions of angles and free paths, against xraylib and the exponential law."""

import math

import numpy as np
import pytest
import scipy.integrate
import scipy.stats
import xraylib

from twinct.geometry import VolumeGrid
from twinct.specimen.materials import Material, material
from twinct.transport import VoxelBody
from twinct.transport._angles import scatter_compton, scatter_rayleigh
from twinct.transport._flight import fly
from twinct.transport._random import stream
from twinct.transport.cross_sections import (
    COMPTON,
    COMPTON_NORM,
    RAYLEIGH,
    RAYLEIGH_NORM,
    TOTAL,
    TRANSFER,
    Media,
    energies_kev,
    media_tables,
)

SAMPLES = 10_000
LEAST_P = 1e-3
"""Of the tests here; the seeds are fixed, so that they pass or fail for good."""


def _weights(medium: Material) -> list[tuple[int, float]]:
    return [(xraylib.SymbolToAtomicNumber(s), w) for s, w in medium.mass_fractions.items()]


def _differential(medium: Material, energy: float, kind: str):
    """Return d sigma / d theta of a material by xraylib, cm^2/g/rad."""
    function = {"compton": xraylib.DCS_Compt, "rayleigh": xraylib.DCS_Rayl}[kind]

    def value(theta: float) -> float:
        per_angle = sum(w * function(z, energy, theta) for z, w in _weights(medium))
        return per_angle * 2 * math.pi * math.sin(theta)

    return value


def _shares(medium: Material, energy: float, kind: str, edges: np.ndarray) -> np.ndarray:
    """Return the share of scattered photons between angles, by integration."""
    value = _differential(medium, energy, kind)
    # xraylib's functions begin at a small momentum transfer.
    edges = np.maximum(edges, 5e-3)
    parts = [
        scipy.integrate.quad(value, a, b, limit=200)[0]
        for a, b in zip(edges[:-1], edges[1:], strict=True)
    ]
    return np.array(parts) / sum(parts)


def _cosines(kernel, media: Media, energy: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    state = np.uint64(stream.py_func(np.uint64(seed), 0))
    cosines, rest = [], []
    for _ in range(SAMPLES):
        state, *values = kernel(np.uint64(state), media, 0, energy)
        cosines.append(values[0])
        rest.append(values[-1])
    return np.array(cosines), np.array(rest)


@pytest.mark.parametrize("name, energy", [("water", 16.8), ("bone", 60.0), ("titanium", 140.0)])
@pytest.mark.parametrize("kind", ["compton", "rayleigh"])
def test_angles_follow_the_cross_sections(name: str, energy: float, kind: str) -> None:
    """Sampled angles have the distribution of xraylib's differential cross sections."""
    medium = material(name)
    media = media_tables([medium])
    kernel = {"compton": scatter_compton, "rayleigh": scatter_rayleigh}[kind]
    cosines, rest = _cosines(kernel, media, energy, seed=7)
    # Angles of about equal numbers of photons: 20 bins of the samples of another seed.
    other, _ = _cosines(kernel, media, energy, seed=8)
    edges = np.quantile(np.arccos(other), np.linspace(0, 1, 21))
    edges[0], edges[-1] = 0.0, math.pi
    counts = np.histogram(np.arccos(cosines), edges)[0]
    shares = _shares(medium, energy, kind, edges)
    assert scipy.stats.chisquare(counts, shares * SAMPLES).pvalue > LEAST_P
    if kind == "compton":
        expected = [xraylib.ComptonEnergy(energy, math.acos(c)) / energy for c in cosines[:50]]
        np.testing.assert_allclose(rest[:50], expected, rtol=1e-5)  # of the electron's mass


@pytest.mark.parametrize("name", ["water", "bone", "titanium"])
def test_tables_agree_with_xraylib(name: str) -> None:
    """Coefficients between the nodes, transferred energy and norms are those of xraylib."""
    medium = material(name)
    table = media_tables([medium]).coefficients[0].astype(np.float64)
    for energy in (5.437, 16.8123, 56.4178, 119.961):
        row = [np.interp(energy, energies_kev(), column) for column in table.T]
        for column, function in (
            (COMPTON, xraylib.CS_Compt),
            (RAYLEIGH, xraylib.CS_Rayl),
            (TOTAL, xraylib.CS_Total),
        ):
            expected = sum(w * function(z, energy) for z, w in _weights(medium)) / 10
            assert row[column] == pytest.approx(expected, rel=5e-4)  # K edge of titanium: 4.97 keV
        photo = sum(w * xraylib.CS_Photo(z, energy) for z, w in _weights(medium)) / 10
        value = _differential(medium, energy, "compton")
        whole = scipy.integrate.quad(value, 1e-2, math.pi, limit=200)[0]

        def given(theta: float, value=value, energy=energy) -> float:
            return value(theta) * (energy - xraylib.ComptonEnergy(energy, theta))

        mean = scipy.integrate.quad(given, 1e-2, math.pi, limit=200)[0] / whole
        assert row[TRANSFER] == pytest.approx(photo * energy + row[COMPTON] * mean, rel=1e-3)
        # The shapes by their norms are the differential cross sections, up to one factor.
        radius_cm2 = 2.8179403e-13**2
        per_gram = radius_cm2 * 6.02214076e23
        assert row[COMPTON_NORM] * per_gram == pytest.approx(whole, rel=1e-3)
        whole = scipy.integrate.quad(
            _differential(medium, energy, "rayleigh"), 0, math.pi, limit=400
        )[0]
        assert row[RAYLEIGH_NORM] * per_gram == pytest.approx(whole, rel=1e-3)


def test_free_paths_are_exponential_in_mixed_voxels() -> None:
    """The optical depth of flights through air, water and metal is exponential: no bias by bricks.

    The depth at each collision comes from an integral by small steps, without the kernels.
    """
    rng = np.random.default_rng(3)
    grid = VolumeGrid((20, 22, 24), [2.0, 3.0, 2.5])
    labels = rng.choice(4, grid.shape, p=[0.3, 0.5, 0.15, 0.05])
    labels[:, :8] = 1  # bricks of one material beside mixed ones
    names = ("air", "water", "bone", "titanium")
    body = VoxelBody.of_labels(grid, labels, {i: material(name) for i, name in enumerate(names)})
    voxels, media = body.tables()
    scores = np.zeros(1), np.zeros((0, 0, 0)), False
    energy = 80.0
    index = round((energy - 1.0) / 0.05)
    mu = np.array([material(name).mu_per_mm(energy) for name in names])
    state = np.uint64(11)
    depths, censored = [], []
    step = 0.02
    for _ in range(2000):
        start = np.array([0.5, rng.uniform(0, 66), rng.uniform(0, 50)])
        way = np.array([1.0, rng.normal(0, 0.3), rng.normal(0, 0.3)])
        way /= np.linalg.norm(way)
        state, length = fly(np.uint64(state), *start, *way, index, 0.0, voxels, media, scores)
        end = length if length >= 0 else 200.0
        points = start + np.arange(step / 2, end, step)[:, None] * way
        cells = np.floor(points / grid.voxel).astype(int)
        inside = ((cells >= 0) & (cells < grid.shape_xyz)).all(axis=1)
        cells = cells[inside]
        depth = mu[labels[cells[:, 2], cells[:, 1], cells[:, 0]]].sum() * step
        (depths if length >= 0 else censored).append(depth)
    # Depths known up to where a flight leaves: compare counts of bins with their hazards.
    depths, censored = np.array(depths), np.array(censored)
    edges = np.linspace(0, 2.0, 9)
    chi = 0.0
    for a, b in zip(edges[:-1], edges[1:], strict=True):
        collided = ((depths >= a) & (depths < b)).sum()
        exposure = sum(np.clip(x, a, b).sum() - a * len(x) for x in (depths, censored))
        chi += (collided - exposure) ** 2 / exposure
    assert scipy.stats.chi2(len(edges) - 1).sf(chi) > LEAST_P
    assert len(depths) > 500
