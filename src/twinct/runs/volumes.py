"""From a scan to a volume, as the scenario says: any algorithm, checkpoints, progress."""

from __future__ import annotations

import hashlib
import json
import logging
import math
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinct.draws import view_rng
from twinct.files.writing import complete, storage_errors
from twinct.geometry import ScanGeometry, VolumeGrid
from twinct.progress import SILENT, Progress
from twinct.recon import Projector
from twinct.recon.algorithm import Problem
from twinct.recon.algorithms import algorithms
from twinct.runs.integrals import hardening_corrected
from twinct.scan import Scan
from twinct.scenario import Reconstruction, Scenario

if TYPE_CHECKING:
    from twinct.recon import Step

log = logging.getLogger(__name__)

DARKEST = 1e-7
"""Transmission taken for anything darker, so that a line integral stays finite (16.1)."""


def line_integrals(transmission: NDArray[np.float32]) -> NDArray[np.float32]:
    """-ln(I/I0) of each pixel, float32, same shape."""
    darkest = np.float32(DARKEST)
    integrals = np.maximum(transmission, darkest)
    np.log(integrals, out=integrals)
    return np.negative(integrals, out=integrals)


def reconstruct(
    scan: Scan,
    *,
    geometry: str | None = None,
    mask: ArrayLike | None = None,
    checkpoints: Path | None = None,
    watch: Callable[[int, float], None] | None = None,
    progress: Progress = SILENT,
) -> NDArray[np.float32]:
    """Reconstruct a scan as its scenario says.

    Args:
        scan: projections and poses.
        geometry: ``commanded``, ``executed`` or ``believed``; the scenario's first where None.
        mask: True where a pixel counts, (rows, columns) or (views, rows, columns), bool.
        checkpoints: folder in which each iteration is kept, and from which a later call goes on;
            not for algorithms that cannot (``Algorithm.resumes``): they start again.
        watch: called after each iteration, also those of the call before, with its number from 1
            and the root mean square of p - A x, taken during it before each update; not for ``fdk``
            and ``rtk_sart``, which have none.
        progress: told of each update.

    Returns:
        Attenuation, (z, y, x), 1/mm.

    Raises:
        MissingExtraError: the engine is not installed.
        InputError: the algorithm cannot do this scan, or the memory does not suffice.
    """
    section = scan.scenario.reconstruction
    which = geometry or section.geometries[0]
    poses = scan.poses(which).geometry(scan.scenario.detector.panel)
    grid = section.grid.volume_grid
    integrals = hardening_corrected(scan.scenario, line_integrals(scan.transmission), poses)
    if section.surroundings is not None:
        integrals = _without_surroundings(integrals, poses, section, mask, progress)
    algorithm = algorithms()[section.algorithm]
    folder = checkpoints if algorithm.resumes else None
    kept = _Checkpoints(folder, f"{which}-{reconstruction_digest(scan.scenario)[:16]}")
    done, volume, residuals = kept.newest(grid)
    if watch is not None:
        for number, residual in enumerate(residuals, start=1):
            watch(number, residual)
    passes = getattr(section, "iterations", 1)
    if volume is not None and done >= passes:
        return volume
    updates = algorithm.updates(section, len(scan))
    name = f"{section.algorithm}, {which} geometry"
    with progress.stage(name, passes * updates, done * updates) as tick:
        follow = _Follower(tick, kept, watch, done, residuals)
        problem = Problem(
            Projector(poses, grid),
            integrals,
            scan.transmission,
            mask=None if mask is None else np.asarray(mask),
            x0=volume,
            rng=view_rng(scan.scenario.seed, "order of views", 0),
            callback=follow,
        )
        left = {"iterations": passes - done} if done else {}
        return algorithm.solve(problem, section.model_copy(update=left))


def _without_surroundings(
    integrals: NDArray[np.float32],
    poses: ScanGeometry,
    section: Reconstruction,
    mask: ArrayLike | None,
    progress: Progress,
) -> NDArray[np.float32]:
    from twinct.recon import without_surroundings

    around = section.surroundings
    assert around is not None
    with progress.stage("surroundings", around.iterations * len(poses)) as tick:
        return without_surroundings(
            integrals,
            poses,
            section.grid.volume_grid,
            margin_mm=around.margin_mm,
            voxel_mm=around.voxel_mm,
            iterations=around.iterations,
            relaxation=around.relaxation,
            mask=mask,
            callback=lambda _: tick(),
        )


def require_feasible(scenario: Scenario, commanded: ScanGeometry) -> None:
    """Refuse before any work what the algorithm cannot do, or what does not fit into memory.

    Args:
        scenario: what will be reconstructed, and how.
        commanded: the views that the trajectory asks for.

    Raises:
        InputError: no circular scan for fdk; or too little memory, with what is needed and there.
    """
    from twinct.recon import memory
    from twinct.recon.fdk import circular

    section = scenario.reconstruction
    grid, panel = section.grid.volume_grid, scenario.detector.panel
    Projector(commanded, grid)
    if section.algorithm == "fdk":
        circular(commanded)
    algorithm = algorithms()[section.algorithm]
    voxels, pixels = math.prod(grid.shape), len(commanded) * panel.rows * panel.columns
    # Beside what the algorithm takes: transmission and line integrals; the truth and its region,
    # and the first of several volumes.
    needed = int(4 * (algorithm.volumes * voxels + algorithm.projections * pixels))
    needed += memory.SPARE_BYTES + 8 * pixels + 5 * voxels
    needed += 4 * voxels if len(section.geometries) > 1 else 0
    needed += 4 * pixels if section.surroundings else 0
    memory.refuse_if_short(
        needed,
        f"{algorithm.name} with a grid of {grid.shape} voxels and {len(commanded)} views of "
        f"{panel.shape} pixels",
        "use fewer or larger voxels, or fewer views or pixels"
        + (", or sart, which needs 1 volume" if algorithm.volumes > 1 else ""),
    )


def reconstruction_digest(scenario: Scenario) -> str:
    """SHA-256 of what the volumes depend on: the scan, and how it is reconstructed."""
    text = scenario.digest() + scenario.reconstruction.model_dump_json()
    return hashlib.sha256(text.encode()).hexdigest()


@dataclass
class _Follower:
    """The callback of an algorithm: ticks, sums up residuals, keeps what each iteration made."""

    tick: Callable[[], None]
    kept: _Checkpoints
    watch: Callable[[int, float], None] | None
    done: int
    residuals: list[float]
    square: float = field(default=0.0, init=False)
    rays: int = field(default=0, init=False)

    def __call__(self, step: Step) -> None:
        self.tick()
        self.square += step.rays * step.residual**2
        self.rays += step.rays
        if step.update + 1 < step.updates:
            return
        number = self.done + step.iteration + 1
        residual = math.sqrt(self.square / self.rays) if self.rays else 0.0
        self.square, self.rays = 0.0, 0
        log.info("iteration %d: residual %.5f", number, residual)
        if math.isnan(residual):
            return
        self.residuals.append(residual)
        self.kept.keep(number, step.volume, self.residuals)
        if self.watch is not None:
            self.watch(number, residual)


@dataclass(frozen=True)
class _Checkpoints:
    """The newest iteration of a reconstruction, on disk."""

    folder: Path | None
    name: str

    def newest(self, grid: VolumeGrid) -> tuple[int, NDArray[np.float32] | None, list[float]]:
        """Iterations done, their volume and their residuals."""
        for file in self._files():
            try:
                with np.load(file) as content:
                    volume, residuals = content["volume"], json.loads(str(content["residuals"]))
            except (OSError, ValueError, KeyError, zipfile.BadZipFile):
                log.warning("%s is not readable and left aside", file)
                continue
            if volume.shape == grid.shape:
                return int(file.stem.rpartition("-")[2]), volume, residuals
        return 0, None, []

    def keep(self, iterations: int, volume: NDArray[np.float32], residuals: list[float]) -> None:
        """Write a checkpoint, then remove the ones before it."""
        if self.folder is None:
            return
        with storage_errors(self.folder):
            self.folder.mkdir(parents=True, exist_ok=True)
            older = self._files()
            final = self.folder / f"{self.name}-{iterations:04d}.npz"
            with complete(final) as draft:
                np.savez(draft, volume=volume, residuals=json.dumps(residuals))
            for file in older:
                if file != final:
                    file.unlink()

    def _files(self) -> list[Path]:
        return sorted(self.folder.glob(f"{self.name}-*.npz"), reverse=True) if self.folder else []
