"""Images of scatter and of primary photons, against integrals and against escaped energy."""

import math

import numpy as np
import pytest
import xraylib
from transport_bodies import beam_down, box, view

from twinct.geometry import Panel, Pose, ScanGeometry, VolumeGrid
from twinct.specimen.materials import material
from twinct.transport import Beam, Detector, Simulation, VoxelBody

ERRORS = 4
"""Standard errors of a pixel; the seeds are fixed."""


def _path_in_box(start, way, size_mm) -> np.ndarray:
    """Return lengths of rays inside a box about the origin; shapes (..., 3)."""
    with np.errstate(divide="ignore"):
        low, high = (-size_mm / 2 - start) / way, (size_mm / 2 - start) / way
    first, last = np.minimum(low, high).max(-1), np.maximum(low, high).min(-1)
    return np.maximum(last - np.maximum(first, 0), 0)


def _first_collisions(kind: str, energy: float, geometry: ScanGeometry, beam: Beam, size_mm):
    """Return the image of first collisions in a box of water: a sum over its points, by xraylib."""
    medium = material("water")
    atoms = [(xraylib.SymbolToAtomicNumber(s), w) for s, w in medium.mass_fractions.items()]
    function = {"compton": xraylib.DCS_Compt, "rayleigh": xraylib.DCS_Rayl}[kind]
    angles = np.linspace(1e-3, math.pi, 4000)
    # 1/mm/sr: from cm^2/g/sr at 1 g/cm^3.
    table = [sum(w * function(z, energy, a) for z, w in atoms) / 10 for a in angles.tolist()]
    left = [xraylib.ComptonEnergy(energy, a) for a in angles.tolist()]
    energies = np.linspace(10, energy, 400)
    mus = [medium.mu_per_mm(e) for e in energies.tolist()]
    numbers = [round(s / step) for s, step in zip(size_mm, (2.5, 2.5, 5.0), strict=True)]
    axes = [(np.arange(n) + 0.5) / n * s - s / 2 for n, s in zip(numbers, size_mm, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    volume = np.prod([s / n for n, s in zip(numbers, size_mm, strict=True)])
    way = points - beam.source
    distance = np.linalg.norm(way, axis=-1)
    way /= distance[:, None]
    field = way[:, :2] * (beam.distance / -way[:, 2:])
    # From the upper face of the box to the point: the beam is narrower than the box.
    depth = medium.mu_per_mm(energy) * (size_mm[2] / 2 - points[:, 2]) / -way[:, 2]
    lit = np.where((np.abs(field) <= beam.u[0]).all(axis=1), np.exp(-depth) / distance**2, 0)
    panel = geometry.panel.divided(3)
    image = np.zeros(panel.shape)
    normal = np.cross(geometry.u[0], geometry.v[0])
    for r in range(panel.rows):
        for c in range(panel.columns):
            offset = (c - (panel.columns - 1) / 2) * panel.pitch_u * geometry.u[0]
            offset = offset + (r - (panel.rows - 1) / 2) * panel.pitch_v * geometry.v[0]
            out = geometry.detector[0] + offset - points
            length = np.linalg.norm(out, axis=-1)
            out /= length[:, None]
            angle = np.arccos(np.clip((out * way).sum(-1), -1, 1))
            energy_out = np.interp(angle, angles, left) if kind == "compton" else energy
            depth = np.interp(energy_out, energies, mus) * _path_in_box(
                points, out, np.array(size_mm)
            )
            seen = panel.pitch_u * panel.pitch_v * -(out @ normal) / length**2
            per_point = lit * np.interp(angle, angles, table) * np.exp(-depth) * seen * energy_out
            image[r, c] = per_point.sum() * volume / beam.solid_angle
    return image.reshape(panel.rows // 3, 3, -1, 3).sum((1, 3))


@pytest.mark.parametrize("kind, order", [("compton", 0), ("rayleigh", 1)])
def test_single_scatter_is_the_integral_over_the_body(kind: str, order: int) -> None:
    """Images of first collisions in a box of water agree with a sum over the box by xraylib."""
    size = (100.0, 100.0, 40.0)
    body = box((8, 20, 20), 5.0)
    beam = beam_down(40.0, energies_kev=60.0)
    geometry = view((0, 0, 500), (0, 0, -200), panel=Panel(5, 5, 60.0, 60.0))
    simulation = Simulation(body, beam, dose=False, detector=Detector(geometry))
    scores = simulation.run(4000, 40, seed=1)
    image, error = (part[order] for part in scores.scatter())
    expected = _first_collisions(kind, 60.0, geometry, beam, size)
    # 1 % for the sum over points.
    assert (np.abs(image - expected) < ERRORS * error + 0.01 * expected).all()
    whole = 3 * np.sqrt((error**2).sum()) + 0.01 * expected.sum()
    assert image.sum() == pytest.approx(expected.sum(), abs=whole)


def test_all_that_escapes_arrives_on_a_closed_box_of_panels() -> None:
    """Expected signals on six panels about a cube add up to the energy that escapes from it.

    This covers all orders and the normalisation: the escaped energy comes from photons that are
    followed, the signals from the next event's estimate.
    """
    body = box((12, 12, 12), 10.0)
    beam = beam_down(60.0, energies_kev=[50.0, 90.0], photons=[2.0, 1.0])
    panel = Panel(8, 8, 200.0, 200.0)
    total = escaped = 0.0
    for sign, count in ((1.0, 1), (-1.0, 1)):
        geometry = view((0, 0, sign * 500), (0, 0, -sign * 800), v=(0, sign, 0), panel=panel)
        simulation = Simulation(body, beam, dose=False, detector=Detector(geometry))
        scores = simulation.run(8000, 10, seed=5)
        total += count * scores.scatter()[0].sum()
        if sign > 0:
            total += simulation.primary(samples=100).sum()
            escaped = scores.totals[:, 2].sum() / scores.batches / scores.photons
    side = view((-500, 0, 0), (800, 0, 0), u=(0, 0, 1.0), v=(0, 1.0, 0), panel=panel)
    scores = Simulation(body, beam, dose=False, detector=Detector(side)).run(8000, 10, seed=6)
    total += 4 * scores.scatter()[0].sum()
    # 0.4 % standard error; the edges of the beam lie between rays of the primary image.
    assert total == pytest.approx(escaped, rel=0.015)


def test_primary_falls_exponentially_and_with_the_solid_angle() -> None:
    """A pixel of the primary image has its share of the field times exp(-mu L)."""
    energies, photons = np.array([40.0, 80.0]), np.array([1.0, 3.0])
    beam = beam_down(100.0, energies, photons)
    geometry = view((0, 0, 500), (0, 0, 0), panel=Panel(4, 4, 50.0, 50.0))
    grid = VolumeGrid((4, 50, 50), [10.0, 10.0, 5.0], Pose.from_matrix([0, 0, 100], np.eye(3)))
    slab = VoxelBody.of_labels(grid, np.ones(grid.shape, int), {1: material("aluminium")})
    image = Simulation(slab, beam, dose=False, detector=Detector(geometry)).primary(samples=8)
    share = photons / photons.sum()
    x = (np.arange(32) - 15.5) * 6.25
    r = np.sqrt(x**2 + x[:, None] ** 2 + 500.0**2)
    depth = [material("aluminium").mu_per_mm(e) * 20.0 * r / 500.0 for e in energies]
    light = sum(s * e * np.exp(-d) for s, e, d in zip(share, energies, depth, strict=True))
    expected = (light * 500.0 / r**3 * 6.25**2 / beam.solid_angle).reshape(4, 8, 4, 8).sum((1, 3))
    np.testing.assert_allclose(image, expected, rtol=3e-4)  # coefficients linear in 0.05 keV
    nothing = VoxelBody.of_densities(
        grid, np.zeros(grid.shape, int), np.zeros(grid.shape), [material("air")]
    )
    free = Simulation(nothing, beam, dose=False, detector=Detector(geometry)).primary(samples=8)
    assert free.sum() == pytest.approx((share * energies).sum(), rel=1e-3)


def test_frames_of_grid_and_world_agree() -> None:
    """A body turned with its beam and panel has the scores of the unturned one."""
    turn = Pose.from_euler([30.0, -20.0, 50.0], [20.0, -35.0, 70.0])
    rng = np.random.default_rng(2)
    labels = rng.integers(0, 2, (6, 7, 8))
    kinds = {0: material("water"), 1: material("bone")}
    images, energies = [], []
    for pose in (Pose.identity(), turn):
        grid = VolumeGrid(labels.shape, [9.0, 10.0, 11.0], pose)
        body = VoxelBody.of_labels(grid, labels, kinds)
        geometry = view(
            pose.apply(np.array([5.0, 0, 400])),
            pose.apply(np.array([0, 9.0, -150])),
            pose.rotation[:, 0],
            pose.rotation[:, 1],
        )
        beam = Beam.of_view(geometry, 0, 70.0)
        simulation = Simulation(body, beam, detector=Detector(geometry))
        scores = simulation.run(2000, 1)
        images.append(simulation.primary())
        energies.append((scores.voxels, scores.images))
    np.testing.assert_allclose(*images, rtol=1e-9)
    # Photon by photon, up to rounding; a rare photon turns another way.
    np.testing.assert_allclose(energies[0][0].sum(), energies[1][0].sum(), rtol=1e-3)
    np.testing.assert_allclose(energies[0][1].sum(), energies[1][1].sum(), rtol=1e-2)
