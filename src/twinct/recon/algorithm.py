"""What an algorithm is: its settings, its function, what it takes of memory, whether it resumes.

Each algorithm's file ends with its ``Algorithm``; those from outside the package are found by the
entry points of the group ``twinct.algorithms``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from inspect import signature
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from twinct.geometry import ScanGeometry, VolumeGrid
from twinct.recon.checks import Mask
from twinct.recon.engine import Singles
from twinct.recon.projector import Projector
from twinct.recon.steps import Callback
from twinct.settings import Section
from twinct.volume import Volume


class AlgorithmSettings(Section):
    """Keys of one algorithm, among them ``algorithm``, a Literal of its name and its default.

    A key named ``path`` or ``file`` is an input file: it is made absolute, must exist, and counts
    by content.
    """


@dataclass(frozen=True, eq=False)
class Problem:
    """What there is to reconstruct from.

    Attributes:
        projector: A, with the geometry and the grid.
        line_integrals: p, (views, rows, columns), corrected.
        transmission: I/I0 as measured, same shape; see ``counts``.
        mask: True where a pixel counts, (rows, columns) or (views, rows, columns), bool.
        x0: volume to start from, (z, y, x).
        rng: for what is drawn.
        callback: to be called after each update; see ``Step``.
        exposures: mAs of each view, (views,), in one unit for all; None: equal ones.
    """

    projector: Projector
    line_integrals: NDArray[np.float32]
    transmission: NDArray[np.float32]
    mask: NDArray[np.bool_] | None = None
    x0: NDArray[np.float32] | None = None
    rng: np.random.Generator | int = 0
    callback: Callback | None = None
    exposures: NDArray[np.float64] | None = None

    @property
    def counts(self) -> NDArray[np.float32]:
        """What each pixel received, for weights: transmission times the view's exposure."""
        if self.exposures is None:
            return self.transmission
        return self.transmission * self.exposures[:, None, None].astype(np.float32)


SettingsT = TypeVar("SettingsT", bound=AlgorithmSettings)


@dataclass(frozen=True, eq=False)
class Algorithm(Generic[SettingsT]):
    """An algorithm as the scenario can name it.

    Attributes:
        settings: its keys; ``iterations`` is the number of passes, one where there is no such key.
        solve: reconstructs a problem with these settings.
        volumes: at the peak, float32, beside ``x0``.
        projections: at the peak, float32, beside those given.
        resumes: n iterations and then m from their result, as ``x0``, are n + m, to the last bit.
        masks: leaves pixels out; with a mask it is refused otherwise.
        updates: in each pass, of these settings and so many views; for the progress.
        check: raises InputError for keys, files that they name, views or a grid that it cannot
            work with, before any work.
        extra_volumes: beside ``volumes``, of these settings.
        expects: of A, p, the mask and these settings: what the volume will be like, (z, y, x), if
            the algorithm knows of it beforehand; what lies around the grid is then found better.
    """

    settings: type[SettingsT]
    solve: Callable[[Problem, SettingsT], Volume]
    volumes: float
    projections: float = 0.0
    resumes: bool = False
    masks: bool = True
    updates: Callable[[SettingsT, int], int] = field(default=lambda settings, views: 1)
    check: Callable[[SettingsT, ScanGeometry, VolumeGrid], object] = field(
        default=lambda own, views, grid: None
    )
    extra_volumes: Callable[[SettingsT], float] = field(default=lambda settings: 0.0)
    expects: Callable[[Projector, Singles, Mask | None, SettingsT], Singles] | None = None

    @property
    def name(self) -> str:
        """What the key ``algorithm`` calls it."""
        return str(self.settings.model_fields["algorithm"].default)


def solve_by(
    function: Callable[..., Volume], problem: Problem, settings: AlgorithmSettings, **others: Any
) -> Volume:
    """Call an algorithm's function: its arguments are named as the keys, or as what there is."""
    A = problem.projector
    given = {**vars(problem), **vars(settings), "A": A, "geometry": A.geometry, "grid": A.grid}
    given |= others
    return function(**{name: given[name] for name in signature(function).parameters})
