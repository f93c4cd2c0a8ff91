"""Detection of a signal in the noise of a region."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from twinct.core.settings import setting
from twinct.core.signals import AnySignal, GaussianSignal, SphereSignal, contrast_at
from twinct.evaluation.figure import Figure
from twinct.evaluation.figure_kind import FigureKind, FigureSettings, Measurement, Name
from twinct.evaluation.kinds.mtf import transfer_at
from twinct.evaluation.kinds.nps import spectrum_of
from twinct.evaluation.observer import detectability
from twinct.evaluation.region_voxels import centres
from twinct.geometry import Floats, VolumeGrid


class Task(FigureSettings):
    """Detection of a signal in the noise of a region, rated by the index of detectability."""

    name: Name = Field(description="Name of the figure.")
    signal: AnySignal = Field(description="Signal to detect.")
    region: str = Field(
        description="Name of the homogeneous region in whose noise the signal lies."
    )
    mtf: str | None = setting(
        None, "Measured blur of the signal: an `at` of `evaluation.mtf`; null: no blur."
    )


_OBSERVER = "non-prewhitening observer"


def _measure(at: Measurement, task: Task) -> dict[str, float]:
    spectrum = at.once(spectrum_of, task.region)
    local = None if task.mtf is None else at.once(transfer_at, task.mtf)
    if spectrum is None or (task.mtf is not None and local is None):
        return {}
    transfer = local.mtf if local else 1.0
    signal, edges = _signal_on(task.signal, at.grid), at.grid.voxel[::-1].tolist()
    return {"detectability": detectability(signal, edges, spectrum, transfer)}


def _signal_on(signal: SphereSignal | GaussianSignal, grid: VolumeGrid) -> Floats:
    """Return the contrast on a lattice of twice the sphere's size, or of 6 sigma to each side.

    The lattice has the voxels of ``grid``; the contrast, (z, y, x), is relative to mu(reference).
    """
    sphere = isinstance(signal, SphereSignal)
    half = 2 * signal.radius_mm if sphere else 6 * signal.sigma_mm
    count = (2 * np.ceil(half / grid.voxel[::-1]) + 1).astype(int).tolist()
    lattice = VolumeGrid(count, grid.voxel)
    z, y, x = (slice(0, n) for n in count)
    radius = np.linalg.norm(centres(lattice, (z, y, x)), axis=-1)
    return contrast_at(signal, radius, float(grid.voxel.mean()))


TASKS = FigureKind(
    "tasks",
    Task,
    "Detection tasks.",
    (
        Figure(
            "detectability",
            "detectability d′",
            digits=2,
            meaning=_OBSERVER,
            best="higher",
            good="above 3",
            without_signal="null",
        ),
    ),
    _measure,
    names={"region": "region", "mtf": "mtf.at"},
)
