"""Detection of a signal in the noise of a region."""

from __future__ import annotations

from pydantic import Field

from twinct.core.settings import setting
from twinct.evaluation.figure import Figure
from twinct.evaluation.figure_kind import FigureKind, FigureSettings, Measurement, Name
from twinct.evaluation.kinds.mtf import transfer_at
from twinct.evaluation.kinds.nps import spectrum_of
from twinct.evaluation.observer import detectability
from twinct.evaluation.signals import Signal, signal_on


class Task(FigureSettings):
    """Detection of a signal in the noise of a region, rated by the index of detectability."""

    name: Name = Field(description="Name of the figure.")
    signal: Signal = Field(description="Signal to detect.")
    region: str = Field(
        description="Name of the homogeneous region in whose noise the signal lies."
    )
    mtf: str | None = setting(
        None, "Measured blur of the signal: an `at` of `evaluation.mtf`; null: no blur."
    )


_OBSERVER = "non-prewhitening observer"


def _measure(at: Measurement, task: Task) -> dict[str, float]:
    spectrum = at.once(spectrum_of, task.region)
    transfer = 1.0 if task.mtf is None else at.once(transfer_at, task.mtf)
    if spectrum is None or transfer is None:
        return {}
    signal, edges = signal_on(task.signal, at.grid), at.grid.voxel[::-1].tolist()
    return {"detectability": detectability(signal, edges, spectrum, transfer)}


TASKS = FigureKind(
    "tasks",
    Task,
    "Detection tasks.",
    (Figure("detectability", "detectability d′", "", 1, 2, _OBSERVER, "higher"),),
    _measure,
    names={"region": "region", "mtf": "mtf.at"},
)
