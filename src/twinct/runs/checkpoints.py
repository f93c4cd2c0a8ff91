"""Checkpoints of a reconstruction, and the callback that writes them."""

from __future__ import annotations

import json
import logging
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import InputError
from twinct.core.files.arrays import read_npz
from twinct.core.files.boundary import no_file
from twinct.core.files.plain_json import json_of, read_json
from twinct.core.files.writing import complete, storage_errors, write_json
from twinct.core.foreign_text import whole_number
from twinct.geometry import VolumeGrid
from twinct.recon.steps import Step
from twinct.recon.volume import Volume

log = logging.getLogger(__name__)

OF_RAYS = "unexplained", "diagnosis", "warnings"
"""Extras of a volume that say how well it fits its projections."""


@dataclass
class Follower:
    """Callback of an algorithm: reports progress, sums up residuals, writes checkpoints.

    Attributes:
        tick: advances the progress by one update.
        checkpoints: where volumes are written.
        on_iteration: called after each pass, with its number, residual and volume.
        done: number of passes that an earlier run made.
        residuals: residual of each pass.
        prepares: number of updates expected before the first pass.
        updates: number of updates expected, with those before the first pass.
    """

    tick: Callable[[], None]
    checkpoints: Checkpoints
    on_iteration: Callable[[int, float, NDArray[np.float32]], None]
    done: int
    residuals: list[float]
    prepares: int
    updates: int
    square: float = field(default=0.0, init=False)
    rays: int = field(default=0, init=False)
    ticks: int = field(default=0, init=False)

    def finish(self) -> None:
        """End the progress: an algorithm may stop early, or need fewer levels than it may have."""
        self._advance_to(self.updates)

    def prepare(self, step: Step) -> None:
        """Hear of an update that precedes the first pass."""
        self._advance_to(min(self.ticks + 1, self.prepares))

    def _advance_to(self, updates: int) -> None:
        """Show a number of updates, but no more than expected."""
        while self.ticks < min(updates, self.updates):
            self.tick()
            self.ticks += 1

    def __call__(self, step: Step) -> None:
        """Hear of an update; at the end of a pass, write a checkpoint and report the pass."""
        self._advance_to(max(self.ticks, self.prepares) + 1)
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
        self.checkpoints.keep(number, step.volume, self.residuals)
        self.on_iteration(number, residual, step.volume)


_BESIDE_BYTES = 2**24
"""Largest size of the residuals beside a checkpoint's volume."""


def read_checkpoint(file: Path, grid: VolumeGrid) -> dict[str, NDArray[Any]]:
    """Return the arrays of a checkpoint: a volume on the grid, and its residuals as JSON.

    Raises:
        InputError: the file holds no arrays, or more bytes than such a volume.
    """
    return read_npz(file, f"{file}: the checkpoint", 4 * math.prod(grid.shape) + _BESIDE_BYTES)


@dataclass(frozen=True)
class Checkpoints:
    """Checkpoints of a reconstruction on disk; only the newest one is stored."""

    folder: Path | None
    name: str

    def newest(self, grid: VolumeGrid) -> tuple[int, NDArray[np.float32] | None, list[float]]:
        """Return the number of finished iterations, their volume and their residuals."""
        for file in self._files():
            if no_file(file):  # a pipe, perhaps, which would block
                continue
            try:
                content = read_checkpoint(file, grid)
                volume, residuals = content["volume"], json_of(str(content["residuals"]))
            except (OSError, ValueError, KeyError, InputError):
                log.warning("%s is not readable and is ignored", file)
                continue
            done = whole_number(file.stem.rpartition("-")[2])
            if done is not None and volume.shape == grid.shape:
                return done, volume, residuals
        return 0, None, []

    def keep(self, iterations: int, volume: NDArray[np.float32], residuals: list[float]) -> None:
        """Write a checkpoint, then remove the older ones."""
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

    def keep_results(self, volume: Volume) -> None:
        """Write what the rays say of a finished volume."""
        if self.folder is not None:
            results = {key: volume.extras[key] for key in OF_RAYS if key in volume.extras}
            with storage_errors(self.folder):
                self.folder.mkdir(parents=True, exist_ok=True)
                write_json(self._results, results)

    def results(self) -> dict[str, Any] | None:
        """Return what the rays say of a finished volume, or None if it is not on disk."""
        try:
            return None if no_file(self._results) else read_json(self._results)
        except InputError:
            return None

    @property
    def _results(self) -> Path:
        return (self.folder or Path()) / f"{self.name}-results.json"

    def in_words(self, iterations: int) -> str:
        """Return the number of iterations on disk in words; empty if there is none."""
        done = [file.stem.rpartition("-")[2] for file in self._files()[:1]]
        return f"{self.folder} keeps {int(done[0])} of {iterations} iterations" if done else ""

    def _files(self) -> list[Path]:
        return sorted(self.folder.glob(f"{self.name}-*.npz"), reverse=True) if self.folder else []
