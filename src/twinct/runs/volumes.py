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
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinct.draws import view_rng
from twinct.files.writing import complete, storage_errors
from twinct.geometry import ScanGeometry, VolumeGrid
from twinct.progress import SILENT, Progress
from twinct.runs.integrals import hardening_corrected
from twinct.scan import Scan
from twinct.scenario import Reconstruction, Scenario

if TYPE_CHECKING:
    from twinct.recon import Callback, Step

log = logging.getLogger(__name__)

DARKEST = 1e-7
"""Transmission taken for anything darker, so that a line integral stays finite (16.1)."""

RESUMABLE = ("sart", "os_sart", "sirt")
"""Algorithms that go on from a volume as if nothing had happened. Of the others, ``cgls`` and
``fista_tv`` have directions and momentum beside the volume, and ``fdk`` no iterations: interrupted,
they start again."""


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
            see ``RESUMABLE``.
        watch: called after each iteration, also those of the call before, with its number from 1
            and the root mean square of p - A x, taken during it before each update; not for ``fdk``
            and the engine ``rtk``, which have none.
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
    folder = checkpoints if section.algorithm in RESUMABLE and section.engine == "twinct" else None
    kept = _Checkpoints(folder, f"{which}-{reconstruction_digest(scan.scenario)[:16]}")
    done, volume, residuals = kept.newest(grid)
    if watch is not None:
        for number, residual in enumerate(residuals, start=1):
            watch(number, residual)
    if volume is not None and done >= section.iterations:
        return volume
    updates = _updates(section, len(scan))
    passes = 1 if section.algorithm == "fdk" else section.iterations
    name = f"{section.algorithm}, {which} geometry"
    with progress.stage(name, passes * updates, done * updates) as tick:
        follow = _Follower(tick, kept, watch, done, residuals)
        return _solve(scan, integrals, poses, grid, mask, volume, section.iterations - done, follow)


def _solve(
    scan: Scan,
    integrals: NDArray[np.float32],
    poses: ScanGeometry,
    grid: VolumeGrid,
    mask: ArrayLike | None,
    x0: NDArray[np.float32] | None,
    iterations: int,
    callback: Callback,
) -> NDArray[np.float32]:
    from twinct import recon

    section = scan.scenario.reconstruction
    seed = view_rng(scan.scenario.seed, "order of views", 0)
    common: dict[str, Any] = {"iterations": iterations, "x0": x0, "callback": callback}
    positive = {"nonnegative": section.keeps_nonnegative}
    relaxed = {"relaxation": section.relaxation} | positive
    ordered = {"order": section.order, "rng": seed}
    if section.engine == "rtk":
        return recon.rtk_sart(integrals, poses, grid, **relaxed, **ordered, **common)
    A = recon.Projector(poses, grid)
    common["mask"] = mask
    match section.algorithm:
        case "sart":
            return recon.sart(A, integrals, **relaxed, **ordered, **common)
        case "os_sart":
            return recon.os_sart(
                A, integrals, subsets=_subsets(section, len(A)), **relaxed, **common
            )
        case "sirt":
            return recon.sirt(A, integrals, **relaxed, **common)
        case "cgls":
            return recon.cgls(A, integrals, **common)
        case "fdk":
            window = section.window
            return recon.fdk(A, integrals, window=window, mask=mask, callback=callback, **positive)
        case "fista_tv":
            return recon.fista_tv(
                A,
                integrals,
                regularisation=section.regularisation,
                subsets=_subsets(section, len(A)),
                tv_steps=section.tv_steps,
                weights=scan.transmission if section.weighting == "counts" else None,
                **positive,
                **common,
            )


def _subsets(section: Reconstruction, views: int) -> int:
    return max(views // 10, 1) if section.subsets is None else section.subsets


def _updates(section: Reconstruction, views: int) -> int:
    """Updates in each pass."""
    from twinct.recon.fdk import BLOCK

    return {
        "sart": views,
        "os_sart": _subsets(section, views),
        "fista_tv": _subsets(section, views),
        "fdk": -(-views // BLOCK),
    }.get(section.algorithm, 1)


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
    from twinct.recon import Projector, memory
    from twinct.recon.fdk import circular

    section = scenario.reconstruction
    grid, panel = section.grid.volume_grid, scenario.detector.panel
    Projector(commanded, grid)
    if section.algorithm == "fdk":
        circular(commanded)
    algorithm = "rtk" if section.engine == "rtk" else section.algorithm
    voxels, pixels = math.prod(grid.shape), len(commanded) * panel.rows * panel.columns
    # Beside what the algorithm takes: transmission and line integrals; the truth and its region,
    # and the first of several volumes.
    needed = memory.peak_bytes(algorithm, voxels, pixels) + 8 * pixels + 5 * voxels
    needed += 4 * voxels if len(section.geometries) > 1 else 0
    needed += 4 * pixels if section.surroundings else 0
    memory.refuse_if_short(
        needed,
        f"{algorithm} with a grid of {grid.shape} voxels and {len(commanded)} views of "
        f"{panel.shape} pixels",
        memory.advice(algorithm),
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
