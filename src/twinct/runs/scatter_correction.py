"""Correction of scatter: that of a first volume, simulated and subtracted from the images.

The images need no scenario, only their beam, panel and geometry: a coarse volume, reconstructed
from them, becomes a body. A voxel's attenuation at the detected mean energy makes it a mixture:
tissue at a part of its density up to the attenuation of tissue, volume shares of both materials
between, and the dense one at more than its density beyond. The line integrals are those of both
materials. The images are divided by the free beam, and so is the scatter.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import InputError
from twinct.core.progress import Progress
from twinct.geometry import ScanGeometry, VolumeGrid
from twinct.recon.memory import SPARE_BYTES
from twinct.recon.projector import Projector
from twinct.recon.sart import sart
from twinct.recon.sections.scatter import ScatterCorrection
from twinct.runs.integrals import RELAXATION
from twinct.scan import Scan
from twinct.scan.integrals import DARKEST, line_integrals
from twinct.scenario import Reconstruction
from twinct.scenario.imported import ScanSettings, beam_of
from twinct.specimen.materials import Material, material
from twinct.xray.build import (
    build_beam,
    build_grid,
    build_panel_response,
    build_response,
    build_spectrum,
    effective_energy_kev,
)
from twinct.xray.hardening import Hardening
from twinct.xray.response import PhotonResponse
from twinct.xray.signal import Signal
from twinct.xray.spectrum import PhotonSpectrum

_KEY = "reconstruction.scatter"

Share = NDArray[np.floating]
"""Share of a material in each voxel, (z, y, x)."""

STEPS = 8
"""Steps of expectation maximisation for images = primary + scatter, in each round.

The scatter of an early body, which attenuates too little, may exceed the images: their difference
would be no image, and its volume full of streaks. In a head at 120 kVp two rounds left 38 % of the
error by 1 step, 10 % by 8, and 9 % by 30, while air still scattered (``LIGHTEST``); now they leave
11 % by 8 (``benchmarks/bench_scatter_correction.py``).
"""

LIGHTEST = 0.13
"""Least attenuation of a voxel that is not air, relative to tissue: half of that of lung.

A coarse volume has a haze in the air. It scatters without attenuation: that of a head at 120 kVp,
4 % of its mass, made 17 % of the scatter, and this limit leaves 5 %.
"""

_SEED = 1
"""Simulated scans have the seed 0: the noise of their scatter must not be that of the estimate."""


def scatter_subtracted(scan: Scan, views: ScanGeometry, progress: Progress) -> Scan:
    """Return the scan without its scatter, as its section ``reconstruction.scatter`` states.

    Args:
        scan: the images, divided by the free beam.
        views: their geometry.
        progress: receives the progress, by rounds.

    Raises:
        InputError: the beam is not known, or an energy is outside the tables.
    """
    settings = scan.settings
    section = settings.reconstruction.scatter
    if section is None:
        return scan
    from twinct.transport import VoxelBody
    from twinct.xray.monte_carlo_scatter import ScatterNodes

    source, detector = beam_of(settings, _KEY), settings.detector
    beam, response = build_beam(source), build_response(detector)
    spectrum, bare = beam.spectrum, build_panel_response(detector)
    before = build_grid(detector)
    energy = effective_energy_kev(source, detector)
    tissue, dense = _materials(section)
    grid = _coarse_grid(settings.reconstruction, section.voxel_mm)
    binning = _binning(views, grid, section.voxel_mm)
    A = Projector(views.binned(*binning), grid)
    known = spectrum, response, tissue, dense, energy
    volumes = _FirstVolumes(A, known, section.first_iterations)
    scatter = np.zeros_like(scan.transmission)
    primary = scan.transmission.copy()
    with progress.stage("scatter", section.rounds) as step:
        for _ in range(section.rounds):
            for _ in range(STEPS):
                primary *= scan.transmission / np.maximum(primary + scatter, DARKEST)
            integrals = line_integrals(_binned(primary, *binning))
            of_tissue, of_dense = volumes.shares(integrals)
            body = VoxelBody.of_shares(grid, [(tissue, of_tissue), (dense, of_dense)])
            nodes = ScatterNodes(body, views, beam, bare, before, section, _SEED)
            for image, view in zip(scatter, views, strict=True):
                image[:] = nodes.image(view) / Signal.lit(beam, before, response, view)[0]
            step()
    return replace(scan, transmission=scan.transmission - scatter)


def scatter_bytes(section: Reconstruction, pixels: int) -> int:
    """Return the bytes that ``scatter_subtracted`` allocates; ``pixels`` counts all views."""
    assert section.scatter is not None
    voxels = math.prod(_coarse_grid(section, section.scatter.voxel_mm).shape)
    # Scatter, primary and sums of the images; of a voxel three shares, five masses and indices.
    return 16 * pixels + 80 * voxels + SPARE_BYTES


def check_scatter_correction(settings: ScanSettings) -> None:
    """Check materials and energies of the correction before any work.

    Raises:
        InputError: the beam is not known, a material is unknown, an energy is outside the tables,
            or the dense material attenuates no more than tissue.
    """
    section = settings.reconstruction.scatter
    if section is None:
        return
    from twinct.transport.cross_sections import require_energies

    source = beam_of(settings, _KEY)
    require_energies(build_spectrum(source).energies_kev, "source")
    energy = effective_energy_kev(source, settings.detector)
    tissue, dense = _materials(section)
    low, high = tissue.mu_per_mm(energy), dense.mu_per_mm(energy)
    if high <= low:
        raise InputError(
            f"{_KEY}.dense: {dense.name} attenuates by {high:.3g}/mm at {energy:.4g} keV, "
            f"{_KEY}.tissue: {tissue.name} by {low:.3g}/mm: dense must exceed tissue"
        )


def _materials(section: ScatterCorrection) -> tuple[Material, Material]:
    """Return tissue and dense material."""
    tissue, dense = section.tissue, section.dense
    return material(tissue, f"{_KEY}.tissue"), material(dense, f"{_KEY}.dense")


def _coarse_grid(section: Reconstruction, voxel_mm: float) -> VolumeGrid:
    """Return coarse voxels of the grid and its surroundings."""
    whole = section.grid.volume_grid
    margin = section.surroundings.margin_mm if section.surroundings else 0.0
    shape = np.ceil((whole.size_mm + 2 * margin) / voxel_mm).astype(int)
    return VolumeGrid(shape[::-1].tolist(), voxel_mm, whole.world_from_grid)


def _binning(views: ScanGeometry, grid: VolumeGrid, voxel_mm: float) -> tuple[int, int]:
    """Return rows and columns of a pixel as coarse as the voxels in the middle of the grid."""
    middle, panel = grid.world_from_grid.position, views.panel
    shrink = np.linalg.norm(views.source - middle, axis=1) / views.sdd_to_centre
    pixel_mm = voxel_mm / float(shrink.mean())
    rows, columns = (max(1, int(pixel_mm / pitch)) for pitch in (panel.pitch_v, panel.pitch_u))
    return min(rows, panel.rows), min(columns, panel.columns)


def _binned(images: NDArray[np.float32], rows: int, columns: int) -> NDArray[np.float32]:
    """Return the mean of blocks of pixels, as ``Panel.binned`` has them."""
    height, width = images.shape[1] // rows, images.shape[2] // columns
    whole = images[:, : height * rows, : width * columns]
    blocks = whole.reshape(len(images), height, rows, width, columns)
    return blocks.mean(axis=(2, 4), dtype=np.float64).astype(np.float32)


class _FirstVolumes:
    """Volumes of two materials, from line integrals of both.

    The dense paths are those of the volume before; a first volume takes all for tissue.
    """

    def __init__(
        self,
        A: Projector,
        known: tuple[PhotonSpectrum, PhotonResponse, Material, Material, float],
        iterations: int,
    ) -> None:
        """Store the projector, and spectrum, response, tissue, dense material and energy."""
        self._A, self._known, self._iterations = A, known, iterations
        self._paths: NDArray[np.float32] | None = None

    def shares(self, integrals: NDArray[np.float32]) -> tuple[Share, Share]:
        """Return the shares of tissue and dense material in each voxel."""
        if self._paths is None:
            self._next(integrals)
        return self._next(integrals)

    def _next(self, integrals: NDArray[np.float32]) -> tuple[Share, Share]:
        spectrum, response, tissue, dense, energy = self._known
        if self._paths is None:
            linear = Hardening(spectrum, response, [tissue], energy).correct(integrals)
        else:
            longest = float(self._paths.max())
            both = Hardening(spectrum, response, [tissue, dense], energy, longest)
            linear = both.correct(integrals, self._paths)
        volume = sart(self._A, linear, iterations=self._iterations, relaxation=RELAXATION).array
        found = _shares(volume, tissue, dense, energy)
        self._paths = self._A(found[1].astype(np.float32))
        return found


def _shares(
    volume: NDArray[np.float32], tissue: Material, dense: Material, energy: float
) -> tuple[Share, Share]:
    """Return the shares of two materials in each voxel, by its attenuation."""
    low, high = tissue.mu_per_mm(energy), dense.mu_per_mm(energy)
    mu = np.where(volume < LIGHTEST * low, 0.0, volume)
    between = np.clip((mu - low) / (high - low), 0.0, 1.0)
    of_tissue = np.where(mu < low, mu / low, 1 - between)
    of_dense = np.where(mu > high, mu / high, between)
    return of_tissue, of_dense
